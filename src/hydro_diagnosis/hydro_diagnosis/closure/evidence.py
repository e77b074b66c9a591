# SPDX-License-Identifier: Apache-2.0
"""Evidence that an unnamed term needs: held-out gain, identified parameters, no ruled-out cause, no form error.

A term with the signature of a cause ruled out by `--without` is that cause in another form: it is rejected. Where such
a cause would explain a good part of the remainder, its equations are not searched for laws.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from hydro_diagnosis.effects.base import BLOCKS, CHANNELS, Effect, EffectHypothesis, FloatArray
from hydro_diagnosis.effects.closure import is_closure
from hydro_diagnosis.estimation.fit import FORM_ERROR_SHARE, Fit, fit, held_out_deviance, orthogonal
from hydro_diagnosis.significance import QUANTILE, TIE_RATIO, UNIDENTIFIED_HALF_WIDTH, VERY_STRONG_EVIDENCE

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem


def has_identified_shapes(problem: Problem, found: Fit, claim: EffectHypothesis) -> bool:
    """Return whether each shape parameter of a law is identified, and off its bounds.

    Where one is not, the law degenerates to another: friction that warms up over an endless path is dry friction.
    """
    weight = 1.0 / problem.variances(found.residual)[problem.layout.channel]
    normal = found.jacobian.T @ (found.jacobian * weight[:, None])
    deviations = np.sqrt(np.maximum(np.diag(np.linalg.pinv(normal, hermitian=True)), 0.0))
    unseen = np.diag(normal) <= 1e-14 * np.max(np.diag(normal), initial=0.0)  # there the pseudo-inverse has 0
    deviations[unseen] = np.inf
    for one, deviation in zip(claim.effect.parameters, deviations[found.columns(claim)], strict=True):
        value, width = claim.values[one.name], one.high - one.low
        size = abs(value) if one.low > 0.0 else width
        edge = 1e-3 * min(size, width)
        inside = one.low + edge < value < one.high - edge
        if one.smallest_reported == 0.0 and not (
            inside and QUANTILE * deviation * one.span < UNIDENTIFIED_HALF_WIDTH * size
        ):
            return False
    return True


def excluded_blocks(problem: Problem, found: Fit) -> frozenset[str]:
    """Return the blocks in which a ruled-out cause would explain a quarter of a fit's remainder, noise subtracted."""
    blocks: set[str] = set()
    remaining = problem.layout.squares(found.residual) - problem.layout.count
    left = orthogonal(found.jacobian, found.residual)
    for effect in problem.ruled_out:
        own = effect.blocks & set(problem.blocks)
        channels = [CHANNELS.index(name) for block in own for name in BLOCKS[block]]
        excess = float(sum(remaining[channels]))
        for columns in _columns(problem, found.claims, found.residual, effect):
            rest = orthogonal(np.column_stack([found.jacobian, columns]), found.residual)
            if excess > 0.0 and float(left @ left - rest @ rest) > 0.25 * excess:
                blocks |= own
                break
    return frozenset(blocks)


def equals_ruled_out(problem: Problem, found: Fit, claim: EffectHypothesis) -> bool:
    """Return whether the signature of a ruled-out cause (`Problem.ruled_out`) explains `TIE_RATIO` of this claim's."""
    if not problem.ruled_out:
        return False
    others = found.claims_without(claim)
    before = problem.residual(others)
    shown = found.residual - before
    standing = np.delete(found.jacobian, found.columns(claim), axis=1)
    beside = orthogonal(standing, shown)
    size = float(beside @ beside)
    lefts = (
        orthogonal(np.column_stack([standing, columns]), shown)
        for effect in problem.ruled_out for columns in _columns(problem, others, before, effect)
    )  # fmt: skip
    return size > 0.0 and any(float(left @ left) < (1.0 - TIE_RATIO) * size for left in lefts)


def _columns(
    problem: Problem, others: Sequence[EffectHypothesis], before: FloatArray, effect: Effect
) -> Iterator[FloatArray]:
    """Yield the signatures of a cause's amplitudes, for each choice of its shape parameters."""
    if not effect.blocks & set(problem.blocks):
        return
    for chosen in product(*(one.start_values for one in effect.shapes)):
        values = {one.name: one.neutral for one in effect.parameters}
        values |= dict(zip((one.name for one in effect.shapes), chosen, strict=True))
        moved = [{**values, one.name: one.start_values[0]} for one in effect.amplitudes] or [values]
        yield np.column_stack([problem.residual((*others, EffectHypothesis(effect, one))) - before for one in moved])


EVIDENCE_THRESHOLD = 3.0 * VERY_STRONG_EVIDENCE
"""Least gain of a term in held-out deviance, and of any claim in BIC."""


def prune_terms(problem: Problem, found: Fit, keep_named: bool = False) -> Fit:
    """Return the fit without insignificant claims, the least significant dropped first.

    `keep_named`: names are not dropped.
    """
    while True:
        open_ = [one for one in found.removable if not (keep_named and one.effect.named)]
        fewer = [(claim, fit(problem, found.claims_without(claim))) for claim in open_]
        idle = [one for claim, one in fewer if not _pays(problem, one, found, claim)]
        if not idle:
            return found
        found = min(idle, key=lambda one: one.score)


def _pays(problem: Problem, without: Fit, found: Fit, claim: EffectHypothesis) -> bool:
    if without.score - found.score < EVIDENCE_THRESHOLD or within_form_error(problem, without, found):
        return False
    if not is_closure(claim.effect):
        return True
    if not has_identified_shapes(problem, found, claim) or equals_ruled_out(problem, found, claim):
        return False
    return held_out_gain(problem, without, found) >= EVIDENCE_THRESHOLD


def held_out_gain(problem: Problem, before: Fit, after: Fit) -> float:
    """Return the reduction of the cross-validated deviance from one fit to another."""
    return held_out_deviance(problem, before) - held_out_deviance(problem, after)


def within_form_error(problem: Problem, before: Fit, after: Fit) -> bool:
    """Return whether a form error of the earlier terms may explain the gain of the later fit, in every channel.

    False where something remains before and nothing after: a wrong form leaves a remainder under any name.
    """
    if problem.has_excess(before.residual) and not problem.has_excess(after.residual):
        return False
    named = tuple(claim for claim in before.claims if not is_closure(claim.effect))
    if len(named) == len(before.claims):
        return False
    channel = problem.layout.channel
    signature = np.bincount(channel, np.square(problem.residual(named) - before.residual), len(CHANNELS))
    added = np.bincount(channel, np.square(before.residual) - np.square(after.residual), len(CHANNELS))
    return bool(np.all(added <= FORM_ERROR_SHARE**2 * signature + EVIDENCE_THRESHOLD))
