# SPDX-License-Identifier: Apache-2.0
"""Growth of a model by laws, and by names that do as well: forward selection with exchanges.

Of the terms that pay in a round and have nearly as much evidence as the best, a name is taken before a law, and a law
of few parameters and signals before another. Laws are screened and fitted as reversing over `SIGN_VELOCITY`; the
velocity over which one reverses becomes a parameter where that pays.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
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
from hydro_diagnosis.effects.base import Claim, Effect, values_key
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.fit import screen as screen_names
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model.effects.catalogue import CLOSURES
from hydro_sim.model.laws import REVERSING, SIGN_VELOCITY, TURN, Law, rounded

START = 2.0 * SIGN_VELOCITY
"""Start value of the reversal velocity [m/s]."""
ITERATIONS = 12


def with_reversal_velocity(problem: Problem, found: Fit, place: int = -1) -> Fit:
    """Return the fit with a reversal velocity as a parameter of one claim, the newest by default, if significant."""
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
    pays = found.score - better.score >= CHANCE
    return better if pays and has_identified_shapes(problem, better, better.claims[place]) else found


LEAST = 0.02
"""Least share of the possible gain that a term must bring: less may be a form error of another."""
CONDENSED = 0.05
"""Share of a smooth function's gain that a law may lack and still be preferred."""
FITTED = 5
"""Number of laws that are fitted in each step, the best of the screen."""
ALIKE = 0.8
"""Share of the best gain from which a law is still fitted once another leaves no remainder."""
PATIENCE = 24
"""Maximum number of iterations of a fit: shape parameters start on a coarse grid."""


class ForwardSelection:
    """Steps of forward selection over a screen, cached: selection with names and without them starts alike."""

    def __init__(self, screen: Screen) -> None:
        self.screen = screen
        self._known: dict[tuple[Any, ...], tuple[Problem, tuple[list[Fit], frozenset[str]]]] = {}

    def fits(self, problem: Problem, current: Fit, tried: Collection[str] = ()) -> tuple[list[Fit], frozenset[str]]:
        """Return fits with one more significant law, of the best not in `tried`, and all that are tried now."""
        key = id(problem), values_key(current.claims), frozenset(tried)
        if key not in self._known:
            self._known[key] = problem, self._fitted(problem, current, set(tried))
        return self._known[key][1]

    def _fitted(self, problem: Problem, current: Fit, tried: set[str]) -> tuple[list[Fit], frozenset[str]]:
        prospects, there_is = self.screen.prospects(current, FITTED, tried)
        toll = threshold(len(self.screen))
        fits: list[Fit] = []
        disguised, clean = 0.0, False
        for one in prospects:
            enough = ALIKE * prospects[0].gain if clean else 0.0 if fits else (1.0 - CONDENSED) * disguised
            if one.gain < max(toll, LEAST * there_is, enough) or problem.budget.exhausted:
                break
            better = from_starts(problem, current, one.starts)
            if problem.noticeable(better.residual):
                better = with_reversal_velocity(problem, better)
            tried.add(one.effect.label)
            if current.score - better.score < toll or within_form_error(problem, current, better):
                continue
            if not has_identified_shapes(problem, better, better.claims[-1]):
                disguised = max(disguised, one.gain)  # what gains less would stand in for the name or law that it is
            elif equals_ruled_out(problem, better, better.claims[-1]):
                continue
            elif held_out_gain(problem, current, better) >= toll:
                fits.append(better)
                clean = clean or not problem.noticeable(better.residual)
        return fits, frozenset(tried)


def from_starts(problem: Problem, current: Fit, starts: Sequence[Claim]) -> Fit:
    """Return the fit from the first start at which the term's shape parameters are identified, else from the best."""
    fits = []
    for start in starts:
        fits.append(fit(problem, (*current.claims, start), iterations=PATIENCE))
        if has_identified_shapes(problem, fits[-1], fits[-1].claims[-1]):
            return fits[-1]
    return fits[0]


TERMS = 3
"""Largest number of terms of a law."""
NAMES = 3
"""Number of names that are fitted in place of a law."""


@dataclass(frozen=True)
class ClosureFit:
    """Names and closure terms, estimated jointly."""

    fit: Fit
    form: str
    """law or smooth."""
    gain: float
    """Gain in held-out deviance over the names alone."""
    problem: Problem
    """The problem with the weights of the fit."""
    screen: Screen | None = None
    """Screen of the laws that were tried."""


def count_terms(found: Fit) -> int:
    """Return the number of laws and tables of a fit."""
    return sum(isinstance(claim.effect, Closure) for claim in found.claims)


def select_laws(problem: Problem, base: Fit, forward: ForwardSelection, names: Sequence[Effect] = ()) -> ClosureFit:
    """Return the fit with the significant laws, and with `names` that do as well; insignificant terms are dropped.

    In each step the law with most evidence is taken, or a simpler one that has nearly as much.
    """
    weighed = problem
    current, tried = base, frozenset[str]()
    room = min(TERMS, CLOSURES - len(problem.bench.closures) - count_terms(base))
    for _ in range(room + (NAMES if names else 0)):
        if not weighed.noticeable(current.residual) or problem.budget.exhausted:
            break
        fits: list[Fit] = []
        if count_terms(current) - count_terms(base) < room:
            fits, tried = forward.fits(weighed, current, tried)
        if count_terms(current) > count_terms(base):
            fits = [*fits, *_names_fitted(weighed, current, names)]
        if not fits:
            break
        taken = _simplest(fits)
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
    """Return the fit with laws exchanged for others that do better beside the later terms, or as well and are simpler.

    A name gives way to another that does better, or as well with fewer numbers.
    """
    for claim in found.removable if len(found.claims) > 1 else ():
        if problem.budget.exhausted:
            break
        law = isinstance(claim.effect, Closure)
        if law or names:
            rest = tuple(one for one in found.claims if one.effect.label != claim.effect.label)
            others = fit(problem, rest) if law else fit(problem, rest, iterations=0)  # the laws keep their numbers
            tried = {one.effect.label.replace(f", {REVERSING}", "") for one in found.claims}  # however they reverse
            instead = forward.fits(problem, others, tried)[0] if law else _names_fitted(problem, others, names)
            found = _simplest([found, *instead], claim) if law else _fewest([found, *instead])
    for place in range(len(found.claims)):  # also if nothing remains: it moves a simulated piston at each reversal
        found = with_reversal_velocity(problem, found, place)
    return found


def _fewest(fits: Sequence[Fit]) -> Fit:
    """Return the fit of the fewest parameters among those with nearly as much evidence as the best."""
    best = min(one.score for one in fits)
    return min((one for one in fits if one.score <= best + CHANCE), key=lambda one: (one.free, one.score))


def _names_fitted(problem: Problem, current: Fit, names: Sequence[Effect]) -> list[Fit]:
    """Return fits with one more significant name."""
    fits = [fit(problem, (*current.claims, one.claim)) for one in screen_names(problem, current, names)[:NAMES]]
    enough = current.score - CHANCE
    return [one for one in fits if one.score < enough and not within_form_error(problem, current, one)]


def _simplest(fits: Sequence[Fit], last: Claim | None = None) -> Fit:
    """Return, of the fits with nearly the best evidence, a name, else the law of fewest parameters and signals.

    The claim in question is the newest, of the first fit `last`, if that is given.
    """
    best = min(one.score for one in fits)

    def parts(one: Fit) -> tuple[int, int, float]:
        effect = (last if last and one is fits[0] else one.claims[-1]).effect
        if not isinstance(effect, Closure):
            return 0, 0, one.score
        return len(effect.parameters), len(effect.law.uses), one.score

    return min((one for one in fits if one.score <= best + CHANCE), key=parts)
