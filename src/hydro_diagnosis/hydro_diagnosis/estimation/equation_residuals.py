# SPDX-License-Identifier: Apache-2.0
"""Residuals of the equations under claims, in physical units: each block computed once, additive terms as sums.

A residual with additive terms is that without them, and a sum of their responses times their amplitudes; responses are
computed once for each set of a term's further parameters. They depend on other claims only by what stands between the
equation and the sensors: the oil's stiffness, the readings that flows are computed from, and the sensors.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, FloatArray, changes, values_key
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.responses import Responses
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.segment_record import BoundedCache

ROOM = 96e6
"""Memory limit of a cache [byte]."""
ResidualParts = dict[tuple[str, int], FloatArray]
"""Residuals by channel and segment, physical unit; of responses each of shape (amplitudes, n)."""
Key = tuple[object, ...]
_BETWEEN = {
    MOTION: ("measure",),
    LOAD: ("measure", "bench"),
    PRESSURE: ("measure", "unmeasure", "bench", "stiffness", "command"),
}
"""By block: hooks of effects that change the response of the residual to an additive term."""


def split_additive(claims: Sequence[Claim]) -> tuple[list[Claim], tuple[Claim, ...]]:
    """Split claims into additive ones and others; terms without amplitude are left out."""
    acting = [claim for claim in claims if is_active(claim)]
    bent: set[str] = set().union(*(one.effect.blocks for one in acting if one.effect.breaks_superposition))
    adding = [one for one in acting if one.effect.additive and not one.effect.blocks & bent]
    return adding, tuple(one for one in acting if not any(one is other for other in adding))


def split_cached(claims: Sequence[Claim], known: Sequence[Claim]) -> tuple[list[Claim], tuple[Claim, ...]]:
    """Split active claims into those whose responses are cached, and the others.

    Behind a claim that is being fitted, whatever is not `known`, responses would change with each of its values.
    """
    adding, others = split_additive(claims)
    fitted = [one for one in others if not any(one is other for other in known)]
    kept = [one for one in adding if not intervening(one, fitted)]
    return kept, tuple(one for one in claims if is_active(one) and not any(one is other for other in kept))


def is_active(claim: Claim) -> bool:
    """Return whether a claim acts: a term without a name and without amplitude does not."""
    return claim.effect.named or any(amplitudes(claim)) or not any(one.smallest for one in claim.effect.parameters)


def amplitudes(claim: Claim) -> list[float]:
    """Return the values of a claim's amplitudes."""
    return [claim.values[one.name] for one in claim.effect.parameters if one.smallest > 0.0]


def shapes(claim: Claim) -> list[float]:
    """Return the values of a claim's shape parameters."""
    return [claim.values[one.name] for one in claim.effect.parameters if one.smallest == 0.0]


def intervening(claim: Claim, others: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return the other claims that change the response of the residual to a term."""
    hooks = {block: _BETWEEN[block] for block in claim.effect.blocks}
    return tuple(
        one for one in others
        if any(block in one.effect.blocks and any(changes(one, hook) for hook in own) for block, own in hooks.items())
    )  # fmt: skip


_CACHE = 25
"""Sets of claims whose residuals of a block are kept."""


class EquationResiduals:
    """Residuals of these segments in these blocks.

    `models`: segments. `blocks`: blocks of equations that the recorded channels check. `baseline`: claims that are
    already made.
    """

    def __init__(self, models: Sequence[SegmentModel], blocks: Sequence[str], baseline: Sequence[Claim]) -> None:
        self._models, self._blocks, self._baseline = models, blocks, tuple(baseline)
        self._cache = BoundedCache(_CACHE)
        self.evaluations = 0
        """Evaluations of all residuals so far (`Problem.evaluations`)."""
        self.columns = BoundedCache(ROOM)
        """Cached responses to additive terms, and derivatives of the residual (`fit.jacobian`)."""

    def parts(self, claims: Sequence[Claim]) -> ResidualParts:
        """Return residuals of the baseline and these claims by channel and segment in the order of `Layout`."""
        adding, rest = split_cached((*self._baseline, *claims), self._baseline)
        parts = self.evaluated(rest)
        for claim in adding:
            for key, response in self._responses(claim).items():
                parts[key] = parts[key] + np.array(amplitudes(claim)) @ response
        return parts

    def _responses(self, claim: Claim) -> ResidualParts:
        """Return the response of the residual to each amplitude of an additive term, shape (amplitudes, n)."""
        beside = intervening(claim, self._baseline)
        limits = getattr(claim.effect, "limits", ())
        key = ("response", claim.effect.label, limits, *shapes(claim), values_key(beside))
        found: ResidualParts | None = self.columns.get(key)
        if found is None:
            sizes = {one.name: one.span for one in claim.effect.parameters if one.smallest > 0.0}
            neutral = {**claim.values, **dict.fromkeys(sizes, 0.0)}
            terms = [Claim(claim.effect, {**neutral, name: size}) for name, size in sizes.items()]
            shown, spans = self._shown(terms, beside), np.array([*sizes.values()])[:, None]
            found = {key: part / spans for key, part in shown.items() if part.any()}
            self.columns.put(key, found, sum(one.nbytes for one in found.values()))
        return found

    def _shown(self, terms: Sequence[Claim], beside: tuple[Claim, ...]) -> ResidualParts:
        """Return the responses to terms of one law beside the claims between it and the sensors, shape (terms, n)."""
        touched = terms[0].effect.blocks & set(self._blocks)
        if any(changes(one, "measure") for one in beside):
            without, moved = self.evaluated(beside, touched), [self.evaluated((*beside, one), touched) for one in terms]
            return {key: np.stack([one[key] - part for one in moved]) for key, part in without.items()}
        ways = [Responses(model, touched, beside).of(terms) for model in self._models]
        return {(name, k): part for k, way in enumerate(ways) for name, part in way.items()}

    def evaluated(self, everything: Sequence[Claim], only: Collection[str] = ()) -> ResidualParts:
        """Return residuals of claims without superposition; `only`: in these blocks, the arcs left out."""
        blocks = only or self._blocks
        parts: ResidualParts = {}
        arcs: list[FloatArray] | None = None
        if PRESSURE in blocks:
            chambers = self._block(PRESSURE, everything, _pressure)
            parts |= {("pressure_a", k): part for k, (_, part, _) in enumerate(chambers)}
            parts |= {("pressure_b", k): part for k, (_, _, part) in enumerate(chambers)}
            arcs = None if only else [arc for arc, _, _ in chambers]
        if MOTION in blocks:
            motions = self._block(MOTION, everything, SegmentModel.motion_residual)
            rounded = any(claim.effect.lagged == "hydraulic_force" for claim in everything)
            for k, part in enumerate(motions):
                parts["motion", k] = part if arcs is None or rounded else part + arcs[k]
        for block, compute in ((LOAD, SegmentModel.load_residual), (HYDRAULIC, SegmentModel.hydraulic_residual)):
            if block in blocks:
                parts |= {(block, k): part for k, part in enumerate(self._block(block, everything, compute))}
        return parts

    def _block(self, block: str, claims: Sequence[Claim], compute: Any) -> list[Any]:
        acting = tuple(claim for claim in claims if block in claim.effect.blocks)
        return self._cache.kept(
            (block, *values_key(acting)), lambda: [compute(model.placed(acting), acting) for model in self._models]
        )


def _pressure(model: SegmentModel, claims: Sequence[Claim]) -> tuple[FloatArray, FloatArray, FloatArray]:
    run: ChamberRun = model.observer.chamber_run(claims)
    return model.arc_residual(run), *model.pressure_residuals(run)
