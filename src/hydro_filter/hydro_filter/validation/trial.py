# SPDX-License-Identifier: Apache-2.0
"""Closed-loop simulation without a graph: plant, box and filter sample by sample, with the graph's delays.

::

    k:   tick(x_k) -> BenchState_k -> filter -> delta_u_k          plant holds u_k -> x_{k+1}
    k+1: receive(delta_u_k)  tick(x_{k+1})                         a correction acts one sample after its state

The plant's guard stands between, opened to what the box takes: what a filter that says MISMATCH costs in gains is
part of the run. Gains change at 100 Hz. The five numbers of the paper's Table val_cont come from `gammas`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import nan
from typing import NamedTuple, Protocol

import numpy as np

from hydro_bridge.safety.guard import CommandGuard, GuardSettings
from hydro_bridge.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_DTYPE,
    Command,
    CorrectionStatus,
    Flag,
    FloatArray,
    ReferenceSignal,
    StateArray,
)
from hydro_bridge.size import Size
from hydro_filter.controller.loop_filter import Result
from hydro_filter.model.sample import Sample
from hydro_sim.box.box import Box, BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant


class Corrector(Protocol):
    """A filter: one sample in, one correction out."""

    def reset(self) -> None:
        """Reset to the initial state."""

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide the correction of a sample that is `age` [s] old."""


class Run(NamedTuple):
    """Recorded run; it ends with the sample at which the box tripped."""

    states: StateArray
    """Records of `STATE_DTYPE`, shape (samples,)."""
    results: list[Result]
    """One per sample."""

    @property
    def bounded(self) -> bool:
        """Whether the box never tripped (force limit, sensor range)."""
        return not int(self.states["flags"][-1]) & Flag.TRIPPED


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One closed-loop simulation."""

    bench: Bench
    """Bench assumed by box and filter."""
    reference: ReferenceSignal
    gains: FloatArray
    """K_p [1/s], K_i [1/s^2] in force at 100 Hz, shape (policy steps, 2)."""
    box: BoxConfig = field(default_factory=BoxConfig)
    """Settings of the box."""
    seed: int = 0
    """Of the plant's noise."""


def run(trial: Trial, plant: Plant, contraction_filter: Corrector) -> Run:
    """Run a trial; use a filter with `bypass` set for the loop without it."""
    contraction_filter.reset()
    box = Box(trial.bench, trial.box)
    guard = CommandGuard(settings=permissive_guard(box.config, trial.bench.size))
    guard.set_arm(True)
    guard.set_reference(trial.reference)
    changes = np.asarray(trial.gains) - (box.config.base_kp, box.config.base_ki)
    states = np.empty(len(changes) * SAMPLES_PER_STEP, STATE_DTYPE)
    results: list[Result] = []
    box.receive(Command(), 0.0)
    measurement = plant.reset(trial.seed)
    for k in range(len(states)):
        now = k * SAMPLE_PERIOD
        if k % SAMPLES_PER_STEP == 0:
            delta_kp, delta_ki = (float(change) for change in changes[k // SAMPLES_PER_STEP])
            guard.set_gains(delta_kp, delta_ki, now)
        box.receive(guard.command(now), now)
        states[k] = box.tick(measurement, now)
        results.append(contraction_filter.correct(Sample.of(states[k])))
        guard.note_sample(k)
        guard.set_correction(results[-1].delta_u, results[-1].status, k, now)
        if int(states["flags"][k]) & Flag.TRIPPED:
            return Run(states[: k + 1], results)
        measurement = plant.step(float(states["valve_current"][k]))
    return Run(states, results)


def permissive_guard(box: BoxConfig, size: Size) -> GuardSettings:
    """A guard that allows all that the box accepts, so that the filter's effect is visible."""
    return replace(
        GuardSettings.of_size(size), delta_kp_min=box.delta_kp_min, delta_kp_max=box.delta_kp_max,
        delta_ki_min=box.delta_ki_min, delta_ki_max=box.delta_ki_max, delta_u_max=box.delta_u_max, require_filter=False,
    )  # fmt: skip


class Gammas(NamedTuple):
    """The paper's Table val_cont, with the shares named by what they count (physics.md, decisions)."""

    correction: float
    """gamma_1: mean |delta_u| over u_max."""
    violated_before: float
    """gamma_2: share of samples with M_c > 0 without the correction."""
    mean_before: float
    """gamma_3: mean M_c [1/s] without it."""
    violated_after: float
    """gamma_4: share with M_c > 0 under it."""
    mean_after: float
    """gamma_5: mean M_c [1/s] under it."""


def gammas(results: list[Result], current_max: float, tolerance: float = 1e-6) -> Gammas:
    """The five numbers over all samples that were evaluated; M_c within `tolerance` [1/s] of zero holds."""
    skipped = (CorrectionStatus.NAN, CorrectionStatus.STALE, CorrectionStatus.MISMATCH)
    table = np.array([result[:3] for result in results if result.status not in skipped] or [(nan, nan, nan)])
    correction, before, after = np.abs(table[:, 0]) / current_max, table[:, 1], table[:, 2]
    shares = (before > tolerance).mean(), (after > tolerance).mean()
    return Gammas(
        float(correction.mean()), float(shares[0]), float(before.mean()), float(shares[1]), float(after.mean())
    )
