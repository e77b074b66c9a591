# SPDX-License-Identifier: Apache-2.0
"""Terms that add to an equation: what they do to the residual is their amplitudes times what they do alone.

So a residual with such terms is that without them, and a sum of responses that are computed once for each set of their
further numbers. Only what stands between the equation and the sensors counts beside them: the oil's stiffness, the
readings that flows are computed from, and the sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hydro_diagnosis.effects.base import LOAD, MOTION, PRESSURE, Claim, FloatArray, changes

Parts = dict[tuple[str, int], FloatArray]
"""Residuals by channel and segment, physical unit; of responses each of shape (amplitudes, n)."""
Key = tuple[object, ...]
_BETWEEN = {
    MOTION: ("measure",),
    LOAD: ("measure", "bench"),
    PRESSURE: ("measure", "unmeasure", "bench", "stiffness", "command"),
}
"""By block: hooks of effects that change what a term of its equation does to the residual."""


def apart(claims: Sequence[Claim]) -> tuple[list[Claim], tuple[Claim, ...]]:
    """Claims that add, and the others; terms without amplitude are left out."""
    acting = [claim for claim in claims if acts(claim)]
    bent: set[str] = set().union(*(one.effect.touches for one in acting if one.effect.bends))
    adding = [one for one in acting if one.effect.adds and not one.effect.touches & bent]
    return adding, tuple(one for one in acting if not any(one is other for other in adding))


def summed(claims: Sequence[Claim], known: Sequence[Claim]) -> tuple[list[Claim], tuple[Claim, ...]]:
    """Claims whose responses are worth keeping, and all others that act.

    Behind a claim that is being fitted, whatever is not `known`, responses would change with each of its values.
    """
    adding, others = apart(claims)
    fitted = [one for one in others if not any(one is other for other in known)]
    kept = [one for one in adding if not between(one, fitted)]
    return kept, tuple(one for one in claims if acts(one) and not any(one is other for other in kept))


def acts(claim: Claim) -> bool:
    """Whether a claim does anything: a term without a name and without amplitude does not."""
    return claim.effect.named or any(amplitudes(claim)) or not any(one.smallest for one in claim.effect.parameters)


def amplitudes(claim: Claim) -> list[float]:
    """Values of a claim's amplitudes."""
    return [claim.values[one.name] for one in claim.effect.parameters if one.smallest > 0.0]


def shapes(claim: Claim) -> list[float]:
    """Values of a claim's further numbers."""
    return [claim.values[one.name] for one in claim.effect.parameters if one.smallest == 0.0]


def between(claim: Claim, others: Sequence[Claim]) -> tuple[Claim, ...]:
    """Those of the other claims that change what a term does to the residual."""
    hooks = {block: _BETWEEN[block] for block in claim.effect.touches}
    return tuple(
        one for one in others
        if any(block in one.effect.touches and any(changes(one, hook) for hook in own) for block, own in hooks.items())
    )  # fmt: skip


def written(claims: Sequence[Claim]) -> Key:
    """Key of claims with their values."""
    return tuple((one.effect.label, *one.values.values()) for one in claims)


def responses(claim: Claim, compute: Callable[[Claim], Parts]) -> Parts:
    """What each amplitude of a term does to the residual, per unit; `compute`: what the term does."""
    neutral = {**claim.values, **{one.name: 0.0 for one in claim.effect.parameters if one.smallest > 0.0}}
    rows = []
    for one in claim.effect.parameters:
        if one.smallest > 0.0:
            moved = compute(Claim(claim.effect, {**neutral, one.name: one.span}))
            rows.append({key: part / one.span for key, part in moved.items()})
    found = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    return {key: part for key, part in found.items() if part.any()}
