# SPDX-License-Identifier: Apache-2.0
"""Controllers on trial: 300 N sines on the emulated bench, and on what a simulation takes for it, without a graph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from demo.stages import Plan
from hydro_bridge.safety.guard import GuardSettings
from hydro_core.signals import STATE_DTYPE, Flag, StateArray
from hydro_policy.envs import vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.evaluation.controllers import Controller
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.pretraining.configurations import WIDE_GAINS
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.emulator.truth.config import load_truth
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant
from tests.offline_graph import OfflineGraph

SETTINGS = EvaluationSettings()
GRID = (15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0, 150.0, 200.0, 250.0, 300.0)
"""1/s, K_p of the fixed gains that a simulation is asked for the best of, K_i = 15 1/s^2."""
INTEGRAL = 15.0
SHOWN = 1.0
"""Hz, of the sine whose samples are kept."""
SEEN = Flag.ARMED | Flag.TRIPPED


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One controller on one plant."""

    rmse: dict[str, float]
    """N, by sine; NaN where the box tripped."""
    trace: StateArray
    """Samples at `SHOWN`, from arming to the end or to where the box tripped; time from 0."""

    @property
    def mean(self) -> float:
        """N, over the sines; NaN if it tripped at one."""
        return float(np.mean(list(self.rmse.values())))

    @property
    def trips(self) -> int:
        """Sines at which the box tripped."""
        return int(np.isnan(list(self.rmse.values())).sum())


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A controller, where it was chosen, and how it does."""

    name: str
    chosen: str
    """believed, corrected, or - for gains from elsewhere."""
    simulated: Outcome
    bench: Outcome


@dataclass
class Story:
    """What has happened so far."""

    plan: Plan
    report: dict[str, Any] = field(default_factory=dict)
    entries: list[Entry] = field(default_factory=list)

    def tried(self, name: str) -> list[Entry]:
        """Entries of the trainings called `name`."""
        return [entry for entry in self.entries if entry.name.startswith(name)]


def on_bench(controller: Controller, truth: Path, believed: Bench, seed: int = 0) -> Outcome:
    """On the emulated bench, whose box believes in `believed`."""
    config = load_truth(truth)
    return _trial(controller, lambda: TruthPlant(config, seed), believed, seed)


def in_simulation(controller: Controller, simulated: Bench, believed: Bench, seed: int = 0) -> Outcome:
    """On what a bench file says the bench is."""
    return _trial(controller, lambda: AnalyticPlant(simulated), believed, seed)


def best_fixed(simulated: Bench, believed: Bench) -> float:
    """K_p [1/s] with the smallest mean RMSE in a simulation, of `GRID`."""
    cases = list(SETTINGS.cases)
    plants: Sequence[Plant] = [AnalyticPlant(simulated) for _ in range(len(GRID) * len(cases))]
    gains = np.repeat([(kp, INTEGRAL) for kp in GRID], len(cases), axis=0)
    fleet = VectorBench([believed] * len(plants), plants)
    rmse = vector_runs.rmse(fleet, cases * len(GRID), vector_runs.fixed_gains(gains), SETTINGS)
    mean = rmse.reshape(len(GRID), len(cases)).mean(axis=1)
    return GRID[int(np.nanargmin(mean))]


class _Watched(OfflineGraph):
    """Keeps the armed samples of the run at `SHOWN`, and the first in which the box tripped."""

    def __init__(self, plant: Plant, believed: Bench, seed: int) -> None:
        guard = GuardSettings(delta_kp_max=WIDE_GAINS.delta_kp_max, delta_ki_max=WIDE_GAINS.delta_ki_max)
        super().__init__(plant, believed, guard=guard, seed=seed)
        self.seen: list[np.void] = []

    def sample(self) -> np.void:
        """See `OfflineGraph.sample`."""
        record = super().sample()
        ended = bool(self.seen) and bool(self.seen[-1]["flags"] & Flag.TRIPPED)
        if self.references and self.references[-1].frequency == SHOWN and record["flags"] & SEEN and not ended:
            self.seen.append(record.copy())
        return record


def _trial(controller: Controller, made: Callable[[], Plant], believed: Bench, seed: int) -> Outcome:
    """Each sine on a bench that starts from rest: a trip leaves nothing to the next."""
    errors: dict[str, float] = {}
    trace = np.empty(0, dtype=STATE_DTYPE)
    for frequency in SETTINGS.frequencies:
        graph = _Watched(made(), believed, seed)
        settings = replace(SETTINGS, frequencies=(frequency,))
        session = TrialRunner(Comparison(settings, [controller]), PlantSupervisor(graph, rearm=True))
        graph.run(session, 4.0 * session.plan.seconds)
        errors |= {score.case: score.rmse for score in session.scores}
        if graph.seen:
            trace = np.array(graph.seen, dtype=STATE_DTYPE)
            trace["time"] -= trace["time"][0]
    return Outcome(rmse=errors, trace=trace)
