# SPDX-License-Identifier: Apache-2.0
"""Names in the place of terms that do the same: where several terms stand, some may be causes under another form.

Names are searched before there is any law. A cause that lies hidden under what a law explains is not found then, and
once that law stands, another term may do what the cause does, or two of one equation what two causes do: two slopes of
the valve's opening that meet are a gain and an offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from hydro_diagnosis.closure.disguise import doing_the_same
from hydro_diagnosis.closure.growth import Closed
from hydro_diagnosis.closure.screen import CHANCE
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import screen as screen_names
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score
from hydro_sim.model.tables import Table

ALIKE = 0.95
"""Share of a term's square, beside all that stands, that a name must account for to be fitted in its place."""
LIKELY = 3
"""Names that are fitted in place of a pair of terms, one after the other, the most promising of a screen."""


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
        pairs = combinations(terms, 2) if better is None else ()
        for pair in pairs:
            if len({term.effect.law.equation for term in pair}) == 1:
                rest = [one for one in found.claims if one not in pair]
                better = better or _by_names(problem, rest, free, worst - CHANCE)
        if better is None:
            return closed
        smooth = any(
            isinstance(claim.effect, Closure) and isinstance(claim.effect.law, Table) for claim in better.claims
        )
        closed = replace(closed, fit=better, form="smooth" if smooth else "law")


def _by_names(problem: Problem, rest: Sequence[Claim], free: Sequence[Effect], worst: float) -> Fit | None:
    """The fit with up to as many names as a pair of terms beside the rest, if it leaves nothing and scores no worse."""
    current = fit(problem, rest)
    for _ in range(2):
        likely = [one.claim for one in screen_names(problem, current, free)[:LIKELY]]
        if not likely:
            return None
        current = min((fit(problem, (*current.claims, one)) for one in likely), key=lambda one: score(problem, one))
        if score(problem, current) <= worst and not noticeable(problem, current.residual):
            return current
    return None
