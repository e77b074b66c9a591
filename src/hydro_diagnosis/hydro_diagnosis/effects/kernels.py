# SPDX-License-Identifier: Apache-2.0
"""Compiled functions of the effects: path memory, lags, splines, soft edges, means over substeps."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from hydro_core.signals import FloatArray
from hydro_sim.jit import njit
from hydro_sim.model.tables import KNOTS


@njit
def along(position, stiffness, limit):
    """Force at each of the positions, shape (n,), at rest at the first; `limit`: shape (n,), where it yields.

    Within a sample the solution of dF/dx = stiffness (1 - F sign(dx)/limit) is exact. Source: Dahl 1968.
    """
    force = np.zeros(len(position))
    for k in range(1, len(position)):
        moved = position[k] - position[k - 1]
        goal = limit[k] if moved > 0.0 else -limit[k]
        fade = np.exp(-stiffness * abs(moved) / max(abs(limit[k]), 1e-6))
        force[k] = goal + (force[k - 1] - goal) * fade
    return force


def held_lag(signal: FloatArray, step: float, time: float, start: float) -> tuple[FloatArray, FloatArray]:
    """First-order lag of a held signal, shape (n,), from `start`: where each step [s] begins, and its mean there."""
    decay = float(np.exp(-step / time))
    begins, _ = lfilter([0.0, 1.0 - decay], [1.0, -decay], signal, zi=[start])
    return begins, begins + (1.0 - (1.0 - decay) * time / step) * (signal - begins)


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


STRAIGHT = 40.0
"""Argument beyond which a softplus is its argument, to the last bit."""


def opened(current: FloatArray, width: float, soft: float) -> FloatArray:
    """Current [A] that acts, of the same shape, behind an overlap of half `width` that opens over `soft` [A]."""
    found = np.empty(current.shape)
    _opened(found.reshape(-1), np.ascontiguousarray(current).reshape(-1), width / soft, soft)
    return found


@njit
def _opened(found, current, edge, soft):
    for k in range(len(found)):
        if k > 0 and current[k] == current[k - 1]:  # held over a sample's substeps
            found[k] = found[k - 1]
        else:
            ratio = current[k] / soft
            found[k] = soft * (_softplus(ratio - edge) - _softplus(-ratio - edge))


@njit
def _softplus(over):
    if over > STRAIGHT:
        return over
    return over + math.log1p(math.exp(-over)) if over > 0.0 else math.log1p(math.exp(over))


def substep_mean(signal: FloatArray) -> FloatArray:
    """Mean over the last axis, which is short: from shape (..., substeps) to (...)."""
    first, *others = np.moveaxis(signal, -1, 0)
    return np.asarray(sum(others, first) / signal.shape[-1])
