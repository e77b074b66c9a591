# SPDX-License-Identifier: Apache-2.0
"""The paper's model: one network gives x' from (x, u), rolled out recursively; loss and gradient through time.

::

    z = (x - center) / scale (8), v = u / u_scale          y = network([z, v])  (9 -> h1 -> h2 -> 8)
    z[k+1] = z[k] + step * y      step: of one sample in units of z, so that y is of order one for every state

    loss   mean over windows, horizon and states of (z - measured)^2                       form "squared", the default
           mean over windows and states of (sum over the horizon of (z - measured))^2      form "printed", eq. loss

Source: paper eq. state, eq. loss, Table training; docs/physics.md says why the printed form is not the default.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from hydro_sim.learned import dense, mlp
from hydro_sim.learned.dense import BLOCK, CHUNK, ROW
from hydro_sim.learned.mlp import LOOSE

STATES, INPUTS = 8, 9


@njit(cache=True, fastmath=LOOSE)
def advance(layers, step, z, current, x, a1, a2, y):
    """One sample of z, shape (8,), in place; `x`, shape (9,), and activations are left as the network saw them."""
    for i in range(STATES):
        x[i] = z[i]
    x[STATES] = current
    mlp.forward(layers, x, a1, a2, y)
    for i in range(STATES):
        z[i] += step[i] * y[i]


class Work(NamedTuple):
    """A thread's buffers for one block of windows. Those of the network are in rows, a chunk of steps each: `dense`."""

    x: npt.NDArray[np.floating]
    """What the network saw: z, current, three rows of zeros; (chunks, 12 * ROW)."""
    a1: npt.NDArray[np.floating]
    """Activations, of all chunks or of the current one: (chunks or 1, h1 * ROW)."""
    a2: npt.NDArray[np.floating]
    y: npt.NDArray[np.floating]
    """Outputs, then their gradients."""
    g1: npt.NDArray[np.floating]
    """Gradients by what enters the ReLUs, one chunk."""
    g2: npt.NDArray[np.floating]
    gz: npt.NDArray[np.floating]
    """Gradient by the state, one step: 8 rows."""
    errors: npt.NDArray[np.floating]
    """(H, 8, BLOCK)."""


@njit(cache=True)
def _work(layers, horizon, trained):
    """Buffers; without `trained`, what a roll-out alone needs."""
    chunks, kind = horizon // CHUNK + 1, layers.b1.dtype
    inputs, h1, h2 = layers.w1.shape[0], layers.w2.shape[0], layers.w3.shape[0]
    x = np.zeros((chunks, inputs * ROW), kind)
    if not trained:
        chunks, horizon = 1, 0
    a1, a2 = np.empty((chunks, h1 * ROW), kind), np.empty((chunks, h2 * ROW), kind)
    y, g1, g2 = np.empty(STATES * ROW, kind), np.empty(h1 * ROW, kind), np.empty(h2 * ROW, kind)
    return Work(x, a1, a2, y, g1, g2, np.empty(STATES * ROW, kind), np.zeros((horizon, STATES, BLOCK), kind))


@njit(cache=True)
def _states(work, i, h):
    """State i of all windows before sample h, a view of shape (BLOCK,)."""
    begin = i * ROW + h % CHUNK * BLOCK
    return work.x[h // CHUNK, begin : begin + BLOCK]


@njit(cache=True)
def _load(work, starts, currents):
    """First states and all currents of up to BLOCK windows; where there are fewer, the last one fills up."""
    count, horizon = currents.shape
    for i in range(STATES):
        z = _states(work, i, 0)
        for k in range(BLOCK):
            z[k] = starts[min(k, count - 1), i]
    for h in range(horizon):
        v = _states(work, STATES, h)
        for k in range(BLOCK):
            v[k] = currents[min(k, count - 1), h]


@njit(cache=True, fastmath=LOOSE)
def _advance_block(layers, step, work, h):
    """States after sample h from those before it; leaves the activations."""
    at, kept = np.uint64(h % CHUNK * BLOCK), h // CHUNK % len(work.a1)
    a1, a2 = work.a1[kept], work.a2[kept]
    dense.fill(a1, at, layers.b1)
    dense.product(layers.w1, work.x[h // CHUNK], at, a1, at)
    dense.relu(a1, at, len(layers.b1))
    dense.fill(a2, at, layers.b2)
    dense.product(layers.w2, a1, at, a2, at)
    dense.relu(a2, at, len(layers.b2))
    dense.fill(work.y, at, layers.b3)
    dense.product(layers.w3, a2, at, work.y, at)
    for i in range(STATES):
        z, then, y = _states(work, i, h), _states(work, i, h + 1), dense.row(work.y, i, at)
        for k in range(BLOCK):
            then[k] = z[k] + step[i] * y[k]


@njit(cache=True, parallel=True)
def rollout(layers, step, starts, currents):
    """z after each sample, shape (n, H, 8), from `starts`, shape (n, 8), under scaled currents, shape (n, H)."""
    n, horizon = currents.shape
    states = np.empty((n, horizon, STATES), starts.dtype)
    for block in prange(-(-n // BLOCK)):
        begin, end = block * BLOCK, min((block + 1) * BLOCK, n)
        _rollout_block(layers, step, starts[begin:end], currents[begin:end], states[begin:end])
    return states


@njit(cache=True)
def _rollout_block(layers, step, starts, currents, states):
    count, horizon = currents.shape
    filled = dense.padded(layers)
    work = _work(filled, horizon, False)
    _load(work, starts, currents)
    for h in range(horizon):
        _advance_block(filled, step, work, h)
        for i in range(STATES):
            states[:, h, i] = _states(work, i, h + 1)[:count]


@njit(cache=True, fastmath=LOOSE)
def _errors(work, targets, printed):
    """Loss of a block, from targets of shape (count, H, 8); leaves its gradient by the states in `work.errors`.

    Windows that only fill up the block have neither.
    """
    count, horizon, _ = targets.shape
    kind = work.errors.dtype.type
    work.errors[:, :, count:] = kind(0.0)
    total, loss, share = np.zeros((STATES, BLOCK), work.errors.dtype), 0.0, kind(2.0 / horizon)
    for h in range(horizon):
        for i in range(STATES):
            z, part = _states(work, i, h + 1), kind(0.0)
            for k in range(count):
                error = z[k] - targets[k, h, i]
                total[i, k] += error
                part += error * error
                work.errors[h, i, k] = share * error
            loss += part
    if not printed:
        return loss / horizon
    work.errors[:] = kind(2.0) * total
    return float((total * total).sum())


@njit(cache=True, fastmath=LOOSE)
def _back_block(layers, transposed, step, work, h):
    """Gradient by the states before sample h from that by those after it; leaves those by the layers' outputs."""
    at, start = np.uint64(h % CHUNK * BLOCK), np.uint64(0)
    a1, a2 = work.a1[h // CHUNK], work.a2[h // CHUNK]
    for i in range(STATES):
        gz, gy = dense.row(work.gz, i, start), dense.row(work.y, i, at)
        for k in range(BLOCK):
            gz[k] += work.errors[h, i, k]
            gy[k] = step[i] * gz[k]
    dense.clear(work.g2, at, len(layers.b2))
    dense.product(transposed[2], work.y, at, work.g2, at)
    dense.mask(work.g2, a2, at, len(layers.b2))
    dense.clear(work.g1, at, len(layers.b1))
    dense.product(transposed[1], work.g2, at, work.g1, at)
    dense.mask(work.g1, a1, at, len(layers.b1))
    dense.product(transposed[0], work.g1, at, work.gz, start)


@njit(cache=True)
def _add_weights(work, horizon, c, gradient):
    """Add what the steps of chunk c give to the gradient (Layers)."""
    count = min(CHUNK, horizon - c * CHUNK) * BLOCK
    dense.outer(work.a2[c], work.y, gradient.w3, gradient.b3, count)
    dense.outer(work.a1[c], work.g2, gradient.w2, gradient.b2, count)
    dense.outer(work.x[c], work.g1, gradient.w1, gradient.b1, count)


@njit(cache=True)
def _share(layers, step, starts, currents, targets, printed):
    """Loss of a thread's windows, block by block, and its gradient by the flat weights."""
    n, horizon = currents.shape
    filled, loss = dense.padded(layers), 0.0
    work, gradient = _work(filled, horizon, True), dense.zeros(filled)
    transposed = filled.w1[:STATES].T.copy(), filled.w2.T.copy(), filled.w3.T.copy()
    for begin in range(0, n, BLOCK):
        end = min(begin + BLOCK, n)
        _load(work, starts[begin:end], currents[begin:end])
        for h in range(horizon):
            _advance_block(filled, step, work, h)
        loss += _errors(work, targets[begin:end], printed)
        work.gz[:] = work.gz.dtype.type(0.0)
        for h in range(horizon - 1, -1, -1):
            _back_block(filled, transposed, step, work, h)
            if h % CHUNK == 0:
                _add_weights(work, horizon, h // CHUNK, gradient)
    return loss, dense.unpadded(gradient, INPUTS, len(layers.b1), len(layers.b2))


@njit(cache=True, parallel=True)
def loss_and_gradient(layers, step, starts, currents, targets, printed, threads):
    """Loss of a batch and its gradient by the flat weights; float32 or float64, as the arrays are.

    Shapes: starts (n, 8), scaled currents (n, H), targets (n, H, 8). Each thread takes a share of the blocks.
    """
    n, blocks, kind = len(currents), -(-len(currents) // BLOCK), layers.b1.dtype
    losses = np.zeros(threads)
    size = layers.w1.size + layers.b1.size + layers.w2.size + layers.b2.size + layers.w3.size + layers.b3.size
    gradients = np.zeros((threads, size), kind)
    for t in prange(threads):
        begin, end = t * blocks // threads * BLOCK, min((t + 1) * blocks // threads * BLOCK, n)
        part = starts[begin:end], currents[begin:end], targets[begin:end]
        losses[t], gradients[t] = _share(layers, step, part[0], part[1], part[2], printed)
    return losses.sum() / (n * STATES), gradients.sum(0) * kind.type(1.0 / (n * STATES))
