# SPDX-License-Identifier: Apache-2.0
"""Policy evaluation during pretraining: fixed cases on the nominal bench and on randomised benches drawn once.

A policy trained on a thousand drawn benches is not scored on the nominal one alone: the best one there may fail on
another. Scores are relative to fixed gains on the same bench, so that hard and easy benches count alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_policy.envs import vector_runs
from hydro_policy.envs.randomisation import RandomisedBench
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.envs.vector_runs import Chooser
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_policy.task.mdp import BASE
from hydro_sim.model.bench import Bench

REFERENCE_GAINS = (90.0, 15.0)
"""K_p, K_i of the paper's controller III, which scores are relative to."""

BEARABLE = 0.02
"""Minimum share of drawn benches on which the reference gains do not trip, so that there is a basis of comparison."""

TRIPPED = 10.0
"""Score of a run in which the box trips, in RMSE of the reference gains."""


@dataclass(frozen=True)
class ExaminationResult:
    """Result of an examination."""

    rmse: FloatArray
    """N, shape (benches, cases), the first bench is the known one; NaN: tripped."""
    ratio: FloatArray
    """`rmse` over that of the reference gains there; `TRIPPED` where it tripped."""

    @property
    def score(self) -> float:
        """Mean ratio over all benches and cases; 1: as good as the reference gains."""
        return float(self.ratio.mean())

    @property
    def changed(self) -> float | None:
        """Mean ratio over the drawn benches; None without any."""
        return float(self.ratio[1:].mean()) if len(self.ratio) > 1 else None


class Examination:
    """Examination of a policy on fixed cases (see the module's docstring).

    Parameters
    ----------
    fleet
        Returns a fleet of the given number of the known bench.
    believed
        Bench assumed by the boxes.
    evaluation
        Cases.
    draw
        Returns the drawn bench of a number; None: only the known bench.
    drawn
        Number of drawn benches: the first ones on which the reference gains do not trip.
    base
        K_p [1/s], K_i [1/s^2] of the boxes.

    Raises
    ------
    ValueError
        The reference gains trip on too many drawn benches (`BEARABLE`).
    """

    def __init__(
        self,
        fleet: Callable[[int], VectorBench],
        believed: Bench,
        evaluation: EvaluationSettings,
        draw: Callable[[int], RandomisedBench] | None = None,
        drawn: int = 0,
        base: tuple[float, float] = BASE,
    ) -> None:
        self._make, self._believed, self._evaluation = fleet, believed, evaluation
        self._benches: list[RandomisedBench] = []
        reference = vector_runs.fixed(np.array(REFERENCE_GAINS), base)
        known = self._rmse(reference, [None])
        self.reference: FloatArray = np.where(np.isnan(known), evaluation.amplitude / math.sqrt(2.0), known)
        """RMSE of the reference gains [N], shape (benches, cases); where they trip, that of no tracking at all."""
        if draw is not None:
            for bench, rmse in islice(self._bearable(draw, reference, round(drawn / BEARABLE)), drawn):
                self._benches.append(bench)
                self.reference = np.concatenate((self.reference, rmse))

    def __call__(self, choose: Chooser) -> ExaminationResult:
        """Examine the policy."""
        rmse = self._rmse(choose, [None, *self._benches])
        return ExaminationResult(rmse, np.where(np.isnan(rmse), TRIPPED, rmse / self.reference))

    def _bearable(
        self, draw: Callable[[int], RandomisedBench], reference: Chooser, tries: int
    ) -> Iterator[tuple[RandomisedBench, FloatArray]]:
        for number in range(tries):
            bench = draw(number)
            rmse = self._rmse(reference, [bench])
            if np.isfinite(rmse).all():
                yield bench, rmse
        raise ValueError(f"of {tries} drawn benches too few bear the fixed gains {REFERENCE_GAINS} to be examined on")

    def _rmse(self, choose: Chooser, benches: Sequence[RandomisedBench | None]) -> FloatArray:
        cases = self._evaluation.cases
        fleet, played = self._make(len(benches) * len(cases)), list(cases) * len(benches)
        for index, case in enumerate(played):
            bench = benches[index // len(cases)]
            if bench is not None:
                fleet.replace(index, self._believed, bench.plant, bench.gain_delay, bench.dead_time)
                played[index] = _within_reach(case, bench)
        return vector_runs.rmse(fleet, played, choose, self._evaluation).reshape(len(benches), len(cases))


def _within_reach(case: Case, bench: RandomisedBench) -> Case:
    return replace(case, signal=bench.within_reach(case.signal))
