# SPDX-License-Identifier: Apache-2.0
"""Selection of closure terms: a law of few terms if it does nearly as well as a smooth function, else that function.

Terms are added one after the other by what they gain on blocks of time that they were not fitted to (`evidence`); after
each, all numbers, those of the names too, are estimated again. Where such laws leave something, names and laws are
searched together: names that the judgement dropped may come back, and names that it made may go.

Three further searches mend what forward selection misses. `merged`: a name and a law, or two laws, may share what one
law does alone (drag that fades is viscous friction less a stiffness that creeps). `renamed`: a cause that a law hid may
be another term in disguise. `starting_points`: the names that explain most need not be those that are true.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from hydro_diagnosis.closure.evidence import (
    THRESHOLD,
    barred_equations,
    equals_ruled_out,
    equivalent_causes,
    has_identified_shapes,
    held_out_deviance,
    held_out_gain,
    within_form_error,
    without_idle_terms,
)
from hydro_diagnosis.closure.forward_selection import (
    CONDENSED,
    LEAST,
    TERMS,
    ClosureFit,
    ForwardSelection,
    count_terms,
    from_starts,
    select_laws,
    with_reversal_velocity,
)
from hydro_diagnosis.closure.screen import CHANCE, PROMISING, Prospect, Screen, laws, tables, ways_beside
from hydro_diagnosis.effects.base import LOAD, MOTION, Claim, Effect, FloatArray
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.fit import screen as screen_names
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.judge import NEARLY_ALL, coincidence
from hydro_diagnosis.model.responses import Responses
from hydro_diagnosis.selection.search import Search, SearchSettings
from hydro_sim.model.effects.catalogue import CLOSURES
from hydro_sim.model.tables import Table

SETTINGS = SearchSettings(restarts=1, effort=1500)
"""Settings of the joint search: less effort than for names alone, since a missing law is found first."""


def closures(problem: Problem, base: Fit, names: Sequence[Effect] = ()) -> Iterator[ClosureFit]:
    """Yield models of what a fit leaves, the preferred first; none where no term holds on held-out blocks.

    `names`: causes that may stand beside a law though the judgement does not claim them. A smooth function is looked
    for only where laws leave something, or are refused.
    """
    closed = barred_equations(problem, base)
    by_law = _by_law(problem, base, names, closed)
    if problem.budget.exhausted:
        yield from [by_law] if by_law.gain > 0.0 else []
        return
    left = by_law.problem.noticeable(by_law.fit.residual)
    if not left and by_law.gain > 0.0:
        by_law = renamed(merged(by_law), names)
        yield by_law
    by_table = _by_table(by_law if left else ClosureFit(base, "smooth", 0.0, problem, by_law.screen), closed)
    both = (by_law, by_table) if by_law.gain >= (1.0 - CONDENSED) * by_table.gain else (by_table, by_law)
    yield from (renamed(one, names) for one in (both if left else (by_table,)) if one.gain > 0.0)


def _open(terms: Sequence[Claim], closed: frozenset[str]) -> list[Claim]:
    """Return the terms that act in none of these blocks."""
    return [one for one in terms if not one.effect.blocks & closed]


def _by_law(problem: Problem, base: Fit, names: Sequence[Effect], closed: frozenset[str]) -> ClosureFit:
    """Return laws and names that together leave no remainder, else laws alone beside the present names."""
    screen = Screen(problem, base, _open(laws(problem), closed))
    forward = ForwardSelection(screen)
    upon = _upon_others(problem, base, screen, forward, names)
    if upon is not None:
        return upon
    beside = select_laws(problem, base, forward, names)
    complete = beside.gain > 0.0 and not beside.problem.noticeable(beside.fit.residual)
    if problem.budget.exhausted or (complete and _sound(beside)):
        return beside
    alone = select_laws(problem, base, forward) if _names(beside.fit) != _names(base) else beside
    if problem.budget.exhausted or not names or alone.gain >= NEARLY_ALL * screen.gains(base)[1]:
        return alone  # a small remainder of the right law's form is no reason to look for names
    likely: dict[str, Effect] = {}
    for fitted in (base, beside.fit, alone.fit):
        likely |= {one.effect.label: one.effect for one in fitted.claims if isinstance(one.effect, Closure)}
        likely |= {one.effect.label: one.effect for one in screen.prospects(fitted, PROMISING)[0]}
    weighed, found = together(problem, names, list(likely.values()))
    gain = held_out_gain(weighed, fit(weighed, base.claims), found)
    both = ClosureFit(found, "law", gain, weighed, screen)
    return both if not weighed.noticeable(found.residual) and _sound(both) else alone


def together(problem: Problem, names: Sequence[Effect], laws: Sequence[Effect]) -> tuple[Problem, Fit]:
    """Search names and laws jointly; return the fit, and the problem with its weights."""
    outcome = Search(problem, (*names, *laws), SETTINGS).run()
    problem, found = outcome.problem, outcome.fit
    while True:
        kept = without_idle_terms(problem, found)
        if len(kept.claims) == len(found.claims):
            return problem, kept
        problem = problem.weighed(kept.claims)
        found = fit(problem, kept.claims)


def _upon_others(
    problem: Problem, base: Fit, screen: Screen, forward: ForwardSelection, names: Sequence[Effect]
) -> ClosureFit | None:
    """Return a law beside other names than the present ones, if it leaves no remainder and no law beside these does."""
    first = [base, *forward.fits(problem, base)[0]]
    if not all(problem.noticeable(one.residual) for one in first):
        return None
    left = min(screen.gains(one)[1] for one in first)
    for weighed, opening in starting_points(problem, base, screen, names, left):
        if problem.budget.exhausted:
            break
        if all(weighed.noticeable(one.residual) for one in forward.fits(weighed, opening)[0]):
            continue
        grown = select_laws(weighed, opening, forward, names)
        if grown.gain > 0.0 and not grown.problem.noticeable(grown.fit.residual) and _sound(grown):
            gain = held_out_gain(grown.problem, fit(grown.problem, base.claims), grown.fit)
            return replace(grown, gain=gain)
    return None


def _sound(closed: ClosureFit) -> bool:
    """Return whether there are as many laws as may be, and no coincidence of names."""
    room = min(TERMS, CLOSURES - len(closed.problem.bench.closures))
    return 0 < count_terms(closed.fit) <= room and not coincidence(closed.fit.claims)


def _names(found: Fit) -> set[str]:
    return {claim.effect.label for claim in found.claims if not isinstance(claim.effect, Closure)}


def _by_table(below: ClosureFit, closed: frozenset[str]) -> ClosureFit:
    """Return tables beside names, and beside laws that leave a remainder; insignificant laws are dropped.

    Names stay: a table takes the form of any of them.
    """
    problem, before = below.problem, below.fit
    fitted = without_idle_terms(
        problem,
        _grown_by_table(problem, before, _open(tables(problem), closed)),
        names_stay=True,
    )
    if {claim.effect.label for claim in fitted.claims} <= {claim.effect.label for claim in before.claims}:
        return ClosureFit(before, "smooth", 0.0, problem, below.screen)  # no table, or none that pays
    return ClosureFit(fitted, "smooth", below.gain + held_out_gain(problem, before, fitted), problem, below.screen)


def _grown_by_table(problem: Problem, base: Fit, terms: Sequence[Claim]) -> Fit:
    """Return the fit with the significant tables."""
    current, taken, ways = base, 0, ways_beside(problem, base)
    tried = [(one, _columns(problem, ways, one)) for one in terms]
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - count_terms(base))
    while taken < room and tried and problem.noticeable(current.residual) and not problem.budget.exhausted:
        before = held_out_deviance(problem, current)
        there_is = before - float(np.sum(problem.layout.count))  # a residual that is noise alone leaves one each
        gains = [before - held_out_deviance(problem, current, columns) for _, columns in tried]
        best = int(np.argmax(gains))
        if gains[best] < max(THRESHOLD, LEAST * there_is):
            break
        start, _ = tried[best]
        tried = [one for one in tried if one[0].effect.label != start.effect.label]
        better = fit(problem, (*current.claims, start))
        if current.score - better.score < THRESHOLD or within_form_error(problem, current, better):
            continue
        if equals_ruled_out(problem, better, better.claims[-1]):
            continue
        taken += 1
        current = better
    return current


def _columns(problem: Problem, ways: Sequence[Responses], claim: Claim) -> FloatArray:
    """Responses of the residual to a table's values at neutral, in spans; shape (n, values)."""
    probes = [Claim(claim.effect, {**claim.values, one.name: one.span}) for one in claim.effect.amplitudes]
    columns = np.zeros((len(problem.layout.channel), len(probes)))
    for channel, responses in problem.joined([way.of(probes) for way in ways], len(probes)).items():
        columns[problem.layout.channel == channel] = responses.T
    return columns


_MECHANICAL = frozenset({MOTION, LOAD})
NAMES = 3
"""Number of names in one equation beyond which none is replaced by a law."""
LEFT = 0.6
"""Share of the remainder without any of the claims that a law and names may leave, to first order."""
LIKELY = 3
"""Number of laws that are screened beside each set of names."""
TRIED = 9
"""Number of laws that are fitted, those beside the fewest claims first, then by predicted remainder."""


def merged(closed: ClosureFit) -> ClosureFit:
    """Return the model with several claims replaced by one law that does as well; only where nothing remains."""
    problem, screen = closed.problem, closed.screen
    while screen is not None and not problem.noticeable(closed.fit.residual):
        better = next(_simpler(problem, closed.fit, screen), None)
        if better is None:
            break
        closed = replace(closed, fit=better)
    return closed


def _simpler(problem: Problem, found: Fit, screen: Screen) -> Iterator[Fit]:
    """Yield fits with fewer claims and no less evidence that leave no remainder."""
    terms = [claim for claim in found.judged if isinstance(claim.effect, Closure)]
    everything = frozenset(block for claim in found.judged for block in claim.effect.blocks)
    groups = [frozenset(term.effect.blocks) for term in terms]
    groups += [_MECHANICAL for group in groups if group & _MECHANICAL]
    for blocks in dict.fromkeys([*groups, everything] if terms else []):
        shared = [claim for claim in found.judged if claim.effect.blocks & blocks]
        names = [claim for claim in shared if not isinstance(claim.effect, Closure)]
        if len(shared) < 2 or len(names) > NAMES:
            continue
        others = tuple(claim for claim in found.claims if claim not in shared)
        kept = chain.from_iterable(combinations(names, count) for count in range(min(len(names), len(shared) - 2) + 1))
        bases = [claims for some in kept if _complete(claims := (*others, *some))]
        for base, prospect in _beside_subsets(problem, screen, bases):
            if problem.budget.exhausted:
                return
            made = from_starts(problem, base, prospect.starts)
            if problem.noticeable(made.residual):
                made = with_reversal_velocity(problem, made)
            new = made.claims[-1]
            if problem.noticeable(made.residual) or made.score > found.score:
                continue
            if has_identified_shapes(problem, made, new) and not equals_ruled_out(problem, made, new):
                yield made


def _complete(claims: Sequence[Claim]) -> bool:
    """Return whether each claim stands beside those that it needs."""
    return {name for claim in claims for name in claim.effect.needs} <= {claim.effect.id for claim in claims}


def _beside_subsets(problem: Problem, screen: Screen, bases: list[tuple[Claim, ...]]) -> list[tuple[Fit, Prospect]]:
    """Return subsets of the claims, each with a law beside it: the fewest claims first, then by predicted remainder."""
    found = []
    left = 0.0
    for claims in bases:
        base = fit(problem, claims)
        prospects, there_is = screen.prospects(base, LIKELY)
        left = left or LEFT * there_is
        price = float(np.log(len(base.residual)))
        for one in prospects:
            numbers = base.free + len(one.effect.parameters)
            if there_is - one.gain < left:
                found.append((len(claims), there_is - one.gain + price * numbers, base, one))
    found.sort(key=lambda one: one[:2])
    return [(base, one) for *_, base, one in found[:TRIED]]


ALIKE = 0.95
"""Share of a term's squared signature that a name must explain to be fitted in its place."""


def renamed(closed: ClosureFit, names: Sequence[Effect]) -> ClosureFit:
    """Return the model with laws or smooth functions, of several, replaced by names that do as well.

    Only where nothing remains: else no name is forced.
    """
    problem = closed.problem
    if problem.noticeable(closed.fit.residual):
        return closed
    while True:
        found = closed.fit
        terms = [claim for claim in found.claims if isinstance(claim.effect, Closure)]
        if len(terms) < 2:
            return closed
        standing = {claim.effect.id for claim in found.claims}
        free = [name for name in names if name.id not in standing]
        worst = found.score + CHANCE
        others = [(term, found.but(term)) for term in terms]
        tried = (fit(problem, (*rest, name)) for term, rest in others
                 for name in equivalent_causes(problem, found, term, free, ALIKE))  # fmt: skip
        better = next((one for one in tried if one.score <= worst and not problem.noticeable(one.residual)),
                      None)  # fmt: skip
        if better is None:
            return closed
        smooth = any(
            isinstance(claim.effect, Closure) and isinstance(claim.effect.law, Table) for claim in better.claims
        )
        closed = replace(closed, fit=better, form="smooth" if smooth else "law")


START_NAMES = 12
"""Number of names that are screened beside each set of names, the most promising first."""
START_LEFT = 0.6
"""Share of the best remainder that a name and a law may leave, to first order: shapes start on a coarse grid."""
START_FITS = 2
"""Maximum number of starting points, the best first."""


def starting_points(
    problem: Problem, base: Fit, screen: Screen, names: Sequence[Effect], left: float
) -> Iterator[tuple[Problem, Fit]]:
    """Yield fits with one more name than a base, or a name alone, and the problem with their weights, the best first.

    `left`: deviance above the noise that the best model without them leaves.
    """
    if not len(screen):
        return
    bases = [base] if not base.judged else [base, fit(problem, ())]
    found: list[tuple[float, tuple[Claim, ...]]] = []
    for one in bases:
        for name in screen_names(problem, one, names)[:START_NAMES]:
            beside = fit(problem, (*one.claims, name.claim))
            (best,), there_is = screen.prospects(beside, 1)
            price = float(np.log(len(beside.residual))) * len(name.claim.effect.parameters)
            found.append((there_is - best.gain + price, beside.claims))
    found.sort(key=lambda one: one[0])
    for remains, claims in found[:START_FITS]:
        if remains > START_LEFT * left:
            return
        weighed = problem.weighed(claims)
        yield weighed, fit(weighed, claims)
