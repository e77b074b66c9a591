# SPDX-License-Identifier: Apache-2.0
"""Terms without a name that are a cause in disguise which the user has ruled out.

`--without` says what it cannot be. A law or table that does to the residual what such a cause would do, beside all that
stands, is that cause under another form: it is refused, too. Where such a cause would take a good part of what remains,
several laws together might do the same: no law is looked for in its equations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model.segment_model import BLOCKS

ALIKE = 0.8
"""Share of a term's square, beside all that stands, from which it is the cause that accounts for it."""


GOOD_PART = 0.25
"""Share of what remains in its equations, noise taken off, from which a ruled-out cause bars laws from them."""


def barred(problem: Problem, found: Fit) -> frozenset[str]:
    """Blocks in which what remains beside a fit is to a good part what a ruled-out cause would do."""
    blocks: set[str] = set()
    remaining = problem.layout.squares(found.residual) - problem.layout.count()
    left = _beside(found.jacobian, found.residual)
    for effect in problem.ruled_out:
        own = effect.touches & set(problem.blocks)
        channels = [CHANNELS.index(name) for block in own for name in BLOCKS[block]]
        excess = float(sum(remaining[channels]))
        for _, columns in _columns(problem, found.claims, found.residual, effect):
            rest = _beside(np.column_stack([found.jacobian, columns]), found.residual)
            if excess > 0.0 and float(left @ left - rest @ rest) > GOOD_PART * excess:
                blocks |= own
                break
    return frozenset(blocks)


def in_disguise(problem: Problem, found: Fit, claim: Claim) -> bool:
    """Whether one of the causes that are ruled out (`Problem.ruled_out`) does what this claim of a fit does."""
    return any(True for _ in doing_the_same(problem, found, claim, problem.ruled_out))


def doing_the_same(
    problem: Problem, found: Fit, claim: Claim, causes: Sequence[Effect], alike: float = ALIKE
) -> Iterator[Claim]:
    """Those of the causes, at the start of a fit, that do what this claim of a fit does, but for a share."""
    if not causes:
        return
    others = tuple(one for one in found.claims if one is not claim)
    before = problem.residual(others)
    shown = found.residual - before
    at = sum(len(one.effect.parameters) for one in found.claims[: found.claims.index(claim)])
    own = range(at, at + len(claim.effect.parameters))
    standing = np.delete(found.jacobian, own, axis=1)
    beside = _beside(standing, shown)
    size = float(beside @ beside)
    for effect in causes:
        for start, columns in _columns(problem, others, before, effect):
            left = _beside(np.column_stack([standing, columns]), shown)
            if size > 0.0 and float(left @ left) < (1.0 - alike) * size:
                yield start
                break


def _columns(
    problem: Problem, others: Sequence[Claim], before: FloatArray, effect: Effect
) -> Iterator[tuple[Claim, FloatArray]]:
    """What each number of a cause does to the residual, for each choice of start values of its shape: a start first."""
    if not effect.touches & set(problem.blocks):
        return
    amplitudes = [one for one in effect.parameters if one.smallest > 0.0]
    shapes = [one for one in effect.parameters if one.smallest == 0.0]
    for chosen in product(*(one.probes for one in shapes)):
        values = {one.name: one.neutral for one in effect.parameters}
        values |= dict(zip((one.name for one in shapes), chosen, strict=True))
        moved = [{**values, one.name: one.probes[0]} for one in amplitudes] or [values]
        columns = np.column_stack([problem.residual((*others, Claim(effect, one))) - before for one in moved])
        yield Claim(effect, values), columns


def _beside(columns: FloatArray, shown: FloatArray) -> FloatArray:
    """What columns do not account for."""
    if columns.shape[1] == 0:
        return shown
    lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(shown - columns @ (np.linalg.lstsq(columns / lengths, shown, rcond=1e-10)[0] / lengths))
