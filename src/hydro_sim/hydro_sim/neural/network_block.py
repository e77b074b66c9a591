# SPDX-License-Identifier: Apache-2.0
"""A block of `dense.BLOCK` windows of the paper's model: its buffers, one sample forward, one sample back in time.

Windows stand side by side along the vector registers; `network` rolls blocks out and shares them among threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from hydro_sim.neural import dense
from hydro_sim.neural.dense import BLOCK, CHUNK, ROW
from hydro_sim.neural.mlp import LOOSE

STATES = 8


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
def make(layers, horizon, trained):
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
def states_at(work, i, h):
    """State i of all windows before sample h, a view of shape (BLOCK,)."""
    begin = i * ROW + h % CHUNK * BLOCK
    return work.x[h // CHUNK, begin : begin + BLOCK]


@njit(cache=True)
def load(work, starts, currents):
    """First states and all currents of up to BLOCK windows; where there are fewer, the last one fills up."""
    count, horizon = currents.shape
    for i in range(STATES):
        z = states_at(work, i, 0)
        for k in range(BLOCK):
            z[k] = starts[min(k, count - 1), i]
    for h in range(horizon):
        v = states_at(work, STATES, h)
        for k in range(BLOCK):
            v[k] = currents[min(k, count - 1), h]


@njit(cache=True, fastmath=LOOSE)
def advance(layers, step, work, h):
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
        z, then, y = states_at(work, i, h), states_at(work, i, h + 1), dense.row(work.y, i, at)
        for k in range(BLOCK):
            then[k] = z[k] + step[i] * y[k]


@njit(cache=True, fastmath=LOOSE)
def errors(work, targets, printed):
    """Loss of a block, from targets of shape (count, H, 8); leaves its gradient by the states in `work.errors`.

    Windows that only fill up the block have neither.
    """
    count, horizon, _ = targets.shape
    kind = work.errors.dtype.type
    total, loss, share = np.zeros((STATES, BLOCK), work.errors.dtype), 0.0, kind(2.0 / horizon)
    for h in range(horizon):
        for i in range(STATES):
            z, part = states_at(work, i, h + 1), kind(0.0)
            for k in range(count):
                error = z[k] - targets[k, h, i]
                total[i, k] += error
                part += error * error
                work.errors[h, i, k] = share * error
            for k in range(count, BLOCK):
                work.errors[h, i, k] = kind(0.0)
            loss += part
    if not printed:
        return loss / horizon
    loss = 0.0
    for i in range(STATES):
        for k in range(BLOCK):
            loss += total[i, k] * total[i, k]
            for h in range(horizon):
                work.errors[h, i, k] = kind(2.0) * total[i, k]
    return loss


@njit(cache=True, fastmath=LOOSE)
def back(layers, transposed, step, work, h):
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
def add_weights(work, horizon, c, gradient):
    """Add what the steps of chunk c give to the gradient (Layers)."""
    count = min(CHUNK, horizon - c * CHUNK) * BLOCK
    dense.outer(work.a2[c], work.y, gradient.w3, gradient.b3, count)
    dense.outer(work.a1[c], work.g2, gradient.w2, gradient.b2, count)
    dense.outer(work.x[c], work.g1, gradient.w1, gradient.b1, count)
