# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

name = "hydro_bridge"

setup(
    name=name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={
        name: [
            "py.typed",
            "bags/schemas.json",
            "pages/static/*",
            "pages/templates/*",
            "ros/*.xml",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + name]),
        ("share/" + name, ["package.xml"]),
        ("share/" + name + "/layouts", glob("layouts/*")),
        ("share/" + name + "/config", glob("config/*")),
    ],
    zip_safe=False,
    maintainer="hydro engineers",
    maintainer_email="hydro@users.noreply.github.com",
    description="The outside world as topics: serial link to the MicroLabBox, recorder, replayer, bag reader.",
    license="Apache-2.0",
    install_requires=[
        "hydro_core",
        "cobs",
        "jinja2",
        "mcap",
        "msgspec",
        "numpy",
        "pyserial",
        "pytest",
        "pyyaml",
        "rosbags",
        "tqdm",
        "websockets",
    ],
    extras_require={"test": ["pytest"]},  # by which colcon test knows to call pytest
    entry_points={
        "console_scripts": [
            "arm = hydro_core.process.startup:main_of.hydro_bridge.nodes.arm",
            "bridge = hydro_core.process.startup:main_of.hydro_bridge.nodes.bridge",
            "conformance = hydro_core.process.startup:main_of.hydro_bridge.conformance.command",
            "dashboard = hydro_core.process.startup:main_of.hydro_bridge.nodes.dashboard",
            "recorder = hydro_core.process.startup:main_of.hydro_bridge.nodes.recorder",
            "replayer = hydro_core.process.startup:main_of.hydro_bridge.nodes.replayer",
            "runs = hydro_core.process.startup:main_of.hydro_bridge.pages.runs",
            "view = hydro_core.process.startup:main_of.hydro_bridge.pages.view",
        ],
    },
)
