# SPDX-License-Identifier: Apache-2.0
"""What a term that adds does to the residuals of a segment, by its own way alone: no other term is computed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_diagnosis.effects.base import MOTION, PRESSURE, Claim, FloatArray, changes
from hydro_diagnosis.effects.closure import EdgeClosure, FlowClosure, LoadClosure, MotionClosure
from hydro_diagnosis.model import chambers, kernels
from hydro_diagnosis.model.observer import OBSERVER_MEMORY
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model.equations import LOAD_CELL_DAMPING


def direct_response(model: SegmentModel, claim: Claim, beside: Sequence[Claim]) -> dict[str, FloatArray] | None:
    """By channel: change of the residual [physical unit] by a term beside other claims; None behind a changed sensor.

    Raises
    ------
    TypeError
        If the term is none of those that add.
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
    oil, bench = model.oil(beside), model.bench(beside)
    flows = effect.inflows((nothing, nothing), oil, model.memory, claim.values)
    stiff = chambers.compliances(bench, oil, beside)
    gain = model.step / OBSERVER_MEMORY
    return {
        f"{PRESSURE}_{chamber}": model.kept_smooth(kernels.innovations(nothing, flow * own * model.step, gain))
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
    if bench.load_cell_bandwidth is not None:
        shown = model.memory.low_pass("load_force", shown, bench.load_cell_bandwidth, LOAD_CELL_DAMPING)
    return {"motion": -model.kept_finish(moved), "load": -model.kept_smooth(shown)}
