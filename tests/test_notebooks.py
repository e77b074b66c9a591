# SPDX-License-Identifier: Apache-2.0
"""The notebooks in docs/examples run and show what they say; that of the diagnosis from its wheels alone."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.checks import ran

ROOT = Path(__file__).resolve().parent.parent
RECORDINGS_ONLY = ("hydro_core", "hydro_bridge", "hydro_sim", "hydro_diagnosis")
WITHOUT_ROS = """
import sys
sys.modules.update(dict.fromkeys(("rclpy", "hydro_msgs", "torch", "ament_index_python"), None))
"""
DIAGNOSE = """
from hydro_diagnosis import diagnose
from hydro_sim.model.bench import Bench
found = diagnose({runs}, holdout=[{unseen!r}], bench=Bench.nominal(), columns={columns})
print(*found.table.value, found.report.verdict, found._repr_html_().startswith('<iframe'))
"""
SIMULATE = """
from hydro_core.process.startup import main_of
sys.argv = ["emulator", "--offline", "--seconds", "1", "--out", "run"]
sys.exit(main_of.hydro_sim.emulator.command())
"""
START_A_NODE = """
from hydro_core.process.startup import main_of
sys.exit(main_of.hydro_bridge.nodes.bridge())
"""


def code_of(name: str) -> str:
    """The code of a notebook's cells, one after the other."""
    notebook = json.loads((ROOT / "docs" / "examples" / f"{name}.ipynb").read_text(encoding="utf-8"))
    return "\n".join("".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code")


def executed(code: str, monkeypatch: pytest.MonkeyPatch, **changed: int) -> dict[str, Any]:
    """What the code of a notebook leaves; `changed`: the numbers that it sets, with others in their place."""
    for name, value in changed.items():
        code, count = re.subn(rf"^{name} = .*$", f"{name} = {value}", code, flags=re.MULTILINE)
        assert count == 1
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, Any] = {"__name__": "notebook"}
    exec(code, names)
    return names


@pytest.mark.study
def test_wheels_diagnose_without_ros_torch_and_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Recordings, that is: what simulates the box needs its C library, and says so."""
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")
    sources = [shutil.copytree(ROOT / "src" / name, tmp_path / name, ignore=ignored) for name in RECORDINGS_ONLY]
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(tmp_path / "site"), *map(str, sources)], check=True)
    own = ("AMENT", "COLCON", "ROS", "PYTHON", "HYDRO", "RMW")
    clean = {name: value for name, value in os.environ.items() if not name.startswith(own)}
    clean |= {"PYTHONPATH": str(tmp_path / "site"), "TMPDIR": str(tmp_path)}

    def run(code: str) -> subprocess.CompletedProcess[str]:
        return ran(sys.executable, "-c", WITHOUT_ROS + code, env=clean, cwd=tmp_path)

    made = executed(code_of("diagnose").partition("found = diagnose")[0], monkeypatch)
    runs = [str(path) for path in made["runs"]]
    notebook = run(DIAGNOSE.format(runs=runs, unseen=str(made["unseen"]), columns=made["COLUMNS"]))
    assert not notebook.returncode, notebook.stderr
    leak, friction, *last = notebook.stdout.split()[-4:]
    assert last == ["explained", "True"]
    assert float(leak) == pytest.approx(2e-13, rel=0.01, abs=0.0) and float(friction) == pytest.approx(8.0, rel=0.01)
    for code, missing in ((SIMULATE, "make setup"), (START_A_NODE, "ROS 2")):
        refused = run(code)
        assert refused.returncode == 2
        assert missing in refused.stderr and "Traceback" not in refused.stderr


@pytest.mark.slow
def test_simulated_filter_holds_the_loop_and_the_compensated_law_is_best(monkeypatch: pytest.MonkeyPatch) -> None:
    names = executed(code_of("simulate"), monkeypatch)
    assert len(names["states"]["without filter"]) < len(names["states"]["with filter"]) == 3000
    errors = names["errors"]
    assert (errors["compensated"] < 0.5 * errors["fixed (90, 15)"]).all()


@pytest.mark.slow
def test_policy_trains_in_a_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    history = executed(code_of("train"), monkeypatch, EPISODES=4)["history"]
    assert np.isfinite(history.score).all() and history.updates.iloc[-1] > 0


@pytest.mark.parametrize("name", ["stable_baselines3", "skrl"])
@pytest.mark.slow
def test_policy_of_another_library_is_trained_saved_and_deployed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    errors = executed(code_of(name), monkeypatch, STEPS=500)["errors"]
    assert (tmp_path / "policy.safetensors").exists() and np.isfinite(errors).all(axis=None)
