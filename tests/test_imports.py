# SPDX-License-Identifier: Apache-2.0
"""A package declares what its modules import, for rosdep and for pip; nothing heavy comes before --help."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.checks import each

ROOT = Path(__file__).resolve().parent.parent
LOADED = {"hydro_sim": {"hydro_firmware"}}
"""Packages of ours that are loaded as a shared library, which no import shows."""
KEYS = {name: f"python3-{name}" for name in (
    "cycler", "fastjsonschema", "h5py", "hypothesis", "jinja2", "matplotlib", "numba", "numpy", "pandas", "psutil",
    "pytest", "scipy", "serial", "torch", "tqdm", "websockets", "yaml",
)} | {"casadi": "python3-casadi-pip", "cobs": "python-cobs-pip", "rosbags": "python3-rosbags-pip"}  # fmt: skip
"""rosdep's keys of modules that are no ROS packages."""
WITHOUT_KEY = {
    "asammdf", "dask", "distributed", "gymnasium", "llvmlite", "mcap", "msgspec", "nptdms", "osqp", "pint",
    "pyarrow", "safetensors", "skrl", "stable_baselines3", "tensorboardX", "threadpoolctl",
}  # fmt: skip
"""Modules that rosdep has no key for: `pip install -r requirements.txt` (CONTRIBUTING.md)."""
DISTRIBUTIONS = {"nptdms": "npTDMS", "serial": "pyserial", "yaml": "pyyaml"}
"""pip's names where they are not the module's."""
NOT_ASKED_FOR = {"asammdf", "cycler", "gymnasium", "llvmlite"}
"""Only for MDF files and for other learners; come with matplotlib and numba."""


def modules_imported(files: Iterable[Path]) -> set[str]:
    """The top-level modules that files import, anywhere in them."""
    found = set()
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {name.name.partition(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.partition(".")[0])
    return found


def keys_of(folder: Path, files: Iterable[Path]) -> set[str]:
    """The keys of what files of a package import, without the standard library, the package and all tests."""
    own = {folder.name, "tests", *(path.stem for path in (folder / "test").rglob("*.py"))}
    foreign = modules_imported(files) - set(sys.stdlib_module_names) - own - WITHOUT_KEY
    return {KEYS.get(name, name) for name in foreign}


@pytest.mark.parametrize(
    "folder", sorted(path.parent for path in ROOT.glob("src/hydro_*/setup.py")), ids=lambda folder: folder.name
)
def test_what_is_imported_is_declared(folder: Path) -> None:
    """ROS comes from elsewhere than pip: a command that needs it says so."""
    modules, package = [*(folder / folder.name).rglob("*.py")], ElementTree.parse(folder / "package.xml").getroot()
    runs = {str(node.text) for kind in ("depend", "exec_depend") for node in package.findall(kind)}
    tests = {str(node.text) for node in package.findall("test_depend")}
    assert runs == keys_of(folder, [*modules, *folder.glob("launch/*.py")]) | LOADED.get(folder.name, set())
    assert tests == keys_of(folder, (folder / "test").rglob("*.py")) - runs
    foreign = modules_imported(modules) - NOT_ASKED_FOR
    called = ast.walk(ast.parse((folder / "setup.py").read_text(encoding="utf-8")))
    (value,) = (node.value for node in called if isinstance(node, ast.keyword) and node.arg == "install_requires")
    listed = {name for name in ast.literal_eval(value) if not name.startswith("hydro_")}
    assert listed == {DISTRIBUTIONS.get(name, name) for name in foreign if name in {*KEYS, *WITHOUT_KEY}}


WITHOUT_NUMBA = ("hydro_policy.nodes.evaluate", "hydro_policy.nodes.trainer")
PROBE = """
import importlib, os, sys
from hydro_core.process.startup import LazyMain
for name in sys.argv[1].split():
    importlib.import_module(name)
for module in sys.argv[2:]:
    sys.stdout.flush()
    if os.fork():
        os.wait()
        continue
    sys.argv = ["command", "--help"]
    try:
        LazyMain(module)()
    except SystemExit as ended:
        assert not ended.code, ended.code
    print("probed", module, "torch" in sys.modules, "numba" in sys.modules, flush=True)
    os._exit(0)
"""
"""One process forks for each command what all of them import."""


def helped(preloaded: str, *modules: str) -> dict[str, tuple[str, str]]:
    """Ask each command for help; returns whether torch and numba were imported, of those that showed it."""
    probe = [sys.executable, "-c", PROBE, preloaded, *modules]
    shown = subprocess.run(probe, capture_output=True, text=True, timeout=240, check=True).stdout
    found = re.findall(r"^usage: [^\0]*?^probed (\S+) (\w+) (\w+)$", shown, re.MULTILINE)
    return {module: (torch, numba) for module, torch, numba in found}


def test_help_of_a_command_imports_no_torch() -> None:
    """Those of hydro_policy: the other packages import no torch."""
    setup = (ROOT / "src/hydro_policy/setup.py").read_text(encoding="utf-8")
    commands = set(re.findall(r'"\w+ = hydro_core\.process\.startup:main_of\.([\w.]+)"', setup))
    rest = sorted(commands - set(WITHOUT_NUMBA))
    assert helped("numpy", *WITHOUT_NUMBA) == dict.fromkeys(WITHOUT_NUMBA, ("False", "False"))
    assert helped("numpy numba scipy.optimize", *rest) == dict.fromkeys(rest, ("False", "True"))


def test_only_the_learner_imports_torch() -> None:
    """Acting, evaluation, the supervisor of the learner and the environment for other learners do without."""
    modules = ("nodes.training", "nodes.evaluation", "learner_process.supervisor", "env", "runs.initial_agent")
    probe = (
        "import importlib, sys\nfor name in sys.argv[1:]: importlib.import_module(name)\nprint('torch' in sys.modules)"
    )
    words = [sys.executable, "-c", probe, *(f"hydro_policy.{name}" for name in modules)]
    assert subprocess.run(words, capture_output=True, text=True, timeout=240, check=True).stdout.split()[-1] == "False"


def test_every_benchmark_and_the_demo_import() -> None:
    """mypy lets them import modules that are not there."""
    found = [path.relative_to(ROOT) for path in (*ROOT.glob("benchmarks/**/*.py"), *ROOT.glob("demo/*.py"))]
    modules = [".".join(path.with_suffix("").parts) for path in found if "test" not in path.parts]
    each(modules, importlib.import_module)
