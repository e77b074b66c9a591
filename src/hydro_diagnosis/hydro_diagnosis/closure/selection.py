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
from hydro_diagnosis.closure.screen import CHANCE, Screen, threshold
from hydro_diagnosis.closure.together import THRESHOLD, held_out_gain, mimics, paying, together
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import screen as screen_names
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
"""Share of the best's gain from which a law is fitted beside one that leaves nothing."""
NAMES = 3
"""Names that are fitted in place of a law."""
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
    """Laws and names that together leave nothing; else laws alone beside the names that stand."""
    screen = Screen(problem, base, laws(problem))
    beside = _grown_by_law(problem, base, screen, names)
    if beside.gain > 0.0 and not noticeable(beside.problem, beside.fit.residual) and _sound(beside):
        return beside
    alone = _grown_by_law(problem, base, screen) if _names(beside.fit) != _names(base) else beside
    if not names:
        return alone
    likely: dict[str, Effect] = {}
    for fitted in (base, beside.fit, alone.fit):
        likely |= {one.effect.label: one.effect for one in fitted.claims if isinstance(one.effect, Closure)}
        likely |= {one.effect.label: one.effect for one in screen.prospects(fitted, PROMISING)[0]}
    weighed = copy(problem)  # its weights are its own, all else is shared
    found = together(weighed, names, list(likely.values()))
    gain = held_out_gain(weighed, fit(weighed, base.claims), found)
    both = Closed(found, "law", gain, weighed)
    return both if not noticeable(weighed, found.residual) and _sound(both) else alone


def _sound(closed: Closed) -> bool:
    """Return whether there are as many laws as may be, and no coincidence of names."""
    room = min(TERMS, CLOSURES - len(closed.problem.bench.closures))
    return 0 < _terms(closed.fit) <= room and not coincidence(closed.fit.claims)


def _names(found: Fit) -> set[str]:
    return {claim.effect.label for claim in found.claims if not isinstance(claim.effect, Closure)}


def _grown_by_law(problem: Problem, base: Fit, screen: Screen, names: Sequence[Effect] = ()) -> Closed:
    """The fit with the laws that pay, and with `names` that do as well; what does not pay beside the others goes.

    In each round the best few of the screen are fitted, and the one with most evidence is taken, or a simpler one
    that has nearly as much.
    """
    weighed = copy(problem)  # its weights are its own, all else is shared
    current, tried = base, set[str]()
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - _terms(base))
    for _ in range(room + (NAMES if names else 0)):
        if not noticeable(weighed, current.residual):
            break
        fits = _laws_fitted(weighed, current, screen, tried) if _terms(current) - _terms(base) < room else []
        fits += _names_fitted(weighed, current, names) if _terms(current) > _terms(base) else []
        if not fits:
            break
        taken = _simplest(weighed, fits)
        tried -= {one.claims[-1].effect.label for one in fits if one is not taken}
        current = taken
        if not isinstance(taken.claims[-1].effect, Closure):
            weighed.update_weights(taken.claims)
            current = fit(weighed, taken.claims)
    if _terms(current) == _terms(base):
        return Closed(base, "law", 0.0, problem)
    current = paying(weighed, _exchanged(weighed, current, screen))  # what stood for another's numbers goes
    return Closed(current, "law", held_out_gain(weighed, fit(weighed, base.claims), current), weighed)


def _exchanged(problem: Problem, found: Fit, screen: Screen) -> Fit:
    """The fit with another in place of a law that does better beside all that came after, or as well and is simpler."""
    for claim in found.claims if len(found.claims) > 1 else ():
        if isinstance(claim.effect, Closure):
            others = fit(problem, tuple(one for one in found.claims if one is not claim))
            tried = {one.effect.label for one in found.claims}
            found = _simplest(problem, [found, *_laws_fitted(problem, others, screen, tried)], claim)
    return found


def _laws_fitted(problem: Problem, current: Fit, screen: Screen, tried: set[str]) -> list[Fit]:
    """Fits with one law more that pays, of the best of the screen; these are `tried` then."""
    prospects, there_is = screen.prospects(current, FITTED, tried)
    toll = threshold(len(screen))
    fits: list[Fit] = []
    disguised, clean = 0.0, False
    for one in prospects:
        enough = ALIKE * prospects[0].gain if clean else 0.0 if fits else (1.0 - CONDENSED) * disguised
        if one.gain < max(toll, LEAST * there_is, enough):
            break
        better = _fitted(problem, current, one.starts)
        tried.add(one.effect.label)
        if score(problem, current) - score(problem, better) < toll or mimics(problem, current, better):
            continue
        if not definite(problem, better, better.claims[-1]):
            disguised = max(disguised, one.gain)  # what gains less would stand in for the name or law that it is
        elif held_out_gain(problem, current, better) >= toll:
            fits.append(better)
            clean = clean or not noticeable(problem, better.residual)
    return fits


def _names_fitted(problem: Problem, current: Fit, names: Sequence[Effect]) -> list[Fit]:
    """Fits with one name more that pays."""
    fits = [fit(problem, (*current.claims, one.claim)) for one in screen_names(problem, current, names)[:NAMES]]
    enough = score(problem, current) - CHANCE
    return [one for one in fits if score(problem, one) < enough and not mimics(problem, current, one)]


def _simplest(problem: Problem, fits: Sequence[Fit], last: Claim | None = None) -> Fit:
    """Of the fits with nearly as much evidence as the best: a name, else the law of the fewest numbers and signals.

    The claim in question is the newest, of the first fit `last`, if that is given.
    """
    best = min(score(problem, one) for one in fits)

    def parts(one: Fit) -> tuple[int, int, float]:
        effect = (last if last and one is fits[0] else one.claims[-1]).effect
        if not isinstance(effect, Closure):
            return 0, 0, score(problem, one)
        return len(effect.parameters), len(effect.law.uses), score(problem, one)

    return min((one for one in fits if score(problem, one) <= best + CHANCE), key=parts)


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
