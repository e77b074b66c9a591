# SPDX-License-Identifier: Apache-2.0
"""Runs of plant, box, guard and filter sample by sample without a graph, with the graph's delays, as fast as possible::

    k:   tick(x_k) -> BenchState_k -> filter -> delta_u_k          plant holds u_k -> x_{k+1}
    k+1: receive(delta_u_k)  tick(x_{k+1})                         a correction acts one sample after its state

The guard is opened to the box's limits: the gains that a MISMATCH costs are part of the run. Gains change at 100 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np

from hydro_bridge.safety.guard import CommandGuard, GuardSettings
from hydro_core.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_DTYPE,
    Command,
    Flag,
    FloatArray,
    ReferenceSignal,
    StateArray,
)
from hydro_filter.controller.loop_filter import Result
from hydro_filter.model.sample import Sample
from hydro_sim.box.box import Box, BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import Plant


class Corrector(Protocol):
    """Interface of a filter: one correction for each sample."""

    def reset(self) -> None:
        """Reset to the initial state."""

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide the correction of a sample that is `age` [s] old."""


class Run(NamedTuple):
    """Recorded run, up to the sample at which the box tripped, if it did."""

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
    """Simulate a trial; a filter with `bypass` set gives the loop without correction."""
    contraction_filter.reset()
    box, limits = Box(trial.bench, trial.box), trial.box
    # as wide as the box's limits, so that only the filter intervenes
    guard = CommandGuard(settings=replace(
        GuardSettings.of_size(trial.bench.size), delta_kp_min=limits.delta_kp_min, delta_kp_max=limits.delta_kp_max,
        delta_ki_min=limits.delta_ki_min, delta_ki_max=limits.delta_ki_max, delta_u_max=limits.delta_u_max,
        require_filter=False,
    ))  # fmt: skip
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
        results.append(contraction_filter.correct(Sample.from_record(states[k])))
        guard.add_sample(k)
        guard.set_correction(results[-1].delta_u, results[-1].status, k, now)
        if int(states["flags"][k]) & Flag.TRIPPED:
            return Run(states[: k + 1], results)
        measurement = plant.step(float(states["valve_current"][k]))
    return Run(states, results)
