# SPDX-License-Identifier: Apache-2.0
"""Growth of a model by laws, and by names that do as well: forward selection with exchanges.

Of what pays in a round (`rounds`) and has nearly as much evidence as the best, a name is taken before a law, and a law
of few numbers and signals before another.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

from hydro_diagnosis.closure.rounding import plain, turned
from hydro_diagnosis.closure.rounds import Rounds
from hydro_diagnosis.closure.screen import CHANCE
from hydro_diagnosis.closure.together import held_out_gain, mimics, paying
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import screen as screen_names
from hydro_diagnosis.selection.localisation import noticeable
from hydro_diagnosis.selection.outcome import score
from hydro_sim.model.effects.catalogue import CLOSURES

TERMS = 3
"""Largest number of terms of a law."""
NAMES = 3
"""Names that are fitted in place of a law."""


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


def count_terms(found: Fit) -> int:
    """Number of laws and tables of a fit."""
    return sum(isinstance(claim.effect, Closure) for claim in found.claims)


def grown_by_law(problem: Problem, base: Fit, rounds: Rounds, names: Sequence[Effect] = ()) -> Closed:
    """The fit with the laws that pay, and with `names` that do as well; what does not pay beside the others goes.

    In each round the law with most evidence is taken, or a simpler one that has nearly as much.
    """
    weighed = copy(problem)  # its weights are its own, all else is shared
    current, tried = base, set[str]()
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - count_terms(base))
    for _ in range(room + (NAMES if names else 0)):
        if not noticeable(weighed, current.residual):
            break
        fits = rounds.fits(weighed, current, tried) if count_terms(current) - count_terms(base) < room else []
        fits += _names_fitted(weighed, current, names) if count_terms(current) > count_terms(base) else []
        if not fits:
            break
        taken = _simplest(weighed, fits)
        tried -= {one.claims[-1].effect.label for one in fits if one is not taken}
        current = taken
        if not isinstance(taken.claims[-1].effect, Closure):
            weighed.update_weights(taken.claims)
            current = fit(weighed, taken.claims)
    if count_terms(current) == count_terms(base):
        return Closed(base, "law", 0.0, problem)
    current = paying(weighed, _exchanged(weighed, current, rounds, names))  # what stood for another's numbers goes
    return Closed(current, "law", held_out_gain(weighed, fit(weighed, base.claims), current), weighed)


def _exchanged(problem: Problem, found: Fit, rounds: Rounds, names: Sequence[Effect]) -> Fit:
    """The fit with another in place of a law that does better beside all that came after, or as well and is simpler.

    A name gives way to another that does better, or as well with fewer numbers.
    """
    for claim in found.removable if len(found.claims) > 1 else ():
        law = isinstance(claim.effect, Closure)
        if law or names:
            rest = tuple(one for one in found.claims if one.effect.label != claim.effect.label)
            others = fit(problem, rest) if law else fit(problem, rest, iterations=0)  # the laws keep their numbers
            tried = {plain(one.effect.label) for one in found.claims}
            instead = rounds.fits(problem, others, tried) if law else _names_fitted(problem, others, names)
            found = _simplest(problem, [found, *instead], claim) if law else _fewest(problem, [found, *instead])
    return turned(problem, found)


def _fewest(problem: Problem, fits: Sequence[Fit]) -> Fit:
    """Of the fits with nearly as much evidence as the best: that of the fewest numbers."""
    best = min(score(problem, one) for one in fits)
    return min(
        (one for one in fits if score(problem, one) <= best + CHANCE), key=lambda one: (one.free, score(problem, one))
    )


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
