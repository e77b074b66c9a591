# SPDX-License-Identifier: Apache-2.0
"""Policy evaluation during pretraining: fixed cases on the nominal bench and on randomised benches drawn once.

A policy that saw a thousand drawn benches is not judged on the nominal one alone: whichever suits that bench best need
not bear another. Scores are relative to fixed gains on the same bench, so that a hard bench counts as an easy one does.
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
"""Share of the drawn benches that bear the reference gains at least; with fewer there is nothing to compare with."""

TRIPPED = 10.0
"""What a run counts in which the box trips, in RMSE of the reference gains."""


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
    """See the module.

    Parameters
    ----------
    fleet
        Makes that many of the known bench.
    believed
        The bench that the boxes believe in.
    evaluation
        The cases.
    draw
        The drawn bench of a number; None: the known one alone.
    drawn
        How many are drawn: the first ones on which the reference gains do not trip.
    base
        K_p [1/s], K_i [1/s^2] of the boxes.

    Raises
    ------
    ValueError
        Hardly any drawn bench bears the reference gains (`BEARABLE`).
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
        """N, RMSE of the reference gains, shape (benches, cases); where they trip, that of no tracking at all."""
        if draw is not None:
            for bench, rmse in islice(self._bearable(draw, reference, round(drawn / BEARABLE)), drawn):
                self._benches.append(bench)
                self.reference = np.concatenate((self.reference, rmse))

    def __call__(self, choose: Chooser) -> ExaminationResult:
        """Examine."""
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
