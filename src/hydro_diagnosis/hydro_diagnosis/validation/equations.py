# SPDX-License-Identifier: Apache-2.0
"""Accuracy of a diagnosis on held-out recordings: forward simulation, and equation by equation.

`equation_errors` gives the residual of each equation, without simulation. For rigs whose recordings cannot
be simulated (no pressures, no current) this is the proof. The relative errors that the literature on inverse models
gives compare with `rmse_after` over `signal`, in which samples near velocity reversals hardly count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import MOTION, Claim, FloatArray
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.findings import channel_errors
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.validation.heldout import FREE_RUN, HORIZON, WINDOWS, Comparison, Known, compare

_SIMULATED = {"valve_current", "piston_position", "pressure_a", "pressure_b"}
"""Channels without which nothing can be simulated."""
_MEASURED = {"motion": "hydraulic_force", "load": "load_force", "hydraulic": "hydraulic_force"}
_UNITS = {"pressure_a": "Pa", "pressure_b": "Pa", "motion": "N", "load": "N", "hydraulic": "N"}


@dataclass(frozen=True)
class EquationError:
    """Weighted root mean square of one equation's residual, each residual weighted as in the fit."""

    unit: str
    rmse_before: float
    rmse_after: float
    noise_floor: float
    signal: float
    """Root mean square of the measured signal that the equation explains."""


def held_out(
    problem: Problem,
    unseen: Problem,
    claims: Sequence[Claim],
    models: Sequence[SegmentModel],
    known: Known | None = None,
) -> dict[str, Any]:
    """Errors of the baseline and of the corrected model as they stand in report.json under `fit`.

    `unseen` and `models` are the held-out recordings; noise and baseline are those of `problem`. `known`:
    what has been simulated of them already, added to.
    """
    equations = equations_told(unseen, claims)
    if not models or not all(model.channels.keys() >= _SIMULATED for model in models) or MOTION not in problem.blocks:
        why = "a forward simulation needs current, position and both pressures, and the moving mass"
        return {"holdout": {}, "horizon_s": HORIZON, "free_run": {}, "why": why, "equations": equations}
    before, after, noise = problem.baseline, (*problem.baseline, *claims), problem.sensor_noise
    horizon = compare(models, before, after, noise, seconds=HORIZON, windows=WINDOWS, shooting=True, known=known)
    free = compare(models, before, after, noise, seconds=FREE_RUN, windows=6, shooting=False, known=known)
    return {
        "holdout": channel_errors(horizon.channels),
        "horizon_s": HORIZON,
        "unpredictable": _unpredictable(horizon),
        "free_run": {"seconds": FREE_RUN, **channel_errors(free.channels)},
        "equations": equations,
    }


def equations_told(unseen: Problem, claims: Sequence[Claim]) -> dict[str, Any]:
    """`equation_errors` as they stand in report.json under `fit.equations`."""
    return {name: asdict(error) for name, error in equation_errors(unseen, claims).items()}


def _unpredictable(horizon: Comparison) -> dict[str, Any]:
    """Windows that the corrected model itself cannot predict, and why in a sentence."""
    left_out = [{"recording": window.recording, "start": window.start} for window in horizon.left_out]
    why = (
        f"{len(left_out)} of {horizon.windows} held-out windows cannot be predicted: from starts that the sensors "
        "cannot tell apart the model comes to outcomes as far from one another as from the recording (the piston "
        "sticks or breaks loose). They are left out of the errors over 70 ms."
    )
    return {"windows": horizon.windows, "count": len(left_out), "left_out": left_out, "why": why if left_out else ""}


def equation_errors(problem: Problem, claims: Sequence[Claim]) -> dict[str, EquationError]:
    """Errors on the recordings of `problem`, by channel of residuals, before and after the claims are added.

    Weighted like the fit that the verdict rests on, by the inverse square of each residual's deviation under the
    problem's doubt: where dry friction reverses, its sign is not known, and its level would stand
    in every figure. `before` and `after` have the same weights.
    """
    before, after = problem.residual(()), problem.residual(claims)
    return {
        name: EquationError(
            unit=_UNITS[name],
            rmse_before=_weighted(problem, name, before),
            rmse_after=_weighted(problem, name, after),
            noise_floor=problem.noise[name],
            signal=_signal(problem, name),
        )
        for name in (CHANNELS[index] for index in np.unique(problem.layout.channel))
    }


def _weighted(problem: Problem, name: str, residual: FloatArray) -> float:
    """Root of the weighted mean square of a channel's residuals, physical unit; `residual` is over its deviations."""
    layout = problem.layout
    squares = weights = 0.0
    for k in range(len(problem.models)):
        own = residual[(layout.channel == CHANNELS.index(name)) & (layout.segment == k)]
        squares += float(np.sum(np.square(own)))
        weights += float(np.sum(np.broadcast_to(np.square(1.0 / problem.deviation(name, k)), own.shape)))
    return float(np.sqrt(squares / weights))


def _signal(problem: Problem, name: str) -> float:
    measured = _MEASURED.get(name, name)
    parts = [model.smooth(model.channels[measured]) for model in problem.models if measured in model.channels]
    return float(np.sqrt(np.mean(np.square(np.concatenate(parts))))) if parts else float("nan")
