# SPDX-License-Identifier: Apache-2.0
"""The emulated bench with a change while it runs, under a filter and a guard: one run, and what it came to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hydro_bridge.safety.guard import GuardSettings
from hydro_bridge.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_FIELDS,
    CorrectionStatus,
    Flag,
    FloatArray,
    ReferenceSignal,
    StateArray,
)
from hydro_filter.controller.filter import Result
from hydro_filter.controller.loop_filter import LoopFilter
from hydro_filter.model.sample import Sample
from hydro_filter.validation.trial import Corrector
from hydro_policy.evaluation.controllers import Controller
from hydro_policy.sessions.offline import OfflineGraph
from hydro_policy.supervision.plant_supervisor import FALLBACK
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant

WIDE = GuardSettings(
    delta_kp_min=-55.0, delta_kp_max=285.0, delta_ki_min=-25.0, delta_ki_max=95.0, require_filter=False
)
"""All that the box takes."""


class Unwatched:
    """A filter that believes its model whatever comes: what it was before it watched itself."""

    def __init__(self, watched: LoopFilter) -> None:
        self.filter = watched

    def reset(self) -> None:
        """See `Corrector`."""
        self.filter.reset()

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """See `Corrector`."""
        self.filter.monitor["seen"] = 0
        return self.filter.correct(sample, age)


class ToldAtOnce(Unwatched):
    """A monitor that is told of the change in the sample in which it happens."""

    def __init__(self, watched: LoopFilter, change: int) -> None:
        super().__init__(watched)
        self.change = change
        self.samples = 0

    def reset(self) -> None:
        """See `Corrector`."""
        super().reset()
        self.samples = 0

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """See `Corrector`."""
        self.samples += 1
        if self.samples > self.change:
            return Result(0.0, math.nan, math.nan, CorrectionStatus.MISMATCH)
        return super().correct(sample, age)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a run came to, from the change on."""

    told: float
    """s from the change (or the arming) to the first MISMATCH; NaN: never."""
    early: bool
    """Whether it was told before the change."""
    rmse: float
    """N, of f_r - f_l."""
    peak: float
    """N, largest |f_r - f_l|."""
    worst_second: float
    """N, RMSE of the worst second."""
    jump: float
    """mA, largest change of the valve's current in a millisecond."""
    tripped: bool


def play(
    plant: Plant,
    bench: Bench,
    controller: Controller,
    reference: ReferenceSignal,
    *,
    corrector: Corrector | None = None,
    guard: GuardSettings = WIDE,
    seconds: float = 10.0,
    seed: int = 0,
) -> tuple[StateArray, FloatArray]:
    """Samples, shape (n,), and each one's `CorrectionStatus`, shape (n,), until the box trips.

    Under MISMATCH the gains are `FALLBACK`, as trainer and evaluate have it.
    """
    graph = OfflineGraph(plant, bench, guard=guard, seed=seed, corrector=corrector)
    controller.reset()
    if corrector is not None:
        corrector.reset()
    graph.reference(reference)
    records, statuses = [], []
    for k in range(round(seconds / SAMPLE_PERIOD)):
        graph.arm(k > 0)
        records.append(graph.sample().copy())
        statuses.append(int(graph.answer.status))
        if int(records[-1]["flags"]) & Flag.TRIPPED:
            break
        if k % SAMPLES_PER_STEP == 0:
            asked = controller.gains(np.array([records[-1][name] for name in STATE_FIELDS]))
            graph.gains(*(FALLBACK if statuses[-1] == CorrectionStatus.MISMATCH else asked), 0)
    return np.array(records), np.array(statuses, float)


def outcome(states: StateArray, statuses: FloatArray, change: int, begin: int = 0) -> Outcome:
    """Figures of a run whose bench changed at sample `change`; errors from `begin` or the change on."""
    at = np.flatnonzero(statuses == CorrectionStatus.MISMATCH)
    error = (states["reference_force"] - states["load_force"])[max(change, begin) :]
    if not len(error):
        error = np.array([np.nan])
    square = np.convolve(error**2, np.full(min(1000, len(error)), 1.0 / min(1000, len(error))), "valid")
    return Outcome(
        told=float(at[0] - change) * SAMPLE_PERIOD if len(at) else np.nan,
        early=bool(len(at) and at[0] < change),
        rmse=float(np.sqrt(np.mean(error**2))),
        peak=float(np.abs(error).max()),
        worst_second=float(np.sqrt(square.max())),
        jump=1e3 * float(np.abs(np.diff(states["valve_current"][change:])).max(initial=0.0)),
        tripped=bool(int(states["flags"][-1]) & Flag.TRIPPED),
    )
