# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

name = "hydro_filter"

setup(
    name=name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={name: ["py.typed", "data/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + name]),
        ("share/" + name, ["package.xml"]),
        ("share/" + name + "/config", glob("config/*")),
    ],
    zip_safe=False,
    maintainer="hydro engineers",
    maintainer_email="hydro@users.noreply.github.com",
    description="Contraction certificate and the QP that corrects the valve current.",
    license="Apache-2.0",
    install_requires=["hydro_sim", "numba", "numpy", "osqp", "scipy"],
    extras_require={"test": ["pytest"]},  # by which colcon test knows to call pytest
    entry_points={
        "console_scripts": [
            "filter = hydro_core.process.startup:main_of.hydro_filter.nodes.filter",
            "filtered_plant = hydro_core.process.startup:main_of.hydro_filter.nodes.filtered_plant",
            "export_c = hydro_core.process.startup:main_of.hydro_filter.controller.header",
            "learn_metric = hydro_core.process.startup:main_of.hydro_filter.training.learn_metric",
        ],
    },
)
