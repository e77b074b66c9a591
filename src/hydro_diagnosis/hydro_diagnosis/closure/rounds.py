# SPDX-License-Identifier: Apache-2.0
"""Rounds of growth: the laws that pay beside a fit, the best few of the screen fitted with all further numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hydro_diagnosis.closure.disguise import in_disguise
from hydro_diagnosis.closure.evidence import definite
from hydro_diagnosis.closure.rounding import newest_turned
from hydro_diagnosis.closure.screen import Screen, threshold
from hydro_diagnosis.closure.together import held_out_gain, mimics
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.addition import written
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score

LEAST = 0.02
"""Share of the possible gain that a term must bring: less is mimicry of another form."""
CONDENSED = 0.05
"""Share of a smooth function's gain by which a law may fall short of it."""
FITTED = 5
"""Laws that are fitted in each round, the best of the screen."""
ALIKE = 0.8
"""Share of the best's gain from which a law is fitted beside one that leaves nothing."""
PATIENCE = 24
"""Iterations of a fit at most: a law's further numbers begin on a coarse grid."""


class Rounds:
    """Rounds over a screen. Each is gone through once: growth with names and growth without them begin alike."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._known: dict[tuple[Any, ...], tuple[Any, list[Fit], set[str]]] = {}

    def fits(self, problem: Problem, current: Fit, tried: set[str]) -> list[Fit]:
        """Fits with one law more that pays, of the best that are not `tried`; they are `tried` then."""
        key = id(problem.weights), written(current.claims), frozenset(tried)
        if key not in self._known:
            now = set(tried)
            self._known[key] = problem.weights, self._fitted(problem, current, now), now
        _weights, fits, now = self._known[key]
        tried |= now
        return list(fits)

    def _fitted(self, problem: Problem, current: Fit, tried: set[str]) -> list[Fit]:
        prospects, there_is = self._screen.prospects(current, FITTED, tried)
        toll = threshold(len(self._screen))
        fits: list[Fit] = []
        disguised, clean = 0.0, False
        for one in prospects:
            enough = ALIKE * prospects[0].gain if clean else 0.0 if fits else (1.0 - CONDENSED) * disguised
            if one.gain < max(toll, LEAST * there_is, enough):
                break
            better = from_starts(problem, current, one.starts)
            if noticeable(problem, better.residual):
                better = newest_turned(problem, better)
            tried.add(one.effect.label)
            if score(problem, current) - score(problem, better) < toll or mimics(problem, current, better):
                continue
            if not definite(problem, better, better.claims[-1]):
                disguised = max(disguised, one.gain)  # what gains less would stand in for the name or law that it is
            elif in_disguise(problem, better, better.claims[-1]):
                continue
            elif held_out_gain(problem, current, better) >= toll:
                fits.append(better)
                clean = clean or not noticeable(problem, better.residual)
        return fits


def from_starts(problem: Problem, current: Fit, starts: Sequence[Claim]) -> Fit:
    """The fit with a term from the first start at which its further numbers come to be known, else from the best."""
    fits = []
    for start in starts:
        fits.append(fit(problem, (*current.claims, start), iterations=PATIENCE))
        if definite(problem, fits[-1], fits[-1].claims[-1]):
            return fits[-1]
    return fits[0]
