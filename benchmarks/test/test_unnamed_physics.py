# SPDX-License-Identifier: Apache-2.0
"""Predictions on physics that no effect names: what is judged by is judged fairly, and kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import unnamed_physics
from benchmarks.beyond_the_table.kinds import KINDS
from benchmarks.unnamed_physics import DEFAULT, MODELS, NAMES, case_of, judged, left, recorded
from hydro_sim.files.recordings import Data, Run
from hydro_sim.identification import bench_learning
from hydro_sim.model.bench import Bench
from hydro_sim.model.quality import READINGS

pytestmark = pytest.mark.study
SEALED = {kind.name for kind in KINDS if kind.half == "sealed"}


def test_no_sealed_kind_is_used() -> None:
    assert not SEALED & set(NAMES)
    assert set(DEFAULT) <= set(NAMES)


@pytest.fixture(scope="module")
def clean() -> tuple[Data, Run]:
    return recorded(case_of("clean", 1), seconds=6.0)


@pytest.fixture(scope="module")
def drag() -> tuple[Data, Run]:
    return recorded(case_of("drag_square", 1), seconds=6.0)


def test_the_true_equations_leave_the_noise_and_missing_physics_shows(
    clean: tuple[Data, Run], drag: tuple[Data, Run]
) -> None:
    floors = left(Bench.nominal(), *clean)
    assert floors.shape == (len(READINGS),)
    assert np.all((floors > 0.9) & (floors < 1.3))
    assert left(Bench.nominal(), *drag).max() > 10.0


def test_the_judging_run_is_none_of_those_that_are_learnt_from(clean: tuple[Data, Run]) -> None:
    data, judge = clean
    for run in (*data.training, *data.validation):
        alike = min(len(run), len(judge))
        assert judge.name != run.name
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


def test_learn_refines_a_law_that_is_a_third_off(drag: tuple[Data, Run]) -> None:
    data, judge = drag
    size = case_of("drag_square", 1).size
    rough = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": size / 1.5}}
    found = bench_learning.learn(replace(Bench.nominal(), closures=(rough,)), data, count=40).bench
    assert found.closures[0]["parameters"]["coefficient"] == pytest.approx(size, rel=0.02)
    assert left(found, data, judge).max() < 1.3
