# SPDX-License-Identifier: Apache-2.0
"""Other names to grow a closure upon: those beside which one law would leave least.

Where a law is missing, the names that explain most need not be those that are true: the judgement claims none, or wrong
ones, and no law then fits beside them. So names are looked at one by one, each with the law that is best beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np

from hydro_diagnosis.closure.screen import Screen
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import screen as screen_names

LIKELY = 12
"""Names that are looked at beside each set of names, the most promising first."""
LEFT = 0.6
"""Share of what is left without them that a name and a law may leave, to first order: once fitted, the right ones leave
nothing, but further numbers begin on a coarse grid."""
TRIED = 2
"""Openings that are grown upon at most, the best first."""


def openings(
    problem: Problem, base: Fit, screen: Screen, names: Sequence[Effect], left: float
) -> Iterator[tuple[Problem, Fit]]:
    """Fits with a name more than a base, or a name alone, and the problem under their weights, the best first.

    `left`: deviance above the noise that the best model without them leaves.
    """
    if not len(screen):
        return
    bases = [base] if not base.judged else [base, fit(problem, ())]
    found: list[tuple[float, tuple[Claim, ...]]] = []
    for one in bases:
        for name in screen_names(problem, one, names)[:LIKELY]:
            beside = fit(problem, (*one.claims, name.claim))
            (best,), there_is = screen.prospects(beside, 1)
            price = float(np.log(len(beside.residual))) * len(name.claim.effect.parameters)
            found.append((there_is - best.gain + price, beside.claims))
    found.sort(key=lambda one: one[0])
    for remains, claims in found[:TRIED]:
        if remains > LEFT * left:
            return
        weighed = copy(problem)  # its weights are its own, all else is shared
        weighed.update_weights(claims)
        yield weighed, fit(weighed, claims)
