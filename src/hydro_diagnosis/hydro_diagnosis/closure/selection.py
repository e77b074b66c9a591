# SPDX-License-Identifier: Apache-2.0
"""Stepwise selection of unnamed terms: laws, jointly with named causes; smooth functions where laws leave a remainder.

Terms are added one after the other by their gain on held-out blocks of time (`evidence`); after each, all parameters,
those of the named causes too, are estimated again. Of laws with nearly the largest gain, one of few parameters and
signals is taken; the velocity over which a law reverses becomes a parameter where that gains enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from hydro_diagnosis.closure.evidence import (
    EVIDENCE_THRESHOLD,
    equals_ruled_out,
    excluded_blocks,
    has_identified_shapes,
    held_out_gain,
    prune_terms,
    within_form_error,
)
from hydro_diagnosis.closure.screen import Screen
from hydro_diagnosis.effects.base import Effect, EffectHypothesis
from hydro_diagnosis.effects.closure import closure, is_closure
from hydro_diagnosis.estimation.fit import Fit, fit, rank_candidates
from hydro_diagnosis.significance import CLAIM_THRESHOLD, ITERATIONS, PRACTICAL_SHARE, TIE_RATIO
from hydro_sim.model.effects.catalogue import CLOSURES_MAX
from hydro_sim.model.laws import REVERSAL_VELOCITY, REVERSING_TEXT, SIGN_VELOCITY, Law, with_reversal_velocity

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem

MIN_GAIN_SHARE = 0.02
"""Least share of the possible gain that a term must bring: less may be a form error of another."""
MAX_TERMS = 3
"""Largest number of unnamed terms."""


@dataclass(frozen=True)
class ClosureFit:
    """Fit of named causes and unnamed terms, estimated jointly."""

    fit: Fit
    gain: float
    """Gain in held-out deviance over the named causes alone."""
    problem: Problem
    """The problem with the weights of the fit."""
    screen: Screen | None = None
    """Screening from which the terms were selected."""


def best_closure(problem: Problem, base: Fit, names: Sequence[Effect] = ()) -> ClosureFit | None:
    """Return the fit with unnamed terms of a fit's residual; None if no term gains on held-out blocks.

    `names`: causes that may be fitted jointly with a law though the judgement does not retain them.
    """
    screen = Screen(problem, base, excluded_blocks(problem, base))
    by_law = _by_law(problem, base, screen, names)
    if further_names(by_law.fit, base) and by_law.problem.has_excess(by_law.fit.residual):
        # where something remains, no further named cause is certain
        again = not problem.budget.leaves_out("other laws in place of names that were refused")
        by_law = _by_law(problem, base, screen, ()) if again else _with_laws_of(by_law, problem, base)
    left = by_law.problem.has_excess(by_law.fit.residual)
    found = by_law
    if (left or by_law.gain <= 0.0) and not problem.budget.leaves_out("smooth functions"):
        smooth = _by_curve(by_law if left else ClosureFit(base, 0.0, problem, screen))
        found = smooth if by_law.gain < (1.0 - PRACTICAL_SHARE) * smooth.gain else by_law
    return found if found.gain > 0.0 else None


def further_names(found: Fit, base: Fit) -> set[str]:
    """Return the labels of the named causes of a fit that `base` has not."""
    return {one.effect.label for one in found.cause_claims if one.effect.named} - {
        one.effect.label for one in base.claims
    }


def _with_laws_of(other: ClosureFit, problem: Problem, base: Fit) -> ClosureFit:
    """The fit `base` with the laws of another one, of which those stay that gain enough."""
    laws = [one for one in other.fit.claims if is_closure(one.effect)]
    found = prune_terms(problem, fit(problem, (*base.claims, *laws)), keep_named=True)
    return ClosureFit(found, held_out_gain(problem, base, found), problem, other.screen)


def _terms(found: Fit) -> int:
    return sum(is_closure(claim.effect) for claim in found.claims)


def _by_law(problem: Problem, base: Fit, screen: Screen, names: Sequence[Effect]) -> ClosureFit:
    """Fit of the retained named causes, laws, and further causes that gain enough; idle ones are dropped."""
    weighed, current, tried = problem, base, set[str]()
    room = min(MAX_TERMS, CLOSURES_MAX - len(problem.bench.closures) - _terms(base))
    for _ in range(room + (MAX_TERMS if names else 0)):
        if not weighed.has_excess(current.residual) or problem.budget.leaves_out("further laws"):
            break
        fits = _with_law(weighed, current, screen, tried) if _terms(current) - _terms(base) < room else []
        if _terms(current) > _terms(base):
            fits += _with_name(weighed, current, names)
        if not fits:
            break
        taken = _simplest(fits)
        tried -= {one.claims[-1].effect.label for one in fits if one is not taken}
        current = taken
        if taken.claims[-1].effect.named:
            weighed = weighed.reweighted(taken.claims)
            current = fit(weighed, taken.claims)
    if _terms(current) == _terms(base):
        return ClosureFit(base, 0.0, problem, screen)
    current = prune_terms(weighed, _merged(weighed, _exchanged(weighed, current, screen, names), screen))
    return ClosureFit(current, held_out_gain(weighed, fit(weighed, base.claims), current), weighed, screen)


def _with_law(problem: Problem, current: Fit, screen: Screen, tried: set[str]) -> list[Fit]:
    """Fits with one more law that gains enough, of the best that are not `tried`; extends `tried`."""
    candidates, possible_gain = screen.best_laws(current, 5, tried)
    toll = CLAIM_THRESHOLD + 2.0 * float(
        np.log(max(len(screen), 1))
    )  # the most that chance gains grows with the number of columns
    fits: list[Fit] = []
    disguised, clean = 0.0, False
    for one in candidates:
        enough = TIE_RATIO * candidates[0].gain if clean else 0.0 if fits else (1.0 - PRACTICAL_SHARE) * disguised
        if one.gain < max(toll, MIN_GAIN_SHARE * possible_gain, enough) or problem.budget.leaves_out("further laws"):
            break
        better = _from_starts(problem, current, one.starts)
        if problem.has_excess(better.residual):
            better = _with_reversal_velocity(problem, better)
        tried.add(one.effect.label)
        if current.score - better.score < toll or within_form_error(problem, current, better):
            continue
        if not has_identified_shapes(problem, better, better.claims[-1]):
            disguised = max(disguised, one.gain)  # a law of less gain would replace the true one
        elif equals_ruled_out(problem, better, better.claims[-1]):
            continue
        elif held_out_gain(problem, current, better) >= toll:
            fits.append(better)
            clean = clean or not problem.has_excess(better.residual)
    return fits


def _from_starts(problem: Problem, current: Fit, starts: Sequence[EffectHypothesis]) -> Fit:
    """The fit from the first start from which the law's shape parameters are identified, else from the best."""
    fits = []
    for start in starts:
        fits.append(fit(problem, (*current.claims, start), iterations=3 * ITERATIONS))
        if has_identified_shapes(problem, fits[-1], fits[-1].claims[-1]):
            return fits[-1]
    return fits[0]


def _with_reversal_velocity(problem: Problem, found: Fit, place: int = -1) -> Fit:
    """The fit with a reversal velocity as a parameter of one law, the newest by default, where that gains enough."""
    claim = found.claims[place]
    effect = claim.effect
    if not (is_closure(effect) and isinstance(effect.law, Law) and effect.law.depends_on_direction):
        return found
    if REVERSAL_VELOCITY in effect.law.shape_parameters:
        return found
    wider = closure(with_reversal_velocity(effect.law), problem.bench, effect.limits, effect.probes)
    claims = list(found.claims)
    claims[place] = EffectHypothesis(wider, {**claim.values, REVERSAL_VELOCITY.name: 2.0 * SIGN_VELOCITY})
    better = fit(problem, claims, iterations=3 * ITERATIONS)
    pays = found.score - better.score >= CLAIM_THRESHOLD
    return better if pays and has_identified_shapes(problem, better, better.claims[place]) else found


def _with_name(problem: Problem, current: Fit, names: Sequence[Effect]) -> list[Fit]:
    """Fits with one more named cause that gains enough."""
    fits = [fit(problem, (*current.claims, one.claim)) for one in rank_candidates(problem, current, names)[:MAX_TERMS]]
    enough = current.score - CLAIM_THRESHOLD
    return [one for one in fits if one.score < enough and not within_form_error(problem, current, one)]


def _simplest(fits: Sequence[Fit], last: EffectHypothesis | None = None) -> Fit:
    """Of the fits with nearly the best evidence, that with a named cause, else with the simplest law.

    The claim in question is the newest, of the first fit `last`, if that is given.
    """
    best = min(one.score for one in fits)

    def parts(one: Fit) -> tuple[int, int, float]:
        effect = (last if last and one is fits[0] else one.claims[-1]).effect
        if not is_closure(effect):
            return 0, 0, one.score
        return len(effect.parameters), len(effect.law.uses), one.score

    return min((one for one in fits if one.score <= best + CLAIM_THRESHOLD), key=parts)


def _exchanged(problem: Problem, found: Fit, screen: Screen, names: Sequence[Effect]) -> Fit:
    """The fit with claims swapped for better ones, given the terms added later, or for simpler ones as good."""
    for claim in found.removable if len(found.claims) > 1 else ():
        if problem.budget.leaves_out("exchanges of laws"):
            break
        law = is_closure(claim.effect)
        if not law and not names:
            continue
        rest = tuple(one for one in found.claims if one.effect.label != claim.effect.label)
        others = fit(problem, rest) if law else fit(problem, rest, iterations=0)  # the laws keep their values
        tried = {one.effect.label.replace(f", {REVERSING_TEXT}", "") for one in found.claims}  # however they reverse
        if law:
            found = _simplest([found, *_with_law(problem, others, screen, tried)], claim)
        else:
            fits = [found, *_with_name(problem, others, names)]
            best = min(one.score for one in fits)
            found = min(
                (one for one in fits if one.score <= best + CLAIM_THRESHOLD),
                key=lambda one: (one.parameter_count, one.score),
            )
    for place in range(len(found.claims)):  # also if nothing remains: it moves a simulated piston at each reversal
        found = _with_reversal_velocity(problem, found, place)
    return found


def _merged(problem: Problem, found: Fit, screen: Screen) -> Fit:
    """The fit with a law and another claim replaced by one law of no worse evidence, if nothing remains."""
    for first, second in combinations(found.cause_claims if not problem.has_excess(found.residual) else (), 2):
        if (first.effect.named and second.effect.named) or problem.budget.leaves_out("one law in place of two"):
            continue
        rest = fit(problem, tuple(one for one in found.claims if one is not first and one is not second))
        for one in screen.best_laws(rest, 2)[0]:
            better = _with_reversal_velocity(problem, _from_starts(problem, rest, one.starts))
            definite = has_identified_shapes(problem, better, better.claims[-1])
            if definite and better.score <= found.score and not problem.has_excess(better.residual):
                return _merged(problem, better, screen)
    return found


def _by_curve(below: ClosureFit) -> ClosureFit:
    """Fit of smooth functions, jointly with named causes and with laws that leave a remainder; drops idle laws.

    Named causes stay: a smooth function can take the form of any of them.
    """
    problem, current, screen, tried = below.problem, below.fit, below.screen, set[str]()
    assert screen is not None
    room = min(MAX_TERMS, CLOSURES_MAX - len(problem.bench.closures) - _terms(current))
    while room and problem.has_excess(current.residual) and not problem.budget.leaves_out("further smooth functions"):
        start, gain, possible_gain = screen.best_smooth_function(current, tried)
        if start is None or gain < max(EVIDENCE_THRESHOLD, MIN_GAIN_SHARE * possible_gain):
            break
        tried.add(start.effect.label)
        better = fit(problem, (*current.claims, start))
        pays = current.score - better.score >= EVIDENCE_THRESHOLD and not within_form_error(problem, current, better)
        if pays and not equals_ruled_out(problem, better, better.claims[-1]):
            current, room = better, room - 1
    current = prune_terms(problem, current, keep_named=True)
    if {one.effect.label for one in current.claims} <= {one.effect.label for one in below.fit.claims}:
        return ClosureFit(below.fit, 0.0, problem, screen)  # none that gains enough
    gain = below.gain + held_out_gain(problem, below.fit, current)
    return ClosureFit(current, gain, problem, screen)
