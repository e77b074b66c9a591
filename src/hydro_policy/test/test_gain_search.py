# SPDX-License-Identifier: Apache-2.0
"""The search for the best fixed gains: on a made-up landscape, and on the real box and plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_bridge.safety.guard import GuardSettings
from hydro_bridge.signals import Flag
from hydro_policy.evaluation.gain_search import GridSearch, GridSession, GridSettings
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph

LIMIT = 127.0


def landscape(kp: float, ki: float) -> list[float]:
    """Best near (113, 22); unstable beyond `LIMIT`."""
    if kp > LIMIT:
        return [float("inf"), float("inf")]  # what a session tells of a pair that was stopped
    bowl = 1.0 + ((kp - 113.0) / 60.0) ** 2 + ((ki - 22.0) / 40.0) ** 2
    return [5.0 * bowl, 40.0 * bowl]


def test_search_finds_the_best_pair_and_never_climbs_beyond_the_first_that_is_stopped() -> None:
    search = GridSearch(GridSettings())
    while (pair := search.next()) is not None:
        search.tell(pair, landscape(*pair))
    assert abs(search.best[0] - 113.0) <= 7.5 and abs(search.best[1] - 22.0) <= 7.5
    assert max(kp for kp, _ in search.tried) <= LIMIT + GridSettings().kp_step
    assert [kp for kp, _ in search.tried if kp > LIMIT] == [150.0, 135.0, 127.5], "each below those stopped before"
    assert len(search.tried) < 30
    assert np.isinf(search.scores[(150.0, 15.0)])
    assert search.found


def test_grid_on_box_and_plant_ends_before_the_box_trips_and_finds_gains_that_track_well() -> None:
    bench = replace(Bench.nominal(), load_cell_bandwidth=25.0)  # unstable beyond some 100 1/s
    graph = OfflineGraph(AnalyticPlant(bench), bench, guard=GuardSettings(delta_kp_max=285.0, delta_ki_max=95.0))
    evaluation = EvaluationSettings(frequencies=(1.0, 2.0), settle=0.5, measure=1.0)
    settings = GridSettings(kp_min=60.0, ki_values=(15.0,), refinements=1)
    session = GridSession(settings, evaluation, graph)
    graph.run(session, 120.0)
    assert session.finished
    tried = session.search.tried
    assert 90.0 < max(kp for kp, _ in tried) < 200.0, "it rose to the edge and not far beyond"
    best = tried[session.search.best]
    assert np.mean(best / tried[(60.0, 15.0)]) < 1.0
    assert not any("force_limit" in sentence for sentence in graph.sentences)
    assert not int(graph.box.state["faults"][0]) & Flag.FORCE_LIMIT
