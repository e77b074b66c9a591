# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

name = "hydro_core"

setup(
    name=name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + name]),
        ("share/" + name, ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="hydro engineers",
    maintainer_email="hydro@users.noreply.github.com",
    description="The ground of all packages: signals, settings, files, console, errors, processes.",
    license="Apache-2.0",
    install_requires=["msgspec", "numpy", "pyyaml", "tqdm"],
    extras_require={"test": ["pytest"]},  # by which colcon test knows to call pytest
)
