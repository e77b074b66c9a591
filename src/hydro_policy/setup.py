# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

name = "hydro_policy"

setup(
    name=name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={name: ["py.typed", "data/*.safetensors", "data/*/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + name]),
        ("share/" + name, ["package.xml"]),
        ("share/" + name + "/launch", glob("launch/*")),
        ("share/" + name + "/config", glob("config/*")),
    ],
    zip_safe=False,
    maintainer="hydro engineers",
    maintainer_email="hydro@users.noreply.github.com",
    description="Soft Actor-Critic over the PI gains: training on whichever plant publishes, and evaluation.",
    license="Apache-2.0",
    install_requires=[
        "hydro_filter",
        "msgspec",
        "numba",
        "numpy",
        "pyyaml",
        "safetensors",
        "scipy",
        "tensorboardX",
        "torch",
        "tqdm",
    ],
    extras_require={"gym": ["gymnasium"], "test": ["pytest"]},  # by the latter colcon test knows to call pytest
    entry_points={
        "console_scripts": [
            "pretrain = hydro_core.process.startup:main_of.hydro_policy.pretraining.pretrain",
            "collect = hydro_core.process.startup:main_of.hydro_policy.nodes.collect",
            "commission = hydro_core.process.startup:main_of.hydro_policy.nodes.commission",
            "trainer = hydro_core.process.startup:main_of.hydro_policy.nodes.trainer",
            "evaluate = hydro_core.process.startup:main_of.hydro_policy.nodes.evaluate",
            "export_c = hydro_core.process.startup:main_of.hydro_policy.sac.header",
            "override = hydro_core.process.startup:main_of.hydro_policy.nodes.override",
        ],
    },
)
