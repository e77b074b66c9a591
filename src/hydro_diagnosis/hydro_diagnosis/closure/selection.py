# SPDX-License-Identifier: Apache-2.0
"""Selection of closure terms: a law of few terms if it does nearly as well as a smooth function, else that function.

Terms are added one after the other by what they gain on blocks of time that they were not fitted to (`evidence`); after
each, all numbers, those of the names too, are estimated anew. Where such laws leave something, names and laws are
searched together (`together`): names that the judgement dropped may come back, and names that it made may go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.closure.candidates import PROMISING, Candidates, laws, tables
from hydro_diagnosis.closure.evidence import definite
from hydro_diagnosis.closure.screen import Screen, threshold
from hydro_diagnosis.closure.together import THRESHOLD, held_out_gain, mimics, paying, together
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score
from hydro_diagnosis.selection.verdict import Assessment, coincidence
from hydro_sim.model.effects.catalogue import CLOSURES

TERMS = 3
"""Largest number of terms of a law."""
LEAST = 0.02
"""Share of the possible gain that a term must bring: less is mimicry of another form."""
CONDENSED = 0.05
"""Share of a smooth function's gain by which a law may fall short of it."""
FITTED = 5
"""Laws that are fitted in each round, the best of the screen."""
ALIKE = 0.8
"""Share of the best's gain from which a law is fitted beside one that holds."""
PATIENCE = 24
"""Iterations of a fit at most: a law's further numbers begin on a coarse grid."""


@dataclass(frozen=True)
class Closed:
    """Names and closure estimated together."""

    fit: Fit
    form: str
    """law or smooth."""
    gain: float
    """Held-out deviance that it gains over the names alone."""
    problem: Problem
    """The problem with the weights of the fit."""


def closures(problem: Problem, assessment: Assessment, names: Sequence[Effect] = ()) -> Iterator[Closed]:
    """Models of the remainder, the preferred first; none where no term holds on held-out blocks.

    `names`: causes that may stand beside a law though the judgement does not claim them. A smooth function is looked
    for only where laws leave something, or are refused.
    """
    if not assessment.remainder:
        return
    by_law = _by_law(problem, assessment.fit, names)
    left = noticeable(by_law.problem, by_law.fit.residual)
    if not left and by_law.gain > 0.0:
        yield by_law
    by_table = _by_table(by_law if left else Closed(assessment.fit, "smooth", 0.0, problem))
    both = (by_law, by_table) if by_law.gain >= (1.0 - CONDENSED) * by_table.gain else (by_table, by_law)
    yield from (one for one in (both if left else (by_table,)) if one.gain > 0.0)


def _by_law(problem: Problem, base: Fit, names: Sequence[Effect]) -> Closed:
    """Laws beside the names that stand; if they leave something, names and laws that together leave nothing."""
    screen = Screen(problem, base, laws(problem))
    grown, gain = _grown_by_law(problem, base, screen)
    if gain > 0.0 and len((kept := paying(problem, grown)).claims) < len(grown.claims):
        grown, gain = kept, held_out_gain(problem, base, kept)  # names or terms that stood for another's numbers
    one_by_one = Closed(grown, "law", gain, problem)
    if not names or (gain > 0.0 and not noticeable(problem, grown.residual)):
        return one_by_one
    likely: dict[str, Effect] = {
        claim.effect.label: claim.effect for claim in grown.claims if isinstance(claim.effect, Closure)
    }
    for fitted in (base, grown):
        likely |= {one.effect.label: one.effect for one in screen.prospects(fitted, PROMISING)[0]}
    weighed = copy(problem)  # its weights are its own, all else is shared
    found = together(weighed, names, list(likely.values()))
    room = min(TERMS, CLOSURES - len(problem.bench.closures))
    if noticeable(weighed, found.residual) or coincidence(found.claims) or not 0 < _terms(found) <= room:
        return one_by_one  # where something remains, names may be there for want of what is missing: none is forced
    return Closed(found, "law", held_out_gain(weighed, fit(weighed, base.claims), found), weighed)


def _grown_by_law(problem: Problem, base: Fit, screen: Screen) -> tuple[Fit, float]:
    """The fit with the laws that pay, and the held-out deviance that they gain.

    In each round the best few of the screen are fitted, and the one with most evidence is taken.
    """
    current, gained, tried = base, 0.0, set[str]()
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - _terms(base))
    toll = threshold(len(screen))
    while _terms(current) - _terms(base) < room and noticeable(problem, current.residual):
        prospects, there_is = screen.prospects(current, FITTED, tried)
        fits: list[tuple[Fit, float]] = []
        disguised = 0.0
        for one in prospects:
            enough = ALIKE * prospects[0].gain if fits else (1.0 - CONDENSED) * disguised
            if one.gain < max(toll, LEAST * there_is, enough):
                break
            better = _fitted(problem, current, one.starts)
            tried.add(one.effect.label)
            if score(problem, current) - score(problem, better) < toll or mimics(problem, current, better):
                continue
            if not definite(problem, better, better.claims[-1]):
                disguised = max(disguised, one.gain)  # what gains less would stand in for the name or law that it is
                continue
            gain = held_out_gain(problem, current, better)
            if gain < toll:
                continue
            fits.append((better, gain))
        if not fits:
            break
        taken, gain = min(fits, key=lambda one: score(problem, one[0]))
        tried -= {one.claims[-1].effect.label for one, _ in fits if one is not taken}
        current, gained = taken, gained + gain
    return current, gained


def _by_table(below: Closed) -> Closed:
    """Tables upon names, and upon laws that leave something; laws that do not pay beside them go.

    Names stay: a table takes the form of any of them.
    """
    problem, before = below.problem, below.fit
    fitted = paying(
        problem, _grown_by_table(problem, before, Candidates(problem, before, tables(problem))), names_stay=True
    )
    if {claim.effect.label for claim in fitted.claims} <= {claim.effect.label for claim in before.claims}:
        return Closed(before, "smooth", 0.0, problem)  # no table, or none that pays
    return Closed(fitted, "smooth", below.gain + held_out_gain(problem, before, fitted), problem)


def _terms(found: Fit) -> int:
    return sum(isinstance(claim.effect, Closure) for claim in found.claims)


def _grown_by_table(problem: Problem, base: Fit, tried: Candidates) -> Fit:
    """The fit with the tables that pay."""
    current = base
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - _terms(base))
    taken = 0
    while taken < room and tried.terms and noticeable(problem, current.residual):
        gains, there_is = tried.gains(problem, current)
        best = int(np.argmax(gains))
        if gains[best] < max(THRESHOLD, LEAST * there_is):
            break
        start = tried.terms[best]
        tried = tried.without(start.effect.label)
        better = fit(problem, (*current.claims, start))
        if score(problem, current) - score(problem, better) < THRESHOLD or mimics(problem, current, better):
            continue
        taken += 1
        current = better
    return current


def _fitted(problem: Problem, current: Fit, starts: Sequence[Claim]) -> Fit:
    """The fit with a term from the first start at which its further numbers come to be known, else from the best."""
    fits = []
    for start in starts:
        fits.append(fit(problem, (*current.claims, start), iterations=PATIENCE))
        if definite(problem, fits[-1], fits[-1].claims[-1]):
            return fits[-1]
    return fits[0]
