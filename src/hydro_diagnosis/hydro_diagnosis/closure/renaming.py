# SPDX-License-Identifier: Apache-2.0
"""A name in the place of a term that does the same: where several terms stand, one may be a cause under another form.

Names are searched before there is any law. A cause that lies hidden under what a law explains is not found then, and
once that law stands, another term may do what the cause does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydro_diagnosis.closure.disguise import doing_the_same
from hydro_diagnosis.closure.growth import Closed
from hydro_diagnosis.closure.screen import CHANCE
from hydro_diagnosis.effects.base import Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score
from hydro_sim.model.tables import Table

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
