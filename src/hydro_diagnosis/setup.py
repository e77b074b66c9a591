# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

name = "hydro_diagnosis"

setup(
    name=name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={name: ["py.typed", "data/*", "report/templates/*", "page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + name]),
        ("share/" + name, ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="hydro engineers",
    maintainer_email="hydro@users.noreply.github.com",
    description="Locate, name, size and model the physics that the simulation leaves out.",
    license="Apache-2.0",
    install_requires=[
        "hydro_sim",
        "dask",
        "distributed",
        "h5py",
        "msgspec",
        "npTDMS",
        "numpy",
        "pandas",
        "pint",
        "pyarrow",
        "pyyaml",
        "scipy",
        "threadpoolctl",
        "tqdm",
        "websockets",
    ],
    extras_require={"test": ["pytest"]},  # by which colcon test knows to call pytest
    entry_points={
        "console_scripts": [
            "diagnose = hydro_core.process.startup:main_of.hydro_diagnosis.cli",
            "diagnose_many = hydro_core.process.startup:main_of.hydro_diagnosis.diagnose_many",
            "inspect = hydro_core.process.startup:main_of.hydro_diagnosis.inspect_command",
        ],
    },
)
