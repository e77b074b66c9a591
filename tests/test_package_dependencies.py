# SPDX-License-Identifier: Apache-2.0
"""A package declares what its modules import: in package.xml for rosdep, in setup.py for pip."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ament_index_python.packages import get_package_prefix

ROOT = Path(__file__).resolve().parent.parent
LOADED = {"hydro_sim": {"hydro_firmware"}}
"""Packages of ours that are loaded as a shared library, which no import shows."""
PACKAGES = sorted(path.parent for path in ROOT.glob("src/hydro_*/setup.py"))
KEYS = {name: f"python3-{name}" for name in (
    "cycler", "fastjsonschema", "h5py", "hypothesis", "jinja2", "matplotlib", "numba", "numpy", "pandas",
    "pytest", "scipy", "serial", "torch", "tqdm", "websockets", "yaml",
)} | {"casadi": "python3-casadi-pip", "cobs": "python-cobs-pip", "rosbags": "python3-rosbags-pip"}  # fmt: skip
"""rosdep's keys of modules that are no ROS packages."""
WITHOUT_KEY = {
    "asammdf", "dask", "distributed", "llvmlite", "mcap", "msgspec", "nptdms", "osqp", "pyarrow", "ruptures",
    "safetensors", "tensorboardX", "threadpoolctl",
}  # fmt: skip
"""Modules that rosdep has no key for: `pip install -r requirements.txt` (CONTRIBUTING.md)."""
DISTRIBUTIONS = {"nptdms": "npTDMS", "serial": "pyserial", "yaml": "pyyaml"}
"""pip's names where they are not the module's."""
NOT_ASKED_FOR = {"asammdf", "cycler", "llvmlite"}
"""Only for MDF files; come with matplotlib and numba."""


def modules_imported(files: Iterable[Path]) -> set[str]:
    """Return the top-level modules that files import, anywhere in them."""
    found = set()
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {name.name.partition(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.partition(".")[0])
    return found


def keys_of(folder: Path, files: Iterable[Path]) -> set[str]:
    """Return the keys of what files of a package import, without the standard library, the package and all tests."""
    own = {folder.name, "tests", *(path.stem for path in (folder / "test").rglob("*.py"))}
    foreign = modules_imported(files) - set(sys.stdlib_module_names) - own - WITHOUT_KEY
    return {KEYS.get(name, name) for name in foreign}


def declared(folder: Path, *kinds: str) -> set[str]:
    root = ElementTree.parse(folder / "package.xml").getroot()
    return {str(node.text) for kind in kinds for node in root.findall(kind)}


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_what_runs_is_declared(folder: Path) -> None:
    needed = keys_of(folder, [*(folder / folder.name).rglob("*.py"), *folder.glob("launch/*.py")])
    assert declared(folder, "depend", "exec_depend") == needed | LOADED.get(folder.name, set())


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_what_only_tests_import_is_declared(folder: Path) -> None:
    needed = keys_of(folder, (folder / "test").rglob("*.py"))
    assert declared(folder, "test_depend") == needed - declared(folder, "depend", "exec_depend")


@pytest.mark.parametrize("folder", PACKAGES, ids=lambda folder: folder.name)
def test_what_pip_has_to_install_is_declared(folder: Path) -> None:
    """ROS comes from elsewhere: a command that needs it says so."""
    foreign = modules_imported((folder / folder.name).rglob("*.py")) - NOT_ASKED_FOR
    needed = {DISTRIBUTIONS.get(name, name) for name in foreign if name in {*KEYS, *WITHOUT_KEY}}
    called = ast.walk(ast.parse((folder / "setup.py").read_text(encoding="utf-8")))
    (value,) = (node.value for node in called if isinstance(node, ast.keyword) and node.arg == "install_requires")
    listed = {name for name in ast.literal_eval(value) if not name.startswith("hydro_")}
    assert listed == needed


FILES = sorted(ROOT.glob("src/*/launch/*.launch.py"))


def calls(path: Path) -> list[ast.Call]:
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]


def executables(path: Path) -> set[tuple[str, str]]:
    """Return the (package, executable) pairs that a launch file names."""
    found = set()
    for call in calls(path):
        words = {
            word.arg: ast.literal_eval(word.value) for word in call.keywords if isinstance(word.value, ast.Constant)
        }
        if "executable" in words:
            found.add((words["package"], words["executable"]))
    return found


def options(path: Path) -> set[str]:
    constants = [node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)]
    return {value for value in constants if isinstance(value, str) and re.fullmatch(r"--[a-z-]+", value)}


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_executables_take_the_options_given(path: Path) -> None:
    help_texts = ""
    for package, executable in executables(path):
        program = Path(get_package_prefix(package), "lib", package, executable)
        assert os.access(program, os.X_OK), f"{package} has no executable {executable}"
        answer = subprocess.run([program, "--help"], capture_output=True, text=True, check=True, timeout=60)
        help_texts += answer.stdout
    assert {option for option in options(path) if not re.search(rf"{option}\b", help_texts)} == set()
