# SPDX-License-Identifier: Apache-2.0
"""M(x) and its rate along the flow, compiled: constant, or a network's Cholesky factor plus a floor.

::

    z = (x - center) / scale      y = network(z)   8 -> h1 -> h2 -> 36, ReLU      L: y row by row below the diagonal
    M = L L' + floor I            M' = L' L^T + L L'^T,  L' the network's derivative along z' = x' / scale
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from hydro_bridge.signals import FloatArray
from hydro_filter.metric import ConstantMetric
from hydro_filter.state import STATES
from hydro_sim.learned import mlp

ENTRIES = STATES * (STATES + 1) // 2
"""Of a Cholesky factor."""


class MetricParts(NamedTuple):
    """What the kernels take."""

    constant: FloatArray
    """M, shape (8, 8), where the network has no outputs."""
    layers: mlp.Layers
    """8 inputs and 36 outputs, or none."""
    center: FloatArray
    """Shape (8,), SI units."""
    scale: FloatArray
    """Shape (8,), SI units."""
    floor: float
    """Smallest eigenvalue, above 0."""


def constant_parts(metric: ConstantMetric) -> MetricParts:
    """Of a metric that does not depend on x."""
    none = mlp.layers(np.empty(mlp.count(STATES, (1, 1), 0)), STATES, (1, 1), 0)
    return MetricParts(metric.matrix(np.zeros(STATES)), none, np.zeros(STATES), np.ones(STATES), 0.0)


@njit(cache=True)
def matrix_and_rate(parts, x, rate, matrix, turn):
    """Write M and M' [1/s], shape (8, 8), on normalized states, at x (8,) along x' (8,), both in SI units."""
    if parts.layers.b3.shape[0] == 0:
        matrix[:] = parts.constant
        turn[:] = 0.0
        return
    layers = parts.layers
    h1, h2 = layers.b1.shape[0], layers.b2.shape[0]
    z, dz, a1, a2, y = np.empty(STATES), np.empty(STATES), np.empty(h1), np.empty(h2), np.empty(ENTRIES)
    for i in range(STATES):
        z[i], dz[i] = (x[i] - parts.center[i]) / parts.scale[i], rate[i] / parts.scale[i]
    mlp.forward(layers, z, a1, a2, y)
    d1, d2, dy = np.empty(h1), np.empty(h2), np.empty(ENTRIES)
    _along(layers.w1, dz, d1)
    _mask(a1, d1)
    _along(layers.w2, d1, d2)
    _mask(a2, d2)
    _along(layers.w3, d2, dy)
    _square(y, dy, parts.floor, matrix, turn)


@njit(cache=True, fastmath=mlp.LOOSE)
def _along(w, dx, dy):
    for j in range(dy.shape[0]):
        dy[j] = 0.0
    for i in range(dx.shape[0]):
        scale = dx[i]
        if scale != 0.0:  # half of the units are off
            for j in range(dy.shape[0]):
                dy[j] += w[i, j] * scale


@njit(cache=True)
def _mask(activations, d):
    for i in range(d.shape[0]):
        if activations[i] <= 0.0:
            d[i] = 0.0


@njit(cache=True)
def _square(y, dy, floor, matrix, turn):
    """M and M' from the factor's entries and theirs."""
    for i in range(STATES):
        for j in range(i + 1):
            total, turned = 0.0, 0.0
            for k in range(j + 1):
                left, right = y[i * (i + 1) // 2 + k], y[j * (j + 1) // 2 + k]
                total += left * right
                turned += dy[i * (i + 1) // 2 + k] * right + left * dy[j * (j + 1) // 2 + k]
            matrix[i, j] = matrix[j, i] = total
            turn[i, j] = turn[j, i] = turned
        matrix[i, i] += floor
