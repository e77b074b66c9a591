# SPDX-License-Identifier: Apache-2.0
"""Selection of closure terms: a law of few terms if it does nearly as well as a smooth function, else that function.

Terms are added one after the other by what they gain on blocks of time that they were not fitted to (`evidence`); after
each, all numbers, those of the names too, are estimated anew. Where such laws leave something, names and laws are
searched together: names that the judgement dropped may come back, and names that it made may go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hydro_diagnosis.closure.alternatives import merged, openings, renamed
from hydro_diagnosis.closure.candidates import PROMISING, Candidates, laws, tables
from hydro_diagnosis.closure.evidence import THRESHOLD, barred, held_out_gain, in_disguise, mimics, paying
from hydro_diagnosis.closure.growth import CONDENSED, LEAST, TERMS, Closed, Rounds, count_terms, grown_by_law
from hydro_diagnosis.closure.screen import Screen
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import SearchSettings, score
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.selection.verdict import MOST_OF_THE_GAP, Assessment, coincidence
from hydro_sim.model.effects.catalogue import CLOSURES

SETTINGS = SearchSettings(restarts=1, effort=1500)
"""Less effort than for names alone: a missing law is found first."""


def closures(problem: Problem, assessment: Assessment, names: Sequence[Effect] = ()) -> Iterator[Closed]:
    """Models of the remainder, the preferred first; none where no term holds on held-out blocks.

    `names`: causes that may stand beside a law though the judgement does not claim them. A smooth function is looked
    for only where laws leave something, or are refused.
    """
    if not assessment.remainder:
        return
    closed = barred(problem, assessment.fit)
    by_law = _by_law(problem, assessment.fit, names, closed)
    left = noticeable(by_law.problem, by_law.fit.residual)
    if not left and by_law.gain > 0.0:
        by_law = renamed(merged(by_law), names)
        yield by_law
    by_table = _by_table(by_law if left else Closed(assessment.fit, "smooth", 0.0, problem, by_law.screen), closed)
    both = (by_law, by_table) if by_law.gain >= (1.0 - CONDENSED) * by_table.gain else (by_table, by_law)
    yield from (renamed(one, names) for one in (both if left else (by_table,)) if one.gain > 0.0)


def _open(terms: Sequence[Claim], closed: frozenset[str]) -> list[Claim]:
    """Terms of equations other than these."""
    return [one for one in terms if not one.effect.touches & closed]


def _by_law(problem: Problem, base: Fit, names: Sequence[Effect], closed: frozenset[str]) -> Closed:
    """Laws and names that together leave nothing; else laws alone beside the names that stand."""
    screen = Screen(problem, base, _open(laws(problem), closed))
    rounds = Rounds(screen)
    upon = _upon_others(problem, base, screen, rounds, names)
    if upon is not None:
        return upon
    beside = grown_by_law(problem, base, rounds, names)
    if beside.gain > 0.0 and not noticeable(beside.problem, beside.fit.residual) and _sound(beside):
        return beside
    alone = grown_by_law(problem, base, rounds) if _names(beside.fit) != _names(base) else beside
    if not names or alone.gain >= MOST_OF_THE_GAP * screen.gains(base)[1]:
        return alone  # a small remainder of the right law's form is no reason to look for names
    likely: dict[str, Effect] = {}
    for fitted in (base, beside.fit, alone.fit):
        likely |= {one.effect.label: one.effect for one in fitted.claims if isinstance(one.effect, Closure)}
        likely |= {one.effect.label: one.effect for one in screen.prospects(fitted, PROMISING)[0]}
    weighed, found = together(problem, names, list(likely.values()))
    gain = held_out_gain(weighed, fit(weighed, base.claims), found)
    both = Closed(found, "law", gain, weighed, screen)
    return both if not noticeable(weighed, found.residual) and _sound(both) else alone


def together(problem: Problem, names: Sequence[Effect], laws: Sequence[Effect]) -> tuple[Problem, Fit]:
    """Names and laws that account for the recordings together, and the problem with their weights."""
    outcome = Search(problem, (*names, *laws), SETTINGS).run()
    problem, found = outcome.problem, outcome.fit
    while True:
        kept = paying(problem, found)
        if len(kept.claims) == len(found.claims):
            return problem, kept
        problem = problem.weighed(kept.claims)
        found = fit(problem, kept.claims)


def _upon_others(problem: Problem, base: Fit, screen: Screen, rounds: Rounds, names: Sequence[Effect]) -> Closed | None:
    """A law upon other names than those that stand, if it leaves nothing and no single law beside these does."""
    first = [base, *rounds.fits(problem, base, set())]
    if not all(noticeable(problem, one.residual) for one in first):
        return None
    left = min(screen.gains(one)[1] for one in first)
    for weighed, opening in openings(problem, base, screen, names, left):
        if all(noticeable(weighed, one.residual) for one in rounds.fits(weighed, opening, set())):
            continue
        grown = grown_by_law(weighed, opening, rounds, names)
        if grown.gain > 0.0 and not noticeable(grown.problem, grown.fit.residual) and _sound(grown):
            gain = held_out_gain(grown.problem, fit(grown.problem, base.claims), grown.fit)
            return replace(grown, gain=gain)
    return None


def _sound(closed: Closed) -> bool:
    """Return whether there are as many laws as may be, and no coincidence of names."""
    room = min(TERMS, CLOSURES - len(closed.problem.bench.closures))
    return 0 < count_terms(closed.fit) <= room and not coincidence(closed.fit.claims)


def _names(found: Fit) -> set[str]:
    return {claim.effect.label for claim in found.claims if not isinstance(claim.effect, Closure)}


def _by_table(below: Closed, closed: frozenset[str]) -> Closed:
    """Tables upon names, and upon laws that leave something; laws that do not pay beside them go.

    Names stay: a table takes the form of any of them.
    """
    problem, before = below.problem, below.fit
    fitted = paying(
        problem,
        _grown_by_table(problem, before, Candidates(problem, before, _open(tables(problem), closed))),
        names_stay=True,
    )
    if {claim.effect.label for claim in fitted.claims} <= {claim.effect.label for claim in before.claims}:
        return Closed(before, "smooth", 0.0, problem, below.screen)  # no table, or none that pays
    return Closed(fitted, "smooth", below.gain + held_out_gain(problem, before, fitted), problem, below.screen)


def _grown_by_table(problem: Problem, base: Fit, tried: Candidates) -> Fit:
    """The fit with the tables that pay."""
    current = base
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - count_terms(base))
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
        if in_disguise(problem, better, better.claims[-1]):
            continue
        taken += 1
        current = better
    return current
