# SPDX-License-Identifier: Apache-2.0
"""The table of an evaluation says what each controller may ask for, and which is the best."""

from __future__ import annotations

import math

from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings, Score
from hydro_policy.sessions.offline import OfflineGraph
from hydro_policy.task.mdp import GainRange
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant


def test_a_table_has_each_controllers_authority() -> None:
    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    session = EvaluationSession(EvaluationSettings(frequencies=(1.0,)), [FixedGains(90.0, 15.0)], graph)
    session.scores.append(Score(controller="fixed (90, 15)", case="1 Hz", frequency=1.0, repeat=0, rmse=12.1))
    assert report.table(session).rows == [{"controller": "fixed (90, 15)", "authority": "90, 15", "1 Hz": 12.1}]


def test_the_best_is_told_with_its_distance() -> None:
    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    session = EvaluationSession(EvaluationSettings(frequencies=(1.0, 2.0)), [FixedGains(90.0, 15.0)], graph)
    for name, errors in {"good": (1.0, 2.0), "next": (4.0, 4.0), "stopped": (0.1, math.nan)}.items():
        for case, rmse in zip(("1 Hz", "2 Hz"), errors, strict=True):
            session.scores.append(Score(controller=name, case=case, frequency=1.0, repeat=0, rmse=rmse))
    assert report.best(session) == "Best: good, with 0.25 to 0.50 times the error of the next, next."
    del session.scores[2:4]
    assert report.best(session) == ""


def test_authority_is_what_the_gains_are_in_all() -> None:
    reach = GainRange(delta_kp_min=0.0, delta_kp_max=75.0, delta_ki_min=0.0, delta_ki_max=10.0)
    assert report.authority(reach, (20.0, 5.0)) == "20 to 95, 5 to 15"
