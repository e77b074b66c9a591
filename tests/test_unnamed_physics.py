# SPDX-License-Identifier: Apache-2.0
"""Predictions on physics that no effect names: what is judged by is judged fairly, and kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import unnamed_physics
from benchmarks.beyond_the_table.kinds import KINDS
from benchmarks.unnamed_physics import DEFAULT, MODELS, NAMES, case_of, judged, left, recorded
from hydro_sim.model.bench import Bench
from hydro_sim.model.quality import READINGS

SEALED = {kind.name for kind in KINDS if kind.half == "sealed"}


def test_no_sealed_kind_is_used() -> None:
    assert not SEALED & set(NAMES)
    assert set(DEFAULT) <= set(NAMES)


def test_the_true_equations_leave_the_noise_and_missing_physics_shows() -> None:
    clean = left(Bench.nominal(), *recorded(case_of("clean", 1), seconds=6.0))
    drag = left(Bench.nominal(), *recorded(case_of("drag_square", 1), seconds=6.0))
    assert clean.shape == (len(READINGS),)
    assert np.all((clean > 0.9) & (clean < 1.3))
    assert drag.max() > 10.0


def test_the_judging_run_is_none_of_those_that_are_learnt_from() -> None:
    data, judge = recorded(case_of("clean", 1), seconds=6.0)
    learnt = {name for run in (*data.training, *data.validation) for name in (run.name,)}
    assert judge.name not in learnt
    for run in (*data.training, *data.validation):
        alike = min(len(run), len(judge))
        assert abs(np.corrcoef(run.x[:alike, 2], judge.x[:alike, 2])[0, 1]) < 0.7


def test_what_is_kept_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = {"left": [1.0] * len(READINGS), "cpu": 1.0, "terms": ""}
    (tmp_path / "models.json").write_text(json.dumps(dict.fromkeys(list(MODELS)[1:], row)))
    asked = []
    monkeypatch.setattr(unnamed_physics, "recorded", lambda case: asked.append(case.name) or (None, None))
    monkeypatch.setattr(unnamed_physics, "left", lambda model, data, judge: np.full(len(READINGS), 2.0))
    first = list(judged(case_of("clean", 1), tmp_path))
    again = list(judged(case_of("clean", 1), tmp_path))
    assert asked == ["clean_0"]
    assert first == again
    assert [one["model"] for one in first] == list(MODELS)
    assert [one["left"][0] for one in first] == [2.0, 1.0, 1.0, 1.0, 1.0]
