# SPDX-License-Identifier: Apache-2.0
"""Answers are in the diagnosis' own terms, files are read and checked as the rigs say, claims are held against them."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import yaml

from benchmarks.real_recordings import __main__ as real
from hydro_diagnosis import Diagnosis
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.report_json import EffectReport, ParameterEstimate

DATA = Path(os.environ.get("HYDRO_REAL_RECORDINGS", Path(__file__).parents[3] / "shared" / "data"))
VERDICTS = {"no_mismatch", "explained", "modelled", "partly_explained", "unknown", "refused"}


@pytest.mark.parametrize("name", real.RIGS)
def test_a_rig_says_where_it_is_from_and_what_is_right(name: str) -> None:
    rig = yaml.safe_load(real.RIGS[name].read_text())
    assert rig["licence"] and rig["fitted"] and rig["answer"]["how"]
    assert rig["repository"] is None or len(rig["commit"]) == 40
    files = [*rig["fitted"].items(), *rig["held_out"].items()]
    assert len({Path(path).name for path, _ in files}) == len(files)
    assert all(len(digest) == 64 for _, digest in files)
    answer, numbers = rig["answer"], rig["answer"].get("numbers", {})
    known = {(one.id, parameter.name) for one in LIBRARY for parameter in one.parameters}
    assert {*answer["possible"], *real.known_ids(answer)} <= {id for id, _ in known}
    assert {(id, key) for id, one in numbers.items() for key in one} <= known and set(answer["verdict"]) <= VERDICTS
    values = [*answer.get("curve", ()), *(pair for one in numbers.values() for pair in one.values())]
    assert all(np.isfinite(row).all() for row in values)


def effect(name: str, **values: float) -> EffectReport:
    parameters = {
        key: ParameterEstimate(value=value, ci95=[0.95 * value, 1.05 * value], unit="") for key, value in values.items()
    }
    return EffectReport(id=name, equation="motion", options={}, sentence="", parameters=parameters, evidence={},
                        rivals=[], look_alikes=[])  # fmt: skip


RIG: dict[str, Any] = {"answer": {
    "verdict": ["explained"], "named": ["friction_coulomb", "friction_viscous"], "possible": ["friction_stribeck"],
    "numbers": {"friction_coulomb": {"force_positive": [20.0, 1.0]}},
    "curve": [[0.1, 30.0, 1.0], [-0.1, -40.0, 1.0]],
}}  # fmt: skip


def scored(verdict: str, *effects: EffectReport) -> real.Score:
    fit = {"holdout": {}, "equations": {"motion": {"rmse_before": 50.0, "rmse_after": 5.0}}}
    report = SimpleNamespace(verdict=verdict, effects=list(effects), closures=[], fit=fit, accounted={})
    return real.scored("rig", RIG, cast(Diagnosis, SimpleNamespace(report=report)))


def test_claims_are_held_against_the_answer() -> None:
    right = effect("friction_coulomb", force_positive=21.5, force_negative=30.0)
    more = effect("friction_stribeck", breakaway_force=8.5, velocity=1e3)
    score = scored("unknown", right, more, effect("end_cushion", stiffness=1e4))
    assert (score.agree, score.open) == (["friction_coulomb"], ["friction_stribeck"])
    assert score.missed == ["friction_viscous"]
    assert [one.split(":")[0] for one in score.contradict] == ["end_cushion"]
    assert not score.allowed and score.curve == [] and score.left == {"motion": 10.0}
    score = scored("explained", right, more)
    assert score.allowed and [one[-1] for one in score.curve] == [True, False]
    wrong = scored("explained", effect("friction_coulomb", force_positive=25.0))
    assert wrong.agree == [] and "answer 20" in wrong.contradict[0]


@pytest.mark.study
@pytest.mark.skipif(
    not (DATA / "emps").is_dir(),
    reason=f"no EMPS recordings in {DATA} (set HYDRO_REAL_RECORDINGS): they may not be passed on with this repository",
)
def test_emps_is_told_as_its_authors_published_it() -> None:
    score = real.carried_out("emps", DATA / "emps")
    assert score.verdict == "explained"
    assert score.agree == ["friction_coulomb", "friction_viscous"] and not score.contradict
    assert all(one[-1] for one in score.curve) and score.left["motion"] < 15.0
