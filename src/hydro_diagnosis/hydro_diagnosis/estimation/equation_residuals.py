# SPDX-License-Identifier: Apache-2.0
"""Residuals of the equations under claims, in physical units: each block computed once, terms that add as sums."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, FloatArray
from hydro_diagnosis.estimation.addition import Parts, amplitudes, between, responses, shapes, summed, written
from hydro_diagnosis.estimation.columns import Columns
from hydro_diagnosis.estimation.direct_response import direct_response
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.segment_model import BLOCKS, SegmentModel

_CACHE = 24


class EquationResiduals:
    """Residuals of these segments in these blocks.

    Parameters
    ----------
    models
        Segments.
    blocks
        Blocks of equations that the recorded channels check.
    baseline
        Claims that are already made.
    """

    def __init__(self, models: Sequence[SegmentModel], blocks: Sequence[str], baseline: Sequence[Claim]) -> None:
        self._models, self._blocks, self._baseline = models, blocks, tuple(baseline)
        self._cache: dict[tuple[Any, ...], list[Any]] = {}
        self.columns = Columns()
        """Responses to terms that add, and derivatives of the residual (`slopes.jacobian`), as computed."""

    def parts(self, claims: Sequence[Claim]) -> Parts:
        """Residuals of the baseline and these claims by channel and segment in the order of `Layout`."""
        adding, rest = summed((*self._baseline, *claims), self._baseline)
        parts = self.as_written(rest)
        for claim in adding:
            for key, response in self._responses(claim).items():
                parts[key] = parts[key] + np.array(amplitudes(claim)) @ response
        return parts

    def _responses(self, claim: Claim) -> Parts:
        """What each amplitude of a term that adds does to the residual, shape (amplitudes, n)."""
        beside = between(claim, self._baseline)
        limits = getattr(claim.effect, "limits", ())
        key = ("response", claim.effect.label, limits, *shapes(claim), written(beside))
        found: Parts | None = self.columns.get(key)
        if found is None:
            found = responses(claim, lambda one: self._response(one, beside))
            self.columns.put(key, found, sum(one.nbytes for one in found.values()))
        return found

    def _response(self, claim: Claim, beside: tuple[Claim, ...]) -> Parts:
        """What a term that adds does to the residual beside others that stand between it and the sensors."""
        touched = claim.effect.touches & set(self._blocks)
        shown: Parts = {}
        channels = {name for block in touched for name in BLOCKS[block]}
        for k, model in enumerate(self._models):
            direct = direct_response(model, claim, beside)
            if direct is None:
                with_it, without = self.as_written((*beside, claim), touched), self.as_written(beside, touched)
                return {key: with_it[key] - part for key, part in without.items()}
            shown |= {(name, k): part for name, part in direct.items() if name in channels}
        return shown

    def as_written(self, everything: Sequence[Claim], only: Collection[str] = ()) -> Parts:
        """Residuals of claims each as it stands; `only`: in these blocks, the arcs left out."""
        blocks = only or self._blocks
        parts: Parts = {}
        arcs: list[FloatArray] | None = None
        if PRESSURE in blocks:
            chambers = self._block(PRESSURE, everything, _pressure)
            parts |= {("pressure_a", k): part for k, (_, part, _) in enumerate(chambers)}
            parts |= {("pressure_b", k): part for k, (_, _, part) in enumerate(chambers)}
            arcs = None if only else [arc for arc, _, _ in chambers]
        if MOTION in blocks:
            motions = self._block(MOTION, everything, SegmentModel.motion_residual)
            rounded = any(claim.effect.rounds == "hydraulic_force" for claim in everything)
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
        acting = tuple(claim for claim in claims if block in claim.effect.touches)
        key = (block, *((claim.effect.label, *claim.values.values()) for claim in acting))
        found = self._cache.pop(key, None) or [compute(model.placed(acting), acting) for model in self._models]
        if len(self._cache) > _CACHE:
            self._cache.pop(next(iter(self._cache)))
        self._cache[key] = found  # the one that was asked for longest ago goes first
        return found


def _pressure(model: SegmentModel, claims: Sequence[Claim]) -> tuple[FloatArray, FloatArray, FloatArray]:
    run: ChamberRun = model.chamber_run(claims)
    return model.arc_residual(run), *model.pressure_residuals(run)
