# SPDX-License-Identifier: Apache-2.0
"""The velocity over which a law reverses, as one number more: where it pays.

Laws are screened and fitted as reversing over `SIGN_VELOCITY`. Seals, presliding and films may take several times as
long; what that leaves at each reversal would call for further laws.
"""

from __future__ import annotations

from hydro_diagnosis.closure.evidence import definite
from hydro_diagnosis.closure.screen import CHANCE
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.outcome import score
from hydro_sim.model.law_signals import SIGN_VELOCITY
from hydro_sim.model.laws import REVERSING, TURN, Law, rounded

START = 2.0 * SIGN_VELOCITY
"""Value that it is fitted from [m/s]."""
ITERATIONS = 12


def turned(problem: Problem, found: Fit) -> Fit:
    """The fit with its laws reversing over a velocity of their own, where it pays.

    Also where nothing else remains: at each reversal there is little of it, and yet it moves a simulated piston.
    """
    for place in range(len(found.claims)):
        found = newest_turned(problem, found, place)
    return found


def newest_turned(problem: Problem, found: Fit, place: int = -1) -> Fit:
    """The same of one claim alone, the newest."""
    claim = found.claims[place]
    effect = claim.effect
    if not (isinstance(effect, Closure) and isinstance(effect.law, Law) and effect.law.reverses):
        return found
    if TURN in effect.law.numbers:
        return found
    wider = closure(rounded(effect.law), problem.bench, effect.limits, effect.probes)
    claims = list(found.claims)
    claims[place] = Claim(wider, {**claim.values, TURN.name: START})
    better = fit(problem, claims, iterations=ITERATIONS)
    pays = score(problem, found) - score(problem, better) >= CHANCE
    return better if pays and definite(problem, better, better.claims[place]) else found


def plain(label: str) -> str:
    """The label of a law, whether or not it has that number."""
    return label.replace(f", {REVERSING}", "")
