# SPDX-License-Identifier: Apache-2.0
"""A package's package.xml declares what its modules import, no more and no less (for rosdep and a real workspace)."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parent.parent
LOADED = {"hydro_sim": {"hydro_firmware"}}
"""Packages of ours that are loaded as a shared library, which no import shows."""
PACKAGES = sorted(path.parent for path in ROOT.glob("src/hydro_*/setup.py"))

KEYS = {
    "casadi": "python3-casadi-pip",
    "cobs": "python-cobs-pip",
    "cycler": "python3-cycler",
    "fastjsonschema": "python3-fastjsonschema",
    "h5py": "python3-h5py",
    "hypothesis": "python3-hypothesis",
    "jinja2": "python3-jinja2",
    "joblib": "python3-joblib",
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "pandas": "python3-pandas",
    "pytest": "python3-pytest",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "torch": "python3-torch",
    "tqdm": "python3-tqdm",
    "websockets": "python3-websockets",
    "yaml": "python3-yaml",
}
"""rosdep's keys of modules that are no ROS packages."""

WITHOUT_KEY = {"asammdf", "llvmlite", "mcap", "msgspec", "nptdms", "osqp", "safetensors", "threadpoolctl"}
"""Modules that rosdep has no key for: `pip install -r requirements.txt` (CONTRIBUTING.md)."""


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
