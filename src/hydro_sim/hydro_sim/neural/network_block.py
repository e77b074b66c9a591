# SPDX-License-Identifier: Apache-2.0
"""A block of `dense.BLOCK` windows of the paper's model: its buffers, one sample forward, one sample back in time.

Windows stand side by side along the vector registers; `network` rolls blocks out and shares them among threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_sim.jit import njit
from hydro_sim.neural import block_mlp, dense
from hydro_sim.neural.dense import BLOCK, CHUNK, ROW
from hydro_sim.neural.mlp import LOOSE

STATES = 8


class Workspace(NamedTuple):
    """A thread's buffers for one block of windows. Those of the network are in rows, a chunk of steps each: `dense`."""

    x: npt.NDArray[np.floating]
    """Inputs of the network: z, current, three rows of zeros; (chunks, 12 * ROW)."""
    a1: npt.NDArray[np.floating]
    """Activations, of all chunks or of the current one: (chunks or 1, h1 * ROW)."""
    a2: npt.NDArray[np.floating]
    y: npt.NDArray[np.floating]
    """Outputs, then their gradients."""
    g1: npt.NDArray[np.floating]
    """Gradients with respect to the pre-activations, one chunk."""
    g2: npt.NDArray[np.floating]
    gz: npt.NDArray[np.floating]
    """Gradient with respect to the state, one step: 8 rows."""
    errors: npt.NDArray[np.floating]
    """(H, 8, BLOCK)."""


@njit
def workspace(layers, horizon, trained):
    """Allocate the workspace; without `trained`, only what a roll-out needs."""
    chunks, kind = horizon // CHUNK + 1, layers.b1.dtype
    inputs, h1, h2 = layers.w1.shape[0], layers.w2.shape[0], layers.w3.shape[0]
    x = np.zeros((chunks, inputs * ROW), kind)
    if not trained:
        chunks, horizon = 1, 0
    a1, a2 = np.empty((chunks, h1 * ROW), kind), np.empty((chunks, h2 * ROW), kind)
    y, g1, g2 = np.empty(STATES * ROW, kind), np.empty(h1 * ROW, kind), np.empty(h2 * ROW, kind)
    return Workspace(x, a1, a2, y, g1, g2, np.empty(STATES * ROW, kind), np.zeros((horizon, STATES, BLOCK), kind))


@njit
def states_at(work, i, h):
    """State i of all windows before sample h: a view of shape (BLOCK,)."""
    begin = i * ROW + h % CHUNK * BLOCK
    return work.x[h // CHUNK, begin : begin + BLOCK]


@njit
def load(work, starts, currents):
    """Copy in first states and currents of up to BLOCK windows; the last window is repeated to fill the block."""
    count, horizon = currents.shape
    for i in range(STATES):
        z = states_at(work, i, 0)
        for k in range(BLOCK):
            z[k] = starts[min(k, count - 1), i]
    for h in range(horizon):
        v = states_at(work, STATES, h)
        for k in range(BLOCK):
            v[k] = currents[min(k, count - 1), h]


@njit(fastmath=LOOSE)
def advance(layers, step, work, h):
    """Advance the states by sample h; the activations are kept for the backward pass."""
    at, kept = np.uint64(h % CHUNK * BLOCK), h // CHUNK % len(work.a1)
    a1, a2 = work.a1[kept], work.a2[kept]
    block_mlp.forward(layers, work.x[h // CHUNK], a1, a2, work.y, at)
    for i in range(STATES):
        z, then, y = states_at(work, i, h), states_at(work, i, h + 1), dense.row(work.y, i, at)
        for k in range(BLOCK):
            then[k] = z[k] + step[i] * y[k]


@njit(fastmath=LOOSE)
def errors(work, targets, printed):
    """Loss of a block for targets of shape (count, H, 8); its gradient by the states goes to `work.errors`.

    Windows that were repeated to fill the block do not count.
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


@njit(fastmath=LOOSE)
def step_backward(transposed, step, work, h):
    """Backpropagate through sample h: gradients with respect to states and pre-activations."""
    at, start = np.uint64(h % CHUNK * BLOCK), np.uint64(0)
    a1, a2 = work.a1[h // CHUNK], work.a2[h // CHUNK]
    for i in range(STATES):
        gz, gy = dense.row(work.gz, i, start), dense.row(work.y, i, at)
        for k in range(BLOCK):
            gz[k] += work.errors[h, i, k]
            gy[k] = step[i] * gz[k]
    block_mlp.backward(transposed[2], transposed[1], work.y, a1, a2, work.g1, work.g2, at)
    dense.product(transposed[0], work.g1, at, work.gz, start)


@njit
def add_weights(work, horizon, c, gradient):
    """Add the weight gradients of the steps of chunk c to `gradient` (Layers)."""
    count = min(CHUNK, horizon - c * CHUNK) * BLOCK
    block_mlp.add_gradient(work.x[c], work.a1[c], work.a2[c], work.g1, work.g2, work.y, count, gradient)
