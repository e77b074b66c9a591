# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

name = "hydro_sim"

setup(
    name=name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={name: ["py.typed", "data/*", "export/templates/*", "model/*.c"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + name]),
        ("share/" + name, ["package.xml"]),
        ("share/" + name + "/config", glob("hydro_sim/data/*.yaml")),
    ],
    zip_safe=False,
    maintainer="hydro engineers",
    maintainer_email="hydro@users.noreply.github.com",
    description="The bench as a model: hydraulics, what the box runs, the sim node, and an emulated MicroLabBox.",
    license="Apache-2.0",
    install_requires=[
        "hydro_bridge",
        "casadi",
        "cobs",
        "jinja2",
        "matplotlib",
        "numba",
        "numpy",
        "pyyaml",
        "safetensors",
    ],
    extras_require={
        "test": ["pytest"],  # by which colcon test knows to call pytest
        "fmu": ["fmpy"],  # to run what `export` writes
        "mujoco": ["mujoco"],
    },
    entry_points={
        "console_scripts": [
            "sim = hydro_core.process.startup:main_of.hydro_sim.nodes.sim",
            "export = hydro_core.process.startup:main_of.hydro_sim.export.command",
            "emulator = hydro_core.process.startup:main_of.hydro_sim.emulator.command",
            "learn = hydro_core.process.startup:main_of.hydro_sim.identification.learn",
            "validate = hydro_core.process.startup:main_of.hydro_sim.identification.validate",
        ],
    },
)
