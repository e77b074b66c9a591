# SPDX-License-Identifier: Apache-2.0
"""Whether a logger wrote into each row the current that acted before it, and not the one that acts from it on.

Nothing on a bench answers a current early. So where a mismatch at the valve goes away once every row gets the current
of the next, it is the logger's convention that is off, not the bench.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_diagnosis.effects.base import PRESSURE
from hydro_diagnosis.locate import mean_squares
from hydro_diagnosis.problem import Problem
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.verdict import Assessment

GOES_AWAY = 0.1
"""Share of the pressures' mismatch that may be left for it to have gone away."""
_CHAMBERS = ("pressure_a", "pressure_b")


def current_is_late(problem: Problem, assessment: Assessment) -> str | None:
    """A sentence if the recorded current is a row late and a mismatch that nobody named is due to that."""
    equations = {place.equation for place in assessment.remainder}
    if PRESSURE not in problem.blocks or not equations & {"actuation", *_CHAMBERS}:
        return None
    moved = [_moved(model.segment) for model in problem.models]
    shifted = Problem(moved, problem.bench, problem.baseline, noise=problem.sensor_noise)
    if _excess(shifted) > GOES_AWAY * _excess(problem):
        return None
    return (
        "the valve current is recorded a row late: with each row's current taken from the next row, the mismatch in "
        "the chambers' pressures goes away; a row must hold the current that acts from it to the next one, so "
        "move that column up by one row and diagnose again"
    )


def _moved(segment: Segment) -> Segment:
    current = segment.channels["valve_current"]
    early = np.concatenate([current[1:], current[-1:]])
    return replace(segment, channels={**segment.channels, "valve_current": early})


def _excess(problem: Problem) -> float:
    """Mean square of the pressures' residuals beyond the noise's, nothing claimed."""
    squares = mean_squares(problem, problem.residual(()))
    return sum(max(squares[name] - 1.0, 0.0) for name in _CHAMBERS)
