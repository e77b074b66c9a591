# SPDX-License-Identifier: Apache-2.0
"""Controllers on trial: 300 N sines on the emulated bench, and on what a simulation takes for it, without a graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydro_bridge.guard import GuardSettings
from hydro_bridge.signals import StateArray
from hydro_policy import fleet_runs
from hydro_policy.configurations import WIDE
from hydro_policy.controllers import Controller
from hydro_policy.evaluation import EvaluationSession, EvaluationSettings
from hydro_policy.fleet import Fleet
from hydro_policy.offline import OfflineGraph
from hydro_sim.bench import Bench
from hydro_sim.emulator.truth import TruthPlant
from hydro_sim.emulator.truth_config import load_truth
from hydro_sim.plant import AnalyticPlant, Plant

SETTINGS = EvaluationSettings()
GRID = (15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0, 150.0, 200.0, 250.0, 300.0)
"""1/s, K_p of the fixed gains that a simulation is asked for the best of, K_i = 15 1/s^2."""
INTEGRAL = 15.0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One controller on one plant."""

    rmse: dict[str, float]
    """N, by sine; NaN where the box tripped."""
    trace: StateArray | None
    """Samples at 1 Hz; None if it tripped there."""

    @property
    def mean(self) -> float:
        """N, over the sines; NaN if it tripped at one."""
        return float(np.mean(list(self.rmse.values())))

    @property
    def trips(self) -> int:
        """Sines at which the box tripped."""
        return int(np.isnan(list(self.rmse.values())).sum())


def on_bench(controller: Controller, truth: Path, believed: Bench, seed: int = 0) -> Outcome:
    """On the emulated bench, whose box believes in `believed`."""
    return _trial(controller, TruthPlant(load_truth(truth), seed), believed, seed)


def in_simulation(controller: Controller, simulated: Bench, believed: Bench, seed: int = 0) -> Outcome:
    """On what a bench file says the bench is."""
    return _trial(controller, AnalyticPlant(simulated), believed, seed)


def best_fixed(simulated: Bench, believed: Bench) -> float:
    """K_p [1/s] with the smallest mean RMSE in a simulation, of `GRID`."""
    cases = list(SETTINGS.cases)
    plants: Sequence[Plant] = [AnalyticPlant(simulated) for _ in range(len(GRID) * len(cases))]
    gains = np.repeat([(kp, INTEGRAL) for kp in GRID], len(cases), axis=0)
    fleet = Fleet([believed] * len(plants), plants)
    rmse = fleet_runs.rmse(fleet, cases * len(GRID), fleet_runs.fixed(gains), SETTINGS)
    mean = rmse.reshape(len(GRID), len(cases)).mean(axis=1)
    return GRID[int(np.nanargmin(mean))]


def _trial(controller: Controller, plant: Plant, believed: Bench, seed: int) -> Outcome:
    guard = GuardSettings(delta_kp_max=WIDE.delta_kp_max, delta_ki_max=WIDE.delta_ki_max)
    graph = OfflineGraph(plant, believed, guard=guard, seed=seed)
    session = EvaluationSession(SETTINGS, [controller], graph)
    graph.run(session, 4.0 * session.seconds)
    traces = {trace.case: trace.states for trace in session.traces}
    return Outcome(rmse={score.case: score.rmse for score in session.scores}, trace=traces.get("1 Hz"))
