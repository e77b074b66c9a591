# SPDX-License-Identifier: Apache-2.0
"""Parallel evaluation runs without a graph: each of the vectorised benches runs one case under one controller.

As in `evaluation.runner`: settling, then a measured part of whole periods; the runs start from rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, STATE_FIELDS, Flag, FloatArray, Law, StateArray
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.compensation.residual import AdaptedLaw, Residual
from hydro_policy.envs.vector_env import VectorBench, records
from hydro_policy.sac.policy import Policy
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_policy.task.mdp import ACTION_SIZE, BASE_GAINS, GainRange, observe

VectorController = Callable[[FloatArray], FloatArray]
"""Function from the last samples of all benches, shape (n, 14), to their gain changes, shape (n, 2)."""


@dataclass
class VectorPolicyController:
    """Vectorised controller that applies the mean action of a policy on every bench."""

    policy: Policy
    gains: GainRange
    _previous: FloatArray | None = None

    def __call__(self, samples: FloatArray) -> FloatArray:
        """See `VectorController`."""
        if self._previous is None:
            self._previous = np.zeros((len(samples), ACTION_SIZE))
        self._previous = self.policy.act(observe(samples, self._previous, self.policy.size))
        return self.gains.changes(self._previous)


def fixed_gains(gains: FloatArray, base: tuple[float, float] = BASE_GAINS) -> VectorController:
    """Return a vectorised controller of fixed gains (K_p, K_i), shape (n, 2) or (2,)."""
    return lambda samples: np.broadcast_to(np.asarray(gains) - base, (len(samples), ACTION_SIZE))


@dataclass(frozen=True)
class VectorStep:
    """Samples of all benches in one policy step."""

    samples: StateArray  # shape (n, 10); overwritten by the next step
    counted: npt.NDArray[np.bool_]  # whether each is measured: after settling and within the run, shape (n, 10)


def rmse(
    vector_bench: VectorBench,
    cases: Sequence[Case],
    controller: VectorController,
    settings: EvaluationSettings,
    seed: int = 0,
    compensator: Compensator | None = None,
) -> FloatArray:
    """Return the force RMSE [N] of each run, shape (n,), where bench i runs `cases[i]`; NaN if the box tripped."""
    n = len(vector_bench)
    squares, count, tripped = np.zeros(n), np.zeros(n), np.zeros(n, bool)
    for step in run(vector_bench, cases, controller, settings, seed, compensator):
        error = np.where(step.counted, step.samples["reference_force"] - step.samples["load_force"], 0.0)
        squares += np.sum(error * error, axis=1)
        count += step.counted.sum(axis=1)
        tripped |= np.any(step.samples["flags"] & Flag.TRIPPED, axis=1)
    return np.where(tripped, np.nan, np.sqrt(squares / count))


def run(
    vector_bench: VectorBench,
    cases: Sequence[Case],
    controller: VectorController,
    settings: EvaluationSettings,
    seed: int = 0,
    compensator: Compensator | None = None,
    residual: Residual | None = None,
) -> Iterator[VectorStep]:
    """Run `cases[i]` on bench i, yielding each policy step; with a compensator under the compensated law."""
    law = Law.PAPER if compensator is None else Law.COMPENSATED
    adapted = None if compensator is None else AdaptedLaw(compensator, residual)
    for index, case in enumerate(cases):
        vector_bench.reset(index, case.signal, seed, law=law)
    ends = np.array([round(settings.duration(case) / SAMPLE_PERIOD) for case in cases])
    first = round(settings.settle / SAMPLE_PERIOD)
    recorded = [(index, case) for index, case in enumerate(cases) if case.segments]
    for start in range(1, int(ends.max()), SAMPLES_PER_STEP):
        for index, case in recorded:
            if (signal := case.signal_due(start - 1 - SAMPLES_PER_STEP, start - 1)) is not None:
                vector_bench.set_reference(index, signal)
        changes = controller(records(vector_bench.samples[:, -1], STATE_FIELDS))
        samples = vector_bench.step_adapted(changes, adapted)
        number = start + np.arange(SAMPLES_PER_STEP)
        yield VectorStep(samples, (number >= first) & (number < ends[:, np.newaxis]))
