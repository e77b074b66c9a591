# SPDX-License-Identifier: Apache-2.0
"""The table of an evaluation says what each controller may ask for, and which is the best."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import STATE_DTYPE
from hydro_policy.compensation.estimator import LoadCell
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings, Score
from hydro_policy.task.cases import Trace, score
from hydro_sim.files import load_force
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph


def test_the_best_is_told_with_its_distance() -> None:
    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    session = EvaluationSession(EvaluationSettings(frequencies=(1.0, 2.0)), [FixedGains(90.0, 15.0)], graph)
    for name, errors in {"good": (1.0, 2.0), "next": (4.0, 4.0), "stopped": (0.1, math.nan)}.items():
        for case, rmse in zip(("1 Hz", "2 Hz"), errors, strict=True):
            session.scores.append(Score(controller=name, case=case, frequency=1.0, repeat=0, rmse=rmse))
    assert report.best(session) == "Best: good, with 0.25 to 0.50 times the error of the next, next."
    felt = {"good": 9.0, "next": 3.0, "stopped": 1.0}
    session.scores = [replace(one, true_rmse=felt[one.controller] + 0.0 * one.rmse) for one in session.scores]
    assert report.best(session).startswith("Best: good"), "the measured force is what is controlled"
    session.compensation = LiveCompensation(BoxLaw(), cell=LoadCell(bandwidth=25.0))
    assert report.best(session) == (
        "Best: next, with 0.33 to 0.33 times the error of the next, good, as the specimen feels it."
    )
    del session.scores[2:4]
    assert report.best(session) == ""


def test_an_emulated_plant_tells_the_error_of_the_force_on_the_specimen(tmp_path: Path) -> None:
    ring = load_force.create(tmp_path / "load_force")
    trace = Trace("one", "1 Hz", 1.0, np.zeros(3, STATE_DTYPE))
    trace.states["sequence"], trace.states["load_force"] = (7, 8, load_force.SAMPLES + 9), 1.0
    for sequence in trace.states["sequence"]:
        load_force.keep(ring, int(sequence), 3.0)
    found = score(trace, 0, felt=load_force.read(tmp_path / "load_force", trace.states["sequence"]))
    assert (found.rmse, found.true_rmse) == (1.0, 3.0)
    trace.states["sequence"][2] = 9  # not kept any more
    assert math.isnan(
        score(trace, 0, felt=load_force.read(tmp_path / "load_force", trace.states["sequence"])).true_rmse
    )

    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    session = EvaluationSession(EvaluationSettings(frequencies=(1.0,)), [FixedGains(90.0, 15.0)], graph)
    session.scores.append(replace(found, controller="fixed (90, 15)", repeat=0))
    assert report.table(session).rows[0]["1 Hz"] == "1.00 (3.00)"
