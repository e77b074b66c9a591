# SPDX-License-Identifier: Apache-2.0
"""Choice of the next recording for a closure: the one that separates its law from the next best of the grammar.

A bench's physics is never exactly a law of the grammar. So a second law is taken for a rival already where it gains
nearly as much, not only where noise hides the difference.
"""

from __future__ import annotations

from typing import Any

from hydro_diagnosis.closure.candidates import laws
from hydro_diagnosis.closure.evidence import definite
from hydro_diagnosis.closure.screen import Screen
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design.next_recording import proposal
from hydro_sim.model.laws import Law

NEARLY = 0.9
"""Share of the deviance that a law gains from which another law is a rival to it."""
TRIED = 3
"""Laws that are fitted, the most promising first."""


def next_for_law(problem: Problem, found: Fit) -> dict[str, Any] | None:
    """The recording that separates the weightiest law of a fit from its rival; None without a law or a rival."""
    fits = {k: fit(problem, _others(found, k)) for k, claim in enumerate(found.claims) if _is_law(claim)}
    if not fits:
        return None
    place = max(fits, key=lambda k: fits[k].deviance)
    rival = rival_law(problem, found, place, fits[place])
    if rival is None:
        return None
    share = (fits[place].deviance - rival.deviance) / (fits[place].deviance - found.deviance)
    names = [_name(found.claims[place]), _name(rival.claims[-1])]
    alike = f"{names[1]} explains {100.0 * min(share, 1.0):.3g} % of what {names[0]} explains of these recordings"
    return proposal(problem, found, rival, names, alike)


def rival_law(problem: Problem, found: Fit, place: int, without: Fit) -> Fit | None:
    """The fit with the next best law, as the last claim, in the place of a law; None where none gains nearly as much.

    `without`: the fit of all other claims.
    """
    own = found.claims[place].effect.label
    screen = Screen.last(problem) or Screen.beside(problem, without, laws(problem))
    prospects, _there_is = screen.prospects(without, TRIED, {own})
    enough = NEARLY * (without.deviance - found.deviance)
    for prospect in prospects:
        starts = (fit(problem, (*without.claims, start)) for start in prospect.starts)
        fitted = min(starts, key=lambda one: one.deviance)
        if without.deviance - fitted.deviance >= enough and definite(problem, fitted, fitted.claims[-1]):
            return fitted
    return None


def _others(found: Fit, place: int) -> tuple[Claim, ...]:
    return tuple(claim for k, claim in enumerate(found.claims) if k != place)


def _is_law(claim: Claim) -> bool:
    return isinstance(claim.effect, Closure) and isinstance(claim.effect.law, Law)


def _name(claim: Claim) -> str:
    assert isinstance(claim.effect, Closure)
    return f"{claim.effect.law.form} ({claim.effect.law.equation})"
