# SPDX-License-Identifier: Apache-2.0
"""Residuals of the equations under claims, in physical units: each block computed once, additive terms as sums.

A residual with additive terms is that without them, and a sum of their responses times their amplitudes; responses are
computed once for each set of a term's further parameters. They depend on other claims only by what stands between the
equation and the sensors: the oil's stiffness, the readings that flows are computed from, and the sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, FloatArray, changes, values_key
from hydro_diagnosis.effects.closure import EdgeClosure, FlowClosure, LoadClosure, MotionClosure
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.segment_model import BLOCKS, SegmentModel
from hydro_diagnosis.model.segment_record import OBSERVER_MEMORY

ROOM = 96e6
"""Memory limit of a cache [byte]."""


class BoundedCache:
    """Arrays, or sets of them, by key, up to a total size; the least recently used go first."""

    def __init__(self) -> None:
        self._kept: dict[tuple[object, ...], tuple[Any, int]] = {}
        self._bytes = 0

    def get(self, key: tuple[object, ...]) -> Any:
        """Return the entry of a key, or None."""
        found = self._kept.pop(key, None)
        if found is None:
            return None
        self._kept[key] = found
        return found[0]

    def put(self, key: tuple[object, ...], what: Any, size: int) -> None:
        """Store an entry of a size in bytes."""
        self._kept[key] = what, size
        self._bytes += size
        while self._bytes > ROOM and len(self._kept) > 1:
            self._bytes -= self._kept.pop(next(iter(self._kept)))[1]

    def clear(self) -> None:
        """Drop all entries."""
        self._kept.clear()
        self._bytes = 0


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


def responses(claim: Claim, compute: Callable[[Claim], ResidualParts]) -> ResidualParts:
    """Return the response of the residual per unit of each amplitude; `compute`: response to a term."""
    neutral = {**claim.values, **{one.name: 0.0 for one in claim.effect.parameters if one.smallest > 0.0}}
    rows = []
    for one in claim.effect.parameters:
        if one.smallest > 0.0:
            moved = compute(Claim(claim.effect, {**neutral, one.name: one.span}))
            rows.append({key: part / one.span for key, part in moved.items()})
    found = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    return {key: part for key, part in found.items() if part.any()}


def direct_response(model: SegmentModel, claim: Claim, beside: Sequence[Claim]) -> dict[str, FloatArray] | None:
    """Return the change of the residual by a term, by channel, physical unit; None behind a changed sensor.

    Raises TypeError if the term is none of those that add.
    """
    if any(changes(one, "measure") for one in beside):
        return None
    effect, nothing = claim.effect, np.zeros_like(model.time)
    if isinstance(effect, MotionClosure):
        return {MOTION: -model.kept_finish(_resistance(model, claim))}
    if isinstance(effect, LoadClosure):
        return _of_load(model, claim, beside)
    if not isinstance(effect, FlowClosure | EdgeClosure):
        raise TypeError(f"{effect.label} does not just add")
    oil, bench = model.observer.oil(beside), model.bench(beside)
    flows = effect.inflows((nothing, nothing), oil, model.memory, claim.values)
    stiff = chambers.compliances(bench, oil, beside)
    gain = model.step / OBSERVER_MEMORY
    return {
        f"{PRESSURE}_{chamber}": model.kept_smooth(chambers.innovations(nothing, flow * own * model.step, gain))
        for chamber, flow, own in zip("ab", flows, stiff, strict=True)
    }


def _resistance(model: SegmentModel, claim: Claim) -> FloatArray:
    nothing = np.zeros_like(model.x)
    return claim.effect.resistance(nothing, nothing, model.kinematics, model.memory, claim.values)


def _of_load(model: SegmentModel, claim: Claim, beside: Sequence[Claim]) -> dict[str, FloatArray]:
    bench, nothing = model.bench(beside), np.zeros_like(model.x)
    moved, shown = (
        claim.effect.load(nothing, motion, bench, model.memory, claim.values)
        for motion in (model.kinematics, model.recorded)
    )
    return {"motion": -model.kept_finish(moved), "load": -model.kept_smooth(model.behind_cell(shown, bench))}


_CACHE = 24


class EquationResiduals:
    """Residuals of these segments in these blocks.

    `models`: segments. `blocks`: blocks of equations that the recorded channels check. `baseline`: claims that are
    already made.
    """

    def __init__(self, models: Sequence[SegmentModel], blocks: Sequence[str], baseline: Sequence[Claim]) -> None:
        self._models, self._blocks, self._baseline = models, blocks, tuple(baseline)
        self._cache: dict[tuple[Any, ...], list[Any]] = {}
        self.evaluations = 0
        """Evaluations of all residuals so far (`Problem.evaluations`)."""
        self.columns = BoundedCache()
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
            found = responses(claim, lambda one: self._response(one, beside))
            self.columns.put(key, found, sum(one.nbytes for one in found.values()))
        return found

    def _response(self, claim: Claim, beside: tuple[Claim, ...]) -> ResidualParts:
        """Return the response of the residual to an additive term beside the claims between it and the sensors."""
        touched = claim.effect.blocks & set(self._blocks)
        shown: ResidualParts = {}
        channels = {name for block in touched for name in BLOCKS[block]}
        for k, model in enumerate(self._models):
            direct = direct_response(model, claim, beside)
            if direct is None:
                with_it, without = self.evaluated((*beside, claim), touched), self.evaluated(beside, touched)
                return {key: with_it[key] - part for key, part in without.items()}
            shown |= {(name, k): part for name, part in direct.items() if name in channels}
        return shown

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
        if LOAD in blocks:
            loads = self._block(LOAD, everything, SegmentModel.load_residual)
            parts |= {("load", k): part for k, part in enumerate(loads)}
        if HYDRAULIC in blocks:
            balances = self._block(HYDRAULIC, everything, SegmentModel.hydraulic_residual)
            parts |= {("hydraulic", k): part for k, part in enumerate(balances)}
        return parts

    def _block(self, block: str, claims: Sequence[Claim], compute: Any) -> list[Any]:
        acting = tuple(claim for claim in claims if block in claim.effect.blocks)
        key = (block, *values_key(acting))
        found = self._cache.pop(key, None) or [compute(model.placed(acting), acting) for model in self._models]
        if len(self._cache) > _CACHE:
            self._cache.pop(next(iter(self._cache)))
        self._cache[key] = found  # the one that was asked for longest ago goes first
        return found


def _pressure(model: SegmentModel, claims: Sequence[Claim]) -> tuple[FloatArray, FloatArray, FloatArray]:
    run: ChamberRun = model.observer.chamber_run(claims)
    return model.arc_residual(run), *model.pressure_residuals(run)
