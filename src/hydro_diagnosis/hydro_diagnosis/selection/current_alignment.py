# SPDX-License-Identifier: Apache-2.0
"""Alignment of the recorded current: a row must hold the current from it on, not the one before or after.

No bench responds to a current in advance. So where a mismatch at the valve goes away once every row gets the current
of the next, the logger's convention is wrong, not the bench.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects.base import PRESSURE
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.findings import EffectReport
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.selection.localisation import mean_squares
from hydro_diagnosis.selection.verdict import Assessment

GOES_AWAY = 0.1
"""Share of the pressures' mismatch that may be left for it to count as gone."""
TIMING = 2e-5
"""Tolerance [s] of a dead time of one row."""
_CHAMBERS = ("pressure_a", "pressure_b")


def current_is_late(problem: Problem, assessment: Assessment) -> str | None:
    """Return a sentence if the recorded current is a row late and a mismatch that nobody named is due to that."""
    equations = {place.equation for place in assessment.remainder}
    if PRESSURE not in problem.blocks or not equations & {"actuation", *_CHAMBERS}:
        return None
    if _goes_away(problem, [model.spacing for model in problem.models]):
        return (
            "the valve current is recorded a row late: with each row's current taken from the next row, the mismatch "
            "in the chambers' pressures goes away; a row must hold the current that acts from it to the next one, so "
            "move that column up by one row and diagnose again"
        )
    if any(model.spacing > 1 for model in problem.models) and _goes_away(problem, [1] * len(problem.models)):
        return (
            "the valve current is recorded a millisecond late: with the current of a millisecond later the mismatch in "
            "the chambers' pressures goes away; a row must hold the current that acts from it on, so record that one"
        )
    return None


def current_is_early(problem: Problem, effects: Sequence[EffectReport]) -> str | None:
    """Return a sentence if a claimed dead time is one row: a current written a row before it acts looks the same."""
    rows = {model.step * model.spacing for model in problem.models}
    for effect in effects:
        bounds = effect.parameters["time"].ci95 if effect.id == "transport_delay" else None
        if bounds and any(bounds[0] - TIMING <= row <= bounds[1] + TIMING for row in rows):
            return (
                "the dead time is that of one row: a logger that writes each row's current a row before it acts looks "
                "the same; if this one does, move that column down by one row and diagnose again"
            )
    return None


def _goes_away(problem: Problem, rows: Sequence[int]) -> bool:
    """Return whether the mismatch does once each segment has the current of so many samples later."""
    moved = [_moved(model.segment, count) for model, count in zip(problem.models, rows, strict=True)]
    shifted = Problem(moved, problem.bench, problem.baseline, noise=problem.sensor_noise)
    return _excess(shifted) <= GOES_AWAY * _excess(problem)


def _moved(segment: Segment, rows: int) -> Segment:
    current = segment.channels["valve_current"]
    early = np.concatenate([current[rows:], np.repeat(current[-1:], rows)])
    return replace(segment, channels={**segment.channels, "valve_current": early})


def _excess(problem: Problem) -> float:
    """Mean square of the pressures' residuals beyond the noise's, nothing claimed."""
    squares = mean_squares(problem, problem.residual(()))
    return sum(max(squares[name] - 1.0, 0.0) for name in _CHAMBERS)
