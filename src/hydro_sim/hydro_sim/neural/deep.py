# SPDX-License-Identifier: Apache-2.0
"""A network of any depth for x', alone or on top of the analytic model's sample; gradient through time.

::

    z = (x - center) / scale (8), v = u / u_scale           y = network([z, v])  (9 -> h1 -> ... -> hn -> 8), ReLU
    z[k+1] = z[k] + step * y                                by itself
    z[k+1] = z[k] + step * y + gain(x[k], u[k]) / scale     residual: `analytic_step.gain`

    flat weights  | W1 (9, h1) | b1 (h1) | ... | W (hn, 8) | b (8) |        sizes = 9, h1, ..., hn, 8
    loss          mean over windows, horizon and states of (z - measured)^2

Windows are processed in blocks, a layer at a time, as products of matrices (BLAS). For two small layers alone there is
`network`, which keeps them in registers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange

from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.model import analytic_step
from hydro_sim.neural.network import STATES

BLOCK = 64
"""Windows that are processed together."""


class Parts(NamedTuple):
    """A model in the form that the kernels take."""

    flat: Any
    """Weights, float32 or float64; everything is computed in the same type."""
    sizes: Any
    """Sizes of the layers, inputs and outputs included, int64."""
    step: Any
    """Increment of z in a sample per unit of the outputs, shape (8,), of the weights' type."""
    residual: bool
    """Whether the analytic model's gain is added."""
    constants: Any
    """The bench, one record of `BENCH_DTYPE`, shape (1,)."""
    memories: Any
    """The box's coefficients for rates, shape (2,)."""
    center: Any
    scale: Any
    current_scale: float


@njit
def layer(parts, index):
    """Weights, shape (n, m), and biases, shape (m,), of a layer: views of the flat vector."""
    flat, sizes, begin = parts.flat, parts.sizes, 0
    for i in range(index):
        begin += (sizes[i] + 1) * sizes[i + 1]
    n, m = sizes[index], sizes[index + 1]
    return flat[begin : begin + n * m].reshape(n, m), flat[begin + n * m : begin + (n + 1) * m]


@njit
def _places(sizes, rows):
    """Start of each layer in a buffer of `rows` rows a layer, and the end of the buffer."""
    places = np.zeros(len(sizes) + 1, np.int64)
    for index in range(len(sizes)):
        places[index + 1] = places[index] + rows * sizes[index]
    return places


@njit
def _rows(buffer, places, sizes, index, begin, end):
    """Rows begin:end of a layer, shape (end - begin, size)."""
    at, size = places[index], sizes[index]
    return buffer[at + begin * size : at + end * size].reshape(end - begin, size)


@njit
def _advance(parts, kept, places, row, z, v):
    """z, shape (n, 8), a sample later, in place, under v, shape (n,); the layers' inputs stay in `kept` from `row`."""
    n, last, zero = len(z), len(parts.sizes) - 2, z.dtype.type(0.0)
    a = _rows(kept, places, parts.sizes, 0, row, row + n)
    copies.matrix(a, z)
    copies.vector(a[:, STATES], v)
    for index in range(last):
        w, b = layer(parts, index)
        then = _rows(kept, places, parts.sizes, index + 1, row, row + n)
        np.dot(a, w, then)
        for k in range(n):
            for j in range(len(b)):
                value = then[k, j] + b[j]
                then[k, j] = zero if value < zero else value
        a = then
    w, b = layer(parts, last)
    y = np.dot(a, w)
    if parts.residual:
        _gain(parts, z, v)
    for k in range(n):
        for i in range(STATES):
            z[k, i] += parts.step[i] * (y[k, i] + b[i])


@njit
def _gain(parts, z, v):
    """Add the analytic model's gain to z, shape (n, 8)."""
    x, moved, physics = np.empty(STATES), np.empty(STATES), (parts.constants, parts.memories)
    for k in range(len(z)):
        for i in range(STATES):
            x[i] = parts.center[i] + parts.scale[i] * z[k, i]
        analytic_step.gain(physics, x, parts.current_scale * v[k], moved)
        for i in range(STATES):
            z[k, i] += moved[i] / parts.scale[i]


@njit
def _gain_back(parts, z, v, after, before):
    """Backpropagate the gain: add its part of the gradient by z after a sample to that before it, shapes (n, 8)."""
    x, g, back = np.empty(STATES), np.empty(STATES), np.empty(STATES)
    physics = parts.constants, parts.memories
    for k in range(len(z)):
        for i in range(STATES):
            x[i] = parts.center[i] + parts.scale[i] * z[k, i]
            g[i], back[i] = after[k, i] / parts.scale[i], 0.0
        analytic_step.add_gradient(physics, x, parts.current_scale * v[k], g, back)
        for i in range(STATES):
            before[k, i] += back[i] * parts.scale[i]


@njit
def roll(parts, starts, currents, states):
    """z after each sample into `states`, shape (n, H, 8): one block, one thread."""
    n, horizon = currents.shape
    places = _places(parts.sizes, n)
    kept, z = np.empty(places[-1], parts.flat.dtype), starts.copy()
    for h in range(horizon):
        _advance(parts, kept, places, 0, z, currents[:, h])
        copies.matrix(states[:, h], z)


@njit
def _back(parts, kept, places, slopes, slope_places, row, v, gz):
    """gz, shape (n, 8), by z after a sample becomes that by z before it; the layers' gradients go to `slopes`."""
    n, last, before = len(gz), len(parts.sizes) - 2, gz.copy()
    g = _rows(slopes, slope_places, parts.sizes[1:], last, row, row + n)
    for k in range(n):
        for i in range(STATES):
            g[k, i] = parts.step[i] * gz[k, i]
    for index in range(last, 0, -1):
        a = _rows(kept, places, parts.sizes, index, row, row + n)
        then = _rows(slopes, slope_places, parts.sizes[1:], index - 1, row, row + n)
        np.dot(g, layer(parts, index)[0].T, then)
        for k in range(n):
            for j in range(a.shape[1]):
                if a[k, j] <= 0.0:
                    then[k, j] = 0.0
        g = then
    to_inputs = np.dot(g, layer(parts, 0)[0].T)
    for k in range(n):
        for i in range(STATES):
            before[k, i] += to_inputs[k, i]
    if parts.residual:
        seen = _rows(kept, places, parts.sizes, 0, row, row + n)
        _gain_back(parts, seen, v, gz, before)
    copies.matrix(gz, before)


@njit
def _block(parts, starts, currents, targets, gradient):
    """Summed loss of a block of windows; its gradient is added to `gradient`, flat."""
    n, horizon = currents.shape
    places, slope_places = _places(parts.sizes, n * horizon), _places(parts.sizes[1:], n * horizon)
    kept, slopes = np.empty(places[-1], parts.flat.dtype), np.empty(slope_places[-1], parts.flat.dtype)
    z, loss, share = starts.copy(), 0.0, starts.dtype.type(2.0 / horizon)
    errors = np.empty((horizon, n, STATES), starts.dtype)
    for h in range(horizon):
        _advance(parts, kept, places, h * n, z, currents[:, h])
        for k in range(n):
            for i in range(STATES):
                error = z[k, i] - targets[k, h, i]
                errors[h, k, i] = error
                loss += float(error * error) / horizon
    gz = np.zeros_like(z)
    for h in range(horizon - 1, -1, -1):
        for k in range(n):
            for i in range(STATES):
                gz[k, i] += share * errors[h, k, i]
        _back(parts, kept, places, slopes, slope_places, h * n, currents[:, h], gz)
    begin, rows = 0, n * horizon
    for index in range(len(parts.sizes) - 1):
        a = _rows(kept, places, parts.sizes, index, 0, rows)
        g = _rows(slopes, slope_places, parts.sizes[1:], index, 0, rows)
        outer, size = np.dot(a.T, g), g.shape[1]
        for i in range(a.shape[1]):
            for j in range(size):
                gradient[begin + i * size + j] += outer[i, j]
        begin += outer.size
        for k in range(rows):
            for j in range(size):
                gradient[begin + j] += g[k, j]
        begin += size
    return loss


@njit(parallel=True)
def rollout(
    flat, sizes, step, residual, constants, memories, center, scale, current_scale, starts, currents
):  # parallel loops take no tuples
    """z after each sample, shape (n, H, 8), from `starts`, shape (n, 8), under scaled currents, shape (n, H)."""
    n, horizon = currents.shape
    states = np.empty((n, horizon, STATES), starts.dtype)
    for block in prange(-(-n // BLOCK)):
        parts = Parts(flat, sizes, step, residual, constants, memories, center, scale, current_scale)
        begin, end = block * BLOCK, min((block + 1) * BLOCK, n)
        roll(parts, starts[begin:end], currents[begin:end], states[begin:end])
    return states


@njit(parallel=True)
def loss_and_gradient(
    flat, sizes, step, residual, constants, memories, center, scale, current_scale, starts, currents, targets, threads
):
    """Loss of a batch and its gradient by the flat weights; float32 or float64, as the arrays are.

    Shapes: starts (n, 8), scaled currents (n, H), targets (n, H, 8). Each thread takes a share of the blocks.
    """
    n, blocks = len(currents), -(-len(currents) // BLOCK)
    losses, gradients = np.zeros(threads), np.zeros((threads, len(flat)), flat.dtype)
    for t in prange(threads):
        parts = Parts(flat, sizes, step, residual, constants, memories, center, scale, current_scale)
        for block in range(t * blocks // threads, (t + 1) * blocks // threads):
            begin, end = block * BLOCK, min((block + 1) * BLOCK, n)
            part = starts[begin:end], currents[begin:end], targets[begin:end]
            losses[t] += _block(parts, part[0], part[1], part[2], gradients[t])
    return losses.sum() / (n * STATES), gradients.sum(0) * flat.dtype.type(1.0 / (n * STATES))
