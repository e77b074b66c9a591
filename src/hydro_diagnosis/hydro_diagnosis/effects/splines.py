# SPDX-License-Identifier: Apache-2.0
"""Values of a table (`hydro_sim.model.tables.Table.value`) in one pass over an array."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import FloatArray
from hydro_sim.jit import njit
from hydro_sim.model.tables import KNOTS

_LAST = KNOTS - 3
"""Intervals between the peaks of the splines that a table's variable may lie in."""


def splined(variable: FloatArray, low: float, high: float, values: FloatArray) -> FloatArray:
    """Sum of cubic B-splines of these `values` (KNOTS,) over a variable between `low` and `high`, constant beyond."""
    found = np.empty(variable.shape)
    _splined(found.reshape(-1), np.ascontiguousarray(variable).reshape(-1), low, _LAST / (high - low), values)
    return found


@njit
def _splined(found, variable, low, scale, values):
    for k in range(len(variable)):
        along = (variable[k] - low) * scale
        if along != along:  # a simulation that has run away
            found[k] = np.nan
            continue
        along = min(max(along, 0.0), float(_LAST))
        at = min(int(along), _LAST - 1)
        t = along - at
        s = 1.0 - t
        found[k] = (
            s * s * s * values[at]
            + (4.0 - 3.0 * t * t * (2.0 - t)) * values[at + 1]
            + (4.0 - 3.0 * s * s * (2.0 - s)) * values[at + 2]
            + t * t * t * values[at + 3]
        ) / 6.0
