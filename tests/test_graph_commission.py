# SPDX-License-Identifier: Apache-2.0
"""Commissioning on the emulator: gates in their order, resumed after an interruption, and what its record keeps."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import Companion, executable_path
from hydro_core.files import site
from hydro_policy.commissioning.record import FAILED, PASSED, PENDING, GateError, Record, best, digests
from hydro_policy.nodes import evaluate
from hydro_policy.nodes.commission import GATE_NAMES, LONGER, comparison, diagnosis
from hydro_policy.nodes.plant_options import apply_site
from hydro_policy.nodes.site_runs import Site
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.nodes import sim
from tests.checks import ran, wait
from tests.domains import own_domain

BENCH = {"spring_stiffness": 3.5e4, "supply_pressure": 1.2e7, "piston_area": 2.6e-4}
OVERLAP = 4e-4  # A


@pytest.fixture
def foreign(tmp_path: Path) -> Iterator[list[str]]:
    """Words for a bench that is not the nominal one, whose valve has an overlap that its file does not tell."""
    bench, truth = tmp_path / "own.yaml", tmp_path / "truth.yaml"
    bench.write_text(yaml.safe_dump(Bench.nominal().to_mapping() | BENCH))
    effects = {"valve_deadband": {"half_width": OVERLAP}}
    truth.write_text(yaml.safe_dump({"profile": "default", "bench": BENCH, "effects": effects}))
    with own_domain():
        yield ["--site", str(tmp_path / "site"), "--plant", "emulator", "--bench", str(bench), "--truth", str(truth)]


def record(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "site" / "commission.json").read_text())
    return found


def interrupted(words: list[str], line: str) -> list[str]:
    """Run until it prints a line, then press Ctrl-C; all that it printed."""
    said: list[str] = []
    keep = lambda text: said.append(text.partition("] ")[2].strip())  # noqa: E731
    with Companion("hydro_policy", "commission", words, output=keep) as running:
        wait(lambda: any(each.startswith(line) for each in said) or not running.running, 240.0)
        assert running.stop(60.0) == 130, said
    return said


@pytest.mark.graph
def test_an_interrupted_commissioning_goes_on_where_it_was(foreign: list[str], tmp_path: Path) -> None:
    interrupted(foreign, "== signs")
    before = record(tmp_path)["gates"]
    assert [gate["status"] for gate in before[:3]] == [PASSED, PASSED, PENDING]
    assert not (tmp_path / "site" / "port").exists(), "the emulator runs on"
    said = interrupted(foreign[:2], "== signs")  # the site keeps plant and bench
    assert "link: passed before" in said
    assert [line for line in said if line.startswith("== ")] == ["== signs"]
    assert record(tmp_path)["gates"][:2] == before[:2]


@pytest.mark.graph
@pytest.mark.study  # minutes: the metric
@pytest.mark.timeout(1500)
def test_a_foreign_bench_is_commissioned_without_a_word_typed(foreign: list[str], tmp_path: Path) -> None:
    done = ran(executable_path("hydro_policy", "commission"), *foreign, timeout=1400.0)
    found = record(tmp_path)
    assert done.returncode == 0, (found["gates"], done.stderr)
    overlap = next(cause for cause in found["causes"] if cause["id"] == "valve_deadband")
    assert overlap["parameters"]["half_width"]["value"] == pytest.approx(OVERLAP, rel=0.05)
    low, high = found["certified_gains"]["compensated"]
    assert low <= BoxConfig().of_bench(Bench.load(tmp_path / "own.yaml")).compensated.base_kp <= high
    rmse = {key: max(found["comparison"][key]["rmse"].values()) for key in ("best_fixed", "compensated")}
    assert found["adopted"] in ("compensated", "residual")
    assert rmse["compensated"] < 0.6 * rmse["best_fixed"]


def test_a_site_stands_for_the_options_of_each_executable(tmp_path: Path) -> None:
    for name in (site.BENCH_FILE, site.MODEL_FILE, site.METRIC_FILE):
        (tmp_path / name).touch()
    (tmp_path / site.RECORD_FILE).write_text('{"base_gains": [20.0, 4.0]}')
    words = ["--site", str(tmp_path)]
    for plant, model in (("sim", tmp_path / site.MODEL_FILE), ("bench", None)):
        asked = evaluate.parser().parse_args(["--plant", plant, *words])
        apply_site(asked)
        assert (asked.bench, asked.model, asked.base_gains) == (tmp_path / site.BENCH_FILE, model, [20.0, 4.0])
        assert asked.filter == f"--model {tmp_path / site.MODEL_FILE} --metric {tmp_path / site.METRIC_FILE}"
    _, asked = sim.plant_factory(words, [])
    assert (asked.bench, asked.model) == (tmp_path / site.BENCH_FILE, tmp_path / site.MODEL_FILE)


def test_a_gate_holds_as_long_as_its_files_do(tmp_path: Path) -> None:
    made = Record.load(tmp_path, GATE_NAMES)
    (tmp_path / "bench.yaml").write_text("one: 1\n")
    for gate in made.gates[:3]:
        gate.status, gate.files = PASSED, digests(tmp_path, ["bench.yaml"])
    made.gates[3].status, made.adopted = FAILED, "compensated"
    made.comparison = {"compensated": {"name": "compensated", "rmse": {}, "trips": 0}}
    made.write(tmp_path)
    again = Record.load(tmp_path, GATE_NAMES)
    assert again == made
    assert again.reset_invalid_gates(tmp_path, len(GATE_NAMES)) == 3
    assert again.reset_invalid_gates(tmp_path, 2) == 2 and not again.adopted and not again.comparison
    (tmp_path / "bench.yaml").write_text("one: 2\n")
    assert Record.load(tmp_path, GATE_NAMES).reset_invalid_gates(tmp_path, len(GATE_NAMES)) == 0


def test_a_controller_that_was_stopped_or_under_which_the_piston_stood_is_left_out(tmp_path: Path) -> None:
    """A force that stands has 212 N RMSE of a sine of 300 N."""
    entries: dict[str, Any] = {
        "base": {"name": "fixed (15, 5)", "rmse": {"1 Hz": 211.0, "2 Hz": 212.0}, "trips": 0},
        "best_fixed": {"name": "fixed (90, 15)", "rmse": {"1 Hz": 211.0, "2 Hz": 150.0}, "trips": 0},
        "compensated": {"name": "compensated", "rmse": {"1 Hz": 212.0, "2 Hz": 180.0}, "trips": 0},
    }
    made = Record(amplitude=300.0, comparison=entries)
    at = Site(tmp_path, made, rearm=True, policy=False, seconds=24.0, log=sys.stderr)
    with pytest.raises(GateError, match=r"completed .*: fixed \(15, 5\), fixed .*, compensated: .* piston stood"):
        comparison(at)
    entries["compensated"]["rmse"] = {"1 Hz": 190.0, "2 Hz": 180.0}
    assert comparison(at).startswith("compensated is the best; left out: fixed (15, 5), fixed (90, 15): the load force")
    assert made.adopted == "compensated"
    entries["compensated"] |= {"rmse": {"1 Hz": None, "2 Hz": 1.0}, "trips": 1}
    assert best(entries) == "best_fixed" and best({"policy": {"rmse": {}, "trips": 0}}) == ""


def test_a_diagnosis_that_does_not_explain_is_repeated_with_a_longer_budget(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    at, budgets = Site(tmp_path, Record(), rearm=True, policy=False, seconds=10.0, log=sys.stderr), []

    def diagnose(*words: str) -> None:
        budgets.append(float(words[-1]))
        out = tmp_path / site.REPORTS_FOLDER / "diagnosis"
        out.mkdir(parents=True)
        (out / site.MODEL_FILE).touch()
        verdict = "modelled" if len(budgets) == 1 else "explained"
        (out / "report.json").write_text(json.dumps({"verdict": verdict, "effects": []}))

    monkeypatch.setattr(at, "run", diagnose)
    assert diagnosis(at) == "explained: no cause"
    assert budgets == [10.0, LONGER * 10.0]
