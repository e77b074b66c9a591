# SPDX-License-Identifier: Apache-2.0
"""Learned metric, compiled: a Cholesky factor from a table, plus that of a network, plus a floor.

::

    gain K_p --clip--> table of factors --> L_0(K_p) --+
    (x - center) / scale  (8) --+                      +--> L --> M = L L' + floor I,   M' = L' L^T + L L'^T
    K_p / 100, foreign    (2) --+--> 10 -> 64 -> 64 -> 36 ReLU, L row by row

M is symmetric and positive definite for any weights. L' is the network's derivative along x', exact unless a ReLU
switches. K_p is an input because no single metric holds for all stable gains: the loop is about s^2 + d s +
w^2 with w^2 proportional to K_p, and one quadratic form decays for all of w^2 in [p, q] only if sqrt(q) - sqrt(p) < d
(safety.md). `foreign` is 1 for gains outside of the certified range, which have one common metric, the table's last
factor; their K_p is not an input of the network.

The table holds solutions of Riccati and Lyapunov equations (`metric.design`): with zero network weights they are the
metric, which is the starting point and baseline of training.
"""

from __future__ import annotations

from math import isqrt
from typing import NamedTuple

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter.model.coordinates import LOOP
from hydro_filter.model.state import STATES
from hydro_sim.jit import njit
from hydro_sim.neural import mlp

INPUTS = STATES + 2
ENTRIES = LOOP * (LOOP + 1) // 2
"""Of a Cholesky factor, row by row, of the eight coordinates; a bench file may add some (`added_coordinates`)."""
HIDDEN = (64, 64)
"""Table training_metric."""
GAIN_UNIT = 100.0
"""Scale of K_p, 1/s."""


class MetricParts(NamedTuple):
    """The metric as arrays for the kernels."""

    layers: mlp.Layers
    """10 inputs, an output for each entry of the factor: 36 for eight coordinates."""
    center: FloatArray
    """Shape (8,), SI units."""
    scale: FloatArray
    """Shape (8,), SI units."""
    low: FloatArray
    """Shape (8,), SI units: what the network was trained on; a state outside is taken for the nearest inside."""
    high: FloatArray
    """Shape (8,), SI units."""
    gains: FloatArray
    """K_p [1/s] of the table's factors but the last, evenly spaced, shape (n,); the ends are the certified range."""
    table: FloatArray
    """L_0 entries, shape (n + 1, 36); the last row is for foreign gains."""
    floor: float
    """Smallest eigenvalue of M, above 0."""


class MetricValue(NamedTuple):
    """M and M' at one state, and scratch; created by `metric_value`."""

    matrix: FloatArray
    """M on loop coordinates in units of their scale, shape (8, 8); more with added coordinates."""
    rate: FloatArray
    """M' [1/s], of the same shape."""
    inputs: FloatArray
    nudge: FloatArray
    first: FloatArray
    first_nudge: FloatArray
    second: FloatArray
    second_nudge: FloatArray
    factor: FloatArray
    factor_nudge: FloatArray


def width_of(entries: int) -> int:
    """Return the number of coordinates of a factor with so many entries.

    Raises
    ------
    ValueError
        No number of coordinates has so many.
    """
    width = (isqrt(8 * entries + 1) - 1) // 2
    if width * (width + 1) != 2 * entries or width < LOOP:
        raise ValueError(f"{entries} entries are no Cholesky factor of {LOOP} coordinates or more")
    return width


def metric_value(parts: MetricParts) -> MetricValue:
    """Allocate a `MetricValue`."""
    h1, h2 = parts.layers.b1.shape[0], parts.layers.b2.shape[0]
    entries = parts.table.shape[1]
    n = width_of(entries)
    shapes = ((n, n), (n, n), INPUTS, INPUTS, h1, h1, h2, h2, entries, entries)
    return MetricValue(*(np.zeros(shape) for shape in shapes))


@njit(inline="always")
def uncertified(parts, gain):
    """Return whether K_p [1/s] is outside of the certified range; true for NaN."""
    return not parts.gains[0] <= gain <= parts.gains[-1]


@njit(inline="always")
def evaluate(parts, x, state_rate, gain, value):
    """Fill `value` at x (8,) along x' (8,), both in SI units, for K_p [1/s]."""
    layers, outside = parts.layers, uncertified(parts, gain)
    for i in range(STATES):
        seen = min(max(x[i], parts.low[i]), parts.high[i])
        value.inputs[i] = (seen - parts.center[i]) / parts.scale[i]
        value.nudge[i] = state_rate[i] / parts.scale[i] if seen == x[i] else 0.0
    value.inputs[STATES] = 0.0 if outside else gain / GAIN_UNIT
    value.inputs[STATES + 1] = 1.0 if outside else 0.0
    value.nudge[STATES:] = 0.0
    _affine(layers.w1, layers.b1, value.inputs, value.nudge, value.first, value.first_nudge)
    _relu(value.first, value.first_nudge)
    _affine(layers.w2, layers.b2, value.first, value.first_nudge, value.second, value.second_nudge)
    _relu(value.second, value.second_nudge)
    _affine(layers.w3, layers.b3, value.second, value.second_nudge, value.factor, value.factor_nudge)
    _add_table(parts, gain, outside, value.factor)
    _square(value.factor, value.factor_nudge, parts.floor, value.matrix, value.rate)


@njit(inline="always")
def _add_table(parts, gain, outside, factor):
    """Add L_0, interpolated linearly between the table's factors."""
    rows = len(parts.gains)
    if outside or rows == 1:
        row = parts.table[rows if outside else 0]
        for i in range(len(factor)):
            factor[i] += row[i]
        return
    place = (gain - parts.gains[0]) / (parts.gains[1] - parts.gains[0])
    low = min(int(place), rows - 2)
    share = place - low
    for i in range(len(factor)):
        factor[i] += (1.0 - share) * parts.table[low, i] + share * parts.table[low + 1, i]


@njit(fastmath=mlp.LOOSE)
def _affine(w, b, x, dx, y, dy):
    """Compute y = x W + b and its derivative dy along dx, in one pass over the weights."""
    for j in range(y.shape[0]):
        y[j], dy[j] = b[j], 0.0
    for i in range(x.shape[0]):
        value, nudge = x[i], dx[i]
        if value != 0.0 or nudge != 0.0:  # half of the units are inactive
            for j in range(y.shape[0]):
                y[j] += w[i, j] * value
                dy[j] += w[i, j] * nudge


@njit
def _relu(y, dy):
    for i in range(y.shape[0]):
        if y[i] <= 0.0:
            y[i] = dy[i] = 0.0


@njit
def _square(factor, nudge, floor, matrix, rate):
    """Compute M and M' from the factor's entries and their derivatives."""
    if len(matrix) == LOOP:  # a count that the compiler knows
        _square_of(LOOP, factor, nudge, floor, matrix, rate)
    else:
        _square_of(len(matrix), factor, nudge, floor, matrix, rate)


@njit(inline="always")
def _square_of(count, factor, nudge, floor, matrix, rate):
    for i in range(count):
        for j in range(i + 1):
            total, turned = 0.0, 0.0
            for k in range(j + 1):
                left, right = factor[i * (i + 1) // 2 + k], factor[j * (j + 1) // 2 + k]
                total += left * right
                turned += nudge[i * (i + 1) // 2 + k] * right + left * nudge[j * (j + 1) // 2 + k]
            matrix[i, j] = matrix[j, i] = total
            rate[i, j] = rate[j, i] = turned
        matrix[i, i] += floor
