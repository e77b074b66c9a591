# SPDX-License-Identifier: Apache-2.0
"""Grid search for the best fixed gains on the bench itself, the baseline for a policy.

coarse    for each K_i, K_p rises in steps until the loop is stopped (monitor, box) or oscillates, so that gains far
          beyond the bench's limit are never tried
fine      the eight neighbours of the best pair at half the step, then at a quarter
score     mean over the references of the RMSE relative to the best of any pair on that reference
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hydro_core.settings import check, quantity
from hydro_core.signals import FloatArray
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.trial import Plan, Trial
from hydro_policy.task.cases import EvaluationSettings, Score, relative_scores
from hydro_policy.task.mdp import GainRange

GainPair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class GridSettings:
    """Settings of the grid search: range and resolution of the gains."""

    kp_min: Annotated[float, quantity("1/s", 0.0, 500.0)] = 60.0
    """K_p begins to rise there: not so low that the monitor stops a run for its lag."""
    kp_max: Annotated[float, quantity("1/s", 0.0, 500.0)] = 300.0
    """K_p is never above."""
    kp_step: Annotated[float, quantity("1/s", 1.0, 100.0)] = 30.0
    """Coarse step of K_p."""
    ki_values: tuple[Annotated[float, quantity("1/s^2", 0.0, 500.0)], ...] = (15.0, 45.0)
    """Coarse values of K_i; the fine steps begin at half their distance."""
    ki_min: Annotated[float, quantity("1/s^2", 0.0, 500.0)] = 5.0
    """K_i is never below."""
    ki_max: Annotated[float, quantity("1/s^2", 0.0, 500.0)] = 100.0
    """K_i is never above."""
    refinements: Annotated[int, quantity("-", 0, 5)] = 2
    """Halvings of the step."""
    abort_ratio: Annotated[float, quantity("-", 1.0, 100.0)] = 2.0
    """K_p rises no further where the score is this much above the best: the loop cycles already."""

    def __post_init__(self) -> None:
        check(self)
        if self.kp_min > self.kp_max:
            raise ValueError(f"a grid begins at K_p = {self.kp_min:g}, which is above its largest, {self.kp_max:g}")


def coarse_grid(gains: GainRange, base: tuple[float, float]) -> GridSettings:
    """Return a coarse grid, five values of K_p at one K_i, up to the largest total gains of `gains` and `base`."""
    kp_max, ki = base[0] + gains.delta_kp_max, min(30.0, base[1] + gains.delta_ki_max)
    kp_min = min(60.0, kp_max)
    return GridSettings(
        kp_min=kp_min, kp_max=kp_max, kp_step=max(0.25 * (kp_max - kp_min), 1.0), ki_min=min(5.0, ki), ki_values=(ki,),
        refinements=0,
    )  # fmt: skip


class GridSearch:
    """Grid search over pairs (K_p, K_i): proposes pairs, takes their RMSE; independent of the bench."""

    def __init__(self, settings: GridSettings) -> None:
        self.settings = settings
        self.results: dict[GainPair, FloatArray] = {}
        """Force RMSE [N] on each reference by pair (K_p, K_i); infinite where the run was stopped."""
        self._pairs = self._search()
        self._next = next(self._pairs, None)

    def next(self) -> GainPair | None:
        """Return the next pair to try; None when the search is complete."""
        return self._next

    def add_result(self, pair: GainPair, rmse: Sequence[float]) -> None:
        """Record a pair's RMSE on each reference; infinite or NaN: it was stopped."""
        self.results[pair] = np.nan_to_num(np.asarray(rmse, float), nan=np.inf, posinf=np.inf)
        self._next = next(self._pairs, None)

    def _search(self) -> Iterator[GainPair]:
        limits = self.settings
        for ki in limits.ki_values:  # coarse
            kp, promising = limits.kp_min, True
            while promising:
                yield kp, ki
                promising = self.scores[kp, ki] < limits.abort_ratio * min(self.scores.values())
                kp += limits.kp_step
                promising = promising and kp <= limits.kp_max and kp < self._edge
        spacing = float(np.diff(limits.ki_values).mean()) if len(limits.ki_values) > 1 else None
        for halving in range(1, limits.refinements + 1):  # fine
            (kp, ki), half = self.best, 0.5**halving
            steps = half * limits.kp_step, half * (2.0 * ki if spacing is None else spacing)
            for p, i in [(kp + i * steps[0], ki + j * steps[1]) for i in (-1, 0, 1) for j in (-1, 0, 1)]:
                allowed = limits.kp_min <= p <= limits.kp_max and limits.ki_min <= i <= limits.ki_max
                if allowed and (p, i) not in self.results and p < self._edge:
                    yield p, i

    @property
    def scores(self) -> dict[GainPair, float]:
        """Score by pair: mean over references of RMSE relative to the smallest there; infinite if a run was stopped."""
        return {**dict.fromkeys(self.results, np.inf), **relative_scores(self.results)}

    @property
    def any_completed(self) -> bool:
        """Whether any pair completed every reference."""
        return bool(relative_scores(self.results))

    @property
    def best(self) -> GainPair:
        """Pair with the smallest score; without `any_completed` a stopped one."""
        scores = self.scores
        return min(scores, key=scores.__getitem__)

    @property
    def _edge(self) -> float:
        """Smallest K_p [1/s] that had to be stopped: neither it nor any above is tried again."""
        return min((kp for (kp, _), rmse in self.results.items() if not np.isfinite(rmse).all()), default=np.inf)


class GridPlan(Plan):
    """Plan of a grid search: for each pair of gains a trial on each reference, until one is stopped or disturbed.

    `settings`: the grid. `evaluation`: references and lengths. `base`: base gains of the box, K_p [1/s], K_i [1/s^2].
    """

    def __init__(self, settings: GridSettings, evaluation: EvaluationSettings, base: tuple[float, float]) -> None:
        self.search, self.evaluation, self._base = GridSearch(settings), evaluation, base
        self.set_trials(self._pair_by_pair())

    def _pair_by_pair(self) -> Generator[Trial, Score, None]:
        cases = self.evaluation.cases
        while (pair := self.search.next()) is not None:
            controller, rmse = FixedGains(*pair, self._base), list[float]()
            for case in cases:
                score = yield Trial(
                    controller=controller, case=case, settle=self.evaluation.settle,
                    measure=self.evaluation.measured_time(case),
                )  # fmt: skip
                self.done += 1
                if score.stopped or score.disturbed:  # a disturbed trial is not informative
                    rmse = [np.inf] * len(cases)
                    break
                rmse.append(score.rmse)
            self.search.add_result(pair, rmse)

    @property
    def best(self) -> FixedGains:
        """The best gains as a controller."""
        return FixedGains(*self.search.best, self._base, "best fixed")
