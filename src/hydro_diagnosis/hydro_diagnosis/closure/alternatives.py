# SPDX-License-Identifier: Apache-2.0
"""Other models of the same remainder: one law for several claims, a name for a law, other names to begin with.

`merged`: terms are added one by one, names before there is any law, so a name and a law, or two laws, may share what
one law does alone (drag that fades is viscous friction less a stiffness that creeps). Where nothing remains, the claims
of each law's equation are taken out, some of the names put back, and the best law beside these is tried; likewise those
of piston and load together, and all claims.

`renamed`: a cause that lies hidden under what a law explains is not found before there is a law; once that law stands,
another term may do what the cause does.

`openings`: the names that explain most need not be those that are true. Names are looked at one by one, each with the
law that is best beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from hydro_diagnosis.closure.evidence import definite, doing_the_same, in_disguise
from hydro_diagnosis.closure.growth import Closed, from_starts, newest_turned
from hydro_diagnosis.closure.screen import CHANCE, Prospect, Screen
from hydro_diagnosis.effects.base import LOAD, MOTION, Claim, Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import screen as screen_names
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score
from hydro_sim.model.tables import Table

_MECHANICAL = frozenset({MOTION, LOAD})
NAMES = 3
"""Names in one equation, beyond which no law takes the place of some."""
LEFT = 0.6
"""Share of what is left without any of them that a law and names may leave, to first order."""
LIKELY = 3
"""Laws that are looked at beside each set of names."""
TRIED = 9
"""Laws that are fitted, those beside the fewest claims first, of them those that would leave least."""


def merged(closed: Closed) -> Closed:
    """The model with fewer claims, where one law does as well as several; only where nothing remains."""
    problem, screen = closed.problem, closed.screen
    while screen is not None and not noticeable(problem, closed.fit.residual):
        better = next(_simpler(problem, closed.fit, screen), None)
        if better is None:
            break
        closed = replace(closed, fit=better)
    return closed


def _simpler(problem: Problem, found: Fit, screen: Screen) -> Iterator[Fit]:
    """Fits with fewer claims and no less evidence that leave nothing."""
    terms = [claim for claim in found.judged if isinstance(claim.effect, Closure)]
    everything = frozenset(block for claim in found.judged for block in claim.effect.touches)
    groups = [frozenset(term.effect.touches) for term in terms]
    groups += [_MECHANICAL for group in groups if group & _MECHANICAL]
    for blocks in dict.fromkeys([*groups, everything] if terms else []):
        shared = [claim for claim in found.judged if claim.effect.touches & blocks]
        names = [claim for claim in shared if not isinstance(claim.effect, Closure)]
        if len(shared) < 2 or len(names) > NAMES:
            continue
        others = tuple(claim for claim in found.claims if claim not in shared)
        kept = chain.from_iterable(combinations(names, count) for count in range(min(len(names), len(shared) - 2) + 1))
        bases = [claims for some in kept if _complete(claims := (*others, *some))]
        for base, prospect in _beside_subsets(problem, screen, bases):
            made = from_starts(problem, base, prospect.starts)
            if noticeable(problem, made.residual):
                made = newest_turned(problem, made)
            new = made.claims[-1]
            if noticeable(problem, made.residual) or score(problem, made) > score(problem, found):
                continue
            if definite(problem, made, new) and not in_disguise(problem, made, new):
                yield made


def _complete(claims: Sequence[Claim]) -> bool:
    """Whether each claim stands beside those that it needs."""
    return {name for claim in claims for name in claim.effect.needs} <= {claim.effect.id for claim in claims}


def _beside_subsets(problem: Problem, screen: Screen, bases: list[tuple[Claim, ...]]) -> list[tuple[Fit, Prospect]]:
    """Claims and a law beside them, the fewest claims first, of them those that would leave least."""
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
"""Share of a term's square, beside all that stands, that a name must account for to be fitted in its place."""


def renamed(closed: Closed, names: Sequence[Effect]) -> Closed:
    """The model with a name for each law or smooth function, of several, that a name explains as well.

    Only where nothing remains: else no name is forced.
    """
    problem = closed.problem
    if noticeable(problem, closed.fit.residual):
        return closed
    while True:
        found = closed.fit
        terms = [claim for claim in found.claims if isinstance(claim.effect, Closure)]
        if len(terms) < 2:
            return closed
        standing = {claim.effect.id for claim in found.claims}
        free = [name for name in names if name.id not in standing]
        worst = score(problem, found) + CHANCE
        others = [(term, tuple(one for one in found.claims if one is not term)) for term in terms]
        tried = (fit(problem, (*rest, name)) for term, rest in others
                 for name in doing_the_same(problem, found, term, free, ALIKE))  # fmt: skip
        better = next((one for one in tried if score(problem, one) <= worst and not noticeable(problem, one.residual)),
                      None)  # fmt: skip
        if better is None:
            return closed
        smooth = any(
            isinstance(claim.effect, Closure) and isinstance(claim.effect.law, Table) for claim in better.claims
        )
        closed = replace(closed, fit=better, form="smooth" if smooth else "law")


START_NAMES = 12
"""Names that are looked at beside each set of names, the most promising first."""
START_LEFT = 0.6
"""Share of what is left without them that a name and a law may leave, to first order: once fitted, the right ones leave
nothing, but further numbers begin on a coarse grid."""
START_FITS = 2
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
