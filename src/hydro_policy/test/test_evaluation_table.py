# SPDX-License-Identifier: Apache-2.0
"""The table of an evaluation says what each controller may ask for, and which is the best."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydro_bridge.signals import STATE_DTYPE
from hydro_policy.evaluation import report
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.session import EvaluationSession, EvaluationSettings
from hydro_policy.sessions.offline import OfflineGraph
from hydro_policy.task.cases import Trace, score
from hydro_sim.files import load_force
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant


def test_an_emulated_plant_tells_the_error_of_the_force_on_the_specimen(tmp_path: Path) -> None:
    ring = load_force.create(tmp_path / "load_force")
    trace = Trace("one", "1 Hz", 1.0, np.zeros(3, STATE_DTYPE))
    trace.states["sequence"], trace.states["load_force"] = (7, 8, load_force.SAMPLES + 9), 1.0
    for sequence in trace.states["sequence"]:
        load_force.keep(ring, int(sequence), 3.0)
    found = score(trace, 0, load_force.read(tmp_path / "load_force", trace.states["sequence"]))
    assert (found.rmse, found.true_rmse) == (1.0, 3.0)
    trace.states["sequence"][2] = 9  # not kept any more
    assert math.isnan(score(trace, 0, load_force.read(tmp_path / "load_force", trace.states["sequence"])).true_rmse)

    graph = OfflineGraph(AnalyticPlant(Bench.nominal()), Bench.nominal())
    session = EvaluationSession(EvaluationSettings(frequencies=(1.0,)), [FixedGains(90.0, 15.0)], graph)
    session.scores.append(replace(found, controller="fixed (90, 15)", repeat=0))
    assert report.table(session).rows[0]["1 Hz"] == "1.00 (3.00)"
