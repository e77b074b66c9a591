# SPDX-License-Identifier: Apache-2.0
"""Shortlists of a search: the candidates beside each set of claims, found by first-order looks, fitted by secants.

Each is fitted when somebody asks for so little promise, in full only when it comes near to being claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hydro_diagnosis.effects.base import Effect
from hydro_diagnosis.estimation.fit import Fit, fit, with_one_more
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import Prospect, Signatures, screen
from hydro_diagnosis.selection.outcome import SearchSettings, score

SCREEN_TOLERANCE = 1.0
"""Gain in deviance below which a candidate's fit is good enough to be ranked by."""
SAME_DOUBT = 1e-3
"""Relative change of the doubt below which fits with other claims are not made anew."""


@dataclass
class _Looked:
    """Candidates beside a base that was looked at."""

    doubt: tuple[float, ...]
    """`Problem.doubted` at that time."""
    waiting: list[Prospect]
    """Those that are not fitted yet."""
    fits: list[Fit] = field(default_factory=list)
    """With one claim more."""
    polished: set[str] = field(default_factory=set)
    """Labels of those that are fitted in full."""


def _labels(base: Fit) -> frozenset[str]:
    return frozenset(claim.effect.label for claim in base.claims)


class Shortlists:
    """Candidates beside every base that a search has looked at."""

    def __init__(self, problem: Problem, library: Sequence[Effect], settings: SearchSettings) -> None:
        self._problem, self._library, self._settings = problem, library, settings
        self._looked: dict[frozenset[str], _Looked] = {}
        """By the labels of a base."""
        self._signatures = Signatures()

    def renew(self) -> None:
        """Compute what candidates do to the residuals anew, from the next base on."""
        self._signatures = Signatures()

    def beside(self, base: Fit, promised: float, but: str = "") -> list[Fit]:
        """Fits with one claim more, the best first, by secants from the slopes of the base, as far as not polished.

        `promised`: gain to first order from which on candidates are fitted, all `but` one; the others wait.
        """
        looked = self._looked.get(_labels(base))
        if looked is None:
            prospects = screen(self._problem, base, self._library, self._signatures)[: self._settings.shortlist]
            hopeful = [prospect for prospect in prospects if prospect.gain > 0.5 * self._settings.threshold]
            looked = self._looked[_labels(base)] = _Looked(self._problem.doubted, hopeful)
        elif not np.allclose(looked.doubt, self._problem.doubted, rtol=SAME_DOUBT, atol=0.0):
            again = [Prospect(one.claims[-1], np.inf) for one in looked.fits]
            looked = self._looked[_labels(base)] = _Looked(self._problem.doubted, [*again, *looked.waiting])
        now = [one for one in looked.waiting if one.gain >= promised and one.claim.effect.label != but]
        looked.waiting = [one for one in looked.waiting if one not in now]
        looked.fits += [with_one_more(self._problem, base, one.claim, tolerance=SCREEN_TOLERANCE) for one in now]
        looked.fits.sort(key=lambda one: score(self._problem, one))
        return [one for one in looked.fits if one.claims[-1].effect.label != but]

    def polish(self, base: Fit, enough: float, most: int = 1000) -> None:
        """Fit in full those that score `enough` with one claim more than a base, the best and `most` of them."""
        looked = self._looked[_labels(base)]
        for k, one in enumerate(looked.fits[:most]):
            label = one.claims[-1].effect.label
            if label not in looked.polished and score(self._problem, one) <= enough:
                looked.fits[k] = fit(self._problem, one.claims, tolerance=SCREEN_TOLERANCE)
                looked.polished.add(label)
        looked.fits.sort(key=lambda one: score(self._problem, one))
