# SPDX-License-Identifier: Apache-2.0
"""A stage that fails costs the report that stage and every name that rests on it, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hydro_core.signals import StateArray
from hydro_diagnosis import pipeline
from hydro_diagnosis.cli import run
from hydro_diagnosis.report import page
from hydro_diagnosis.stage_border import TRACEBACKS
from hydro_diagnosis.stages import reporting
from tests.segments import frame


def broken(*_: Any, **__: Any) -> Any:
    raise ZeroDivisionError("of this stage")


@pytest.fixture(scope="module")
def recording(nominal: StateArray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Force and position with a force that no effect explains."""
    path = tmp_path_factory.mktemp("border") / "run.csv"
    table = frame(nominal)[["time", "hydraulic_force", "piston_position"]]
    table["hydraulic_force"] += 30.0
    table.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("stage", "module", "name"),
    [
        ("naming", pipeline, "name_causes"), ("wiring", pipeline, "reconsider_wiring"),
        ("modelling", pipeline, "model_remainder"), ("curves", reporting, "curve_reports"),
        ("forecast", reporting, "forecasts"), ("report", reporting, "effect_reports"), ("page", page, "compare"),
        ("corrected", page, "write_corrected"),
    ],
)  # fmt: skip
def test_lost_stage_is_said_and_leaves_the_others(
    stage: str, module: Any, name: str, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    valid: Callable[[Any], Any], capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    broken_once = iter([broken])  # the report is built again without names
    working = getattr(module, name)
    monkeypatch.setattr(module, name, lambda *args, **how: next(broken_once, working)(*args, **how))
    assert run([str(recording), "--out", str(tmp_path), "--quiet"]) == 1
    report = json.loads((tmp_path / "report.json").read_text())
    valid(report)
    (lost,) = report["lost"]
    assert lost["stage"] == stage and "ZeroDivisionError: of this stage" in lost["sentence"]
    assert "in broken" in (tmp_path / TRACEBACKS).read_text()
    assert "Traceback" not in "".join(capsys.readouterr())
    names = [one["id"] for one in report["effects"]]
    assert names == ([] if stage in ("naming", "report") else ["force_offset"])
    assert (tmp_path / "report.html").exists()
    assert (tmp_path / "corrected.yaml").exists() == (stage != "corrected")


def test_without_a_reading_there_is_no_report_but_its_traceback(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pipeline, "prepare_best_wiring", broken)
    assert run([str(recording), "--out", str(tmp_path), "--quiet"]) == 1
    assert "there is no report" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [TRACEBACKS]
    monkeypatch.undo()
    assert run([str(recording), "--out", str(tmp_path), "--quiet"]) == 0
    assert not (tmp_path / TRACEBACKS).exists()
