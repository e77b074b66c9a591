# SPDX-License-Identifier: Apache-2.0
"""Growth of a model by laws, and by names that do as well: forward selection with exchanges.

Of the terms that pay in a round and have nearly as much evidence as the best, a name is taken before a law, and a law
of few parameters and signals before another. Laws are screened and fitted as reversing over `SIGN_VELOCITY`; the
velocity over which one reverses becomes a parameter where that pays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hydro_diagnosis.closure.evidence import (
    equals_ruled_out,
    has_identified_shapes,
    held_out_gain,
    within_form_error,
    without_idle_terms,
)
from hydro_diagnosis.closure.screen import CHANCE, Screen, threshold
from hydro_diagnosis.effects.base import Claim, Effect
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.estimation.equation_residuals import values_key
from hydro_diagnosis.estimation.fit import Fit, fit, noticeable, score
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import screen as screen_names
from hydro_sim.model.effects.catalogue import CLOSURES
from hydro_sim.model.law_signals import SIGN_VELOCITY
from hydro_sim.model.laws import REVERSING, TURN, Law, rounded

START = 2.0 * SIGN_VELOCITY
"""Value that it is fitted from [m/s]."""
ITERATIONS = 12


def with_reversal_velocity(problem: Problem, found: Fit) -> Fit:
    """The fit with its laws reversing over a velocity of their own, where it pays.

    Also where nothing else remains: at each reversal there is little of it, and yet it moves a simulated piston.
    """
    for place in range(len(found.claims)):
        found = with_newest_reversal_velocity(problem, found, place)
    return found


def with_newest_reversal_velocity(problem: Problem, found: Fit, place: int = -1) -> Fit:
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
    return better if pays and has_identified_shapes(problem, better, better.claims[place]) else found


def plain(label: str) -> str:
    """The label of a law, whether or not it has that number."""
    return label.replace(f", {REVERSING}", "")


LEAST = 0.02
"""Share of the possible gain that a term must bring: less is mimicry of another form."""
CONDENSED = 0.05
"""Share of a smooth function's gain by which a law may fall short of it."""
FITTED = 5
"""Laws that are fitted in each round, the best of the screen."""
ALIKE = 0.8
"""Share of the best's gain from which a law is fitted beside one that leaves nothing."""
PATIENCE = 24
"""Iterations of a fit at most: a law's further numbers begin on a coarse grid."""


class ForwardSelection:
    """Rounds over a screen. Each is gone through once: growth with names and growth without them begin alike."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self._known: dict[tuple[Any, ...], tuple[Any, list[Fit], set[str]]] = {}

    def fits(self, problem: Problem, current: Fit, tried: set[str]) -> list[Fit]:
        """Fits with one law more that pays, of the best that are not `tried`; they are `tried` then."""
        key = id(problem.weights), values_key(current.claims), frozenset(tried)
        if key not in self._known:
            now = set(tried)
            self._known[key] = problem.weights, self._fitted(problem, current, now), now
        _weights, fits, now = self._known[key]
        tried |= now
        return list(fits)

    def _fitted(self, problem: Problem, current: Fit, tried: set[str]) -> list[Fit]:
        prospects, there_is = self.screen.prospects(current, FITTED, tried)
        toll = threshold(len(self.screen))
        fits: list[Fit] = []
        disguised, clean = 0.0, False
        for one in prospects:
            enough = ALIKE * prospects[0].gain if clean else 0.0 if fits else (1.0 - CONDENSED) * disguised
            if one.gain < max(toll, LEAST * there_is, enough):
                break
            better = from_starts(problem, current, one.starts)
            if noticeable(problem, better.residual):
                better = with_newest_reversal_velocity(problem, better)
            tried.add(one.effect.label)
            if score(problem, current) - score(problem, better) < toll or within_form_error(problem, current, better):
                continue
            if not has_identified_shapes(problem, better, better.claims[-1]):
                disguised = max(disguised, one.gain)  # what gains less would stand in for the name or law that it is
            elif equals_ruled_out(problem, better, better.claims[-1]):
                continue
            elif held_out_gain(problem, current, better) >= toll:
                fits.append(better)
                clean = clean or not noticeable(problem, better.residual)
        return fits


def from_starts(problem: Problem, current: Fit, starts: Sequence[Claim]) -> Fit:
    """The fit with a term from the first start at which its further numbers come to be known, else from the best."""
    fits = []
    for start in starts:
        fits.append(fit(problem, (*current.claims, start), iterations=PATIENCE))
        if has_identified_shapes(problem, fits[-1], fits[-1].claims[-1]):
            return fits[-1]
    return fits[0]


TERMS = 3
"""Largest number of terms of a law."""
NAMES = 3
"""Names that are fitted in place of a law."""


@dataclass(frozen=True)
class ClosureFit:
    """Names and closure estimated together."""

    fit: Fit
    form: str
    """law or smooth."""
    gain: float
    """Held-out deviance that it gains over the names alone."""
    problem: Problem
    """The problem with the weights of the fit."""
    screen: Screen | None = None
    """Of the laws that were tried."""


def count_terms(found: Fit) -> int:
    """Number of laws and tables of a fit."""
    return sum(isinstance(claim.effect, Closure) for claim in found.claims)


def select_laws(problem: Problem, base: Fit, forward: ForwardSelection, names: Sequence[Effect] = ()) -> ClosureFit:
    """The fit with the laws that pay, and with `names` that do as well; what does not pay beside the others goes.

    In each round the law with most evidence is taken, or a simpler one that has nearly as much.
    """
    weighed = problem
    current, tried = base, set[str]()
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - count_terms(base))
    for _ in range(room + (NAMES if names else 0)):
        if not noticeable(weighed, current.residual):
            break
        fits = forward.fits(weighed, current, tried) if count_terms(current) - count_terms(base) < room else []
        fits += _names_fitted(weighed, current, names) if count_terms(current) > count_terms(base) else []
        if not fits:
            break
        taken = _simplest(weighed, fits)
        tried -= {one.claims[-1].effect.label for one in fits if one is not taken}
        current = taken
        if not isinstance(taken.claims[-1].effect, Closure):
            weighed = weighed.weighed(taken.claims)
            current = fit(weighed, taken.claims)
    if count_terms(current) == count_terms(base):
        return ClosureFit(base, "law", 0.0, problem, forward.screen)
    current = without_idle_terms(
        weighed, _exchanged(weighed, current, forward, names)
    )  # what stood for another's numbers goes
    return ClosureFit(
        current, "law", held_out_gain(weighed, fit(weighed, base.claims), current), weighed, forward.screen
    )


def _exchanged(problem: Problem, found: Fit, forward: ForwardSelection, names: Sequence[Effect]) -> Fit:
    """The fit with another in place of a law that does better beside all that came after, or as well and is simpler.

    A name gives way to another that does better, or as well with fewer numbers.
    """
    for claim in found.removable if len(found.claims) > 1 else ():
        law = isinstance(claim.effect, Closure)
        if law or names:
            rest = tuple(one for one in found.claims if one.effect.label != claim.effect.label)
            others = fit(problem, rest) if law else fit(problem, rest, iterations=0)  # the laws keep their numbers
            tried = {plain(one.effect.label) for one in found.claims}
            instead = forward.fits(problem, others, tried) if law else _names_fitted(problem, others, names)
            found = _simplest(problem, [found, *instead], claim) if law else _fewest(problem, [found, *instead])
    return with_reversal_velocity(problem, found)


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
    return [one for one in fits if score(problem, one) < enough and not within_form_error(problem, current, one)]


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
