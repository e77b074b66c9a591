# SPDX-License-Identifier: Apache-2.0
"""Parallel evaluation runs without a graph: each bench of a fleet runs one case under one controller.

The protocol is that of `evaluation.session`: start from rest, settling, then whole periods over which e counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, STATE_FIELDS, Flag, FloatArray, StateArray
from hydro_policy.envs.vector_env import VectorBench, records
from hydro_policy.sac.policy import Policy
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_policy.task.mdp import ACTIONS, BASE, GainRange, observe

Chooser = Callable[[FloatArray], FloatArray]
"""Function from the last samples of all benches, shape (n, 14), to their gain changes, shape (n, 2)."""


@dataclass
class PolicyChooser:
    """Mean action of a policy, on every bench."""

    policy: Policy
    gains: GainRange
    _previous: FloatArray | None = None

    def __call__(self, samples: FloatArray) -> FloatArray:
        """See `Chooser`."""
        if self._previous is None:
            self._previous = np.zeros((len(samples), ACTIONS))
        self._previous = self.policy.act(observe(samples, self._previous))
        return self.gains.changes(self._previous)


def fixed(gains: FloatArray, base: tuple[float, float] = BASE) -> Chooser:
    """Return a chooser of fixed gains (K_p, K_i), shape (n, 2) or (2,)."""
    return lambda samples: np.broadcast_to(np.asarray(gains) - base, (len(samples), ACTIONS))


def rmse(
    fleet: VectorBench, cases: Sequence[Case], choose: Chooser, settings: EvaluationSettings, seed: int = 0
) -> FloatArray:
    """Return the force RMSE [N] of each run, shape (n,), where bench i runs `cases[i]`; NaN if the box tripped."""
    return _run(fleet, cases, choose, settings, seed, keep=False)[0]


def record(
    fleet: VectorBench, cases: Sequence[Case], choose: Chooser, settings: EvaluationSettings, seed: int = 0
) -> tuple[FloatArray, StateArray]:
    """Return the result of `rmse` and all samples after the first, shape (n, samples)."""
    return _run(fleet, cases, choose, settings, seed, keep=True)


def _run(
    fleet: VectorBench, cases: Sequence[Case], choose: Chooser, settings: EvaluationSettings, seed: int, *, keep: bool
) -> tuple[FloatArray, StateArray]:
    for index, case in enumerate(cases):
        fleet.begin(index, case.signal, seed)
    ends = np.array([round(settings.length(case) / SAMPLE_PERIOD) for case in cases])
    first = round(settings.settle / SAMPLE_PERIOD)
    squares, tripped = np.zeros(len(fleet)), np.zeros(len(fleet), bool)
    kept: list[StateArray] = []
    for start in range(1, int(ends.max()), SAMPLES_PER_STEP):
        samples = fleet.step(choose(records(fleet.samples[:, -1], STATE_FIELDS)))
        number = start + np.arange(SAMPLES_PER_STEP)
        counted = (number >= first) & (number < ends[:, np.newaxis])
        error = np.where(counted, samples["reference_force"] - samples["load_force"], 0.0)
        squares += np.sum(error * error, axis=1)
        tripped |= np.any(samples["flags"] & Flag.TRIPPED, axis=1)
        if keep:
            kept.append(samples.copy())
    errors = np.where(tripped, np.nan, np.sqrt(squares / (ends - first)))
    return errors, np.concatenate(kept, axis=1) if keep else fleet.samples
