# SPDX-License-Identifier: Apache-2.0
"""One law in the place of several claims of an equation.

Terms are added one by one, names before there is any law. A name and a law, or two laws, may so share what one law does
alone: drag that fades is viscous friction less a stiffness that creeps. Where nothing remains, the claims of each law's
equation are taken out, some of the names put back, and the best law beside these is tried; likewise those of piston and
load together (a second spring is a cushion and a cell that misreads), and all claims (a wrong position stands in
every equation).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations

import numpy as np

from hydro_diagnosis.closure.disguise import in_disguise
from hydro_diagnosis.closure.evidence import definite
from hydro_diagnosis.closure.growth import Closed
from hydro_diagnosis.closure.rounding import newest_turned
from hydro_diagnosis.closure.rounds import from_starts
from hydro_diagnosis.closure.screen import Prospect, Screen
from hydro_diagnosis.effects.base import LOAD, MOTION, Claim
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score

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
    problem, screen = closed.problem, Screen.last(closed.problem)
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
        for base, prospect in _openings(problem, screen, bases):
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


def _openings(problem: Problem, screen: Screen, bases: list[tuple[Claim, ...]]) -> list[tuple[Fit, Prospect]]:
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
