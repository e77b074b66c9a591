# SPDX-License-Identifier: Apache-2.0
"""The paper's model: one network gives x' from (x, u), rolled out recursively; loss and gradient through time.

::

    z = (x - center) / scale (8), v = u / u_scale          y = network([z, v])  (9 -> h1 -> h2 -> 8)
    z[k+1] = z[k] + step * y      step: of one sample in units of z, so that y is of order one for every state

    loss   mean over windows, horizon and states of (z - measured)^2                       form "squared", the default
           mean over windows and states of (sum over the horizon of (z - measured))^2      form "printed", eq. loss

Source: paper eq. state, eq. loss, Table training; learned_model.md says why the printed form is not the default.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.neural import block_mlp, mlp, network_block
from hydro_sim.neural.dense import BLOCK, CHUNK
from hydro_sim.neural.mlp import LOOSE
from hydro_sim.neural.network_block import STATES as STATES

INPUTS = STATES + 1


@njit(fastmath=LOOSE)
def advance(layers, step, z, current, x, a1, a2, y):
    """One sample of z, shape (8,), in place; `x`, shape (9,), and activations are left as the network saw them."""
    for i in range(STATES):
        x[i] = z[i]
    x[STATES] = current
    mlp.forward(layers, x, a1, a2, y)
    for i in range(STATES):
        z[i] += step[i] * y[i]


@njit(parallel=True)
def rollout(layers, step, starts, currents):
    """z after each sample, shape (n, H, 8), from `starts`, shape (n, 8), under scaled currents, shape (n, H)."""
    n, horizon = currents.shape
    states = np.empty((n, horizon, STATES), starts.dtype)
    for block in prange(-(-n // BLOCK)):
        begin, end = block * BLOCK, min((block + 1) * BLOCK, n)
        _rollout_block(layers, step, starts[begin:end], currents[begin:end], states[begin:end])
    return states


@njit
def _rollout_block(layers, step, starts, currents, states):
    count, horizon = currents.shape
    filled = block_mlp.padded(layers)
    work = network_block.workspace(filled, horizon, False)
    network_block.load(work, starts, currents)
    for h in range(horizon):
        network_block.advance(filled, step, work, h)
        for i in range(STATES):
            copies.vector(states[:, h, i], network_block.states_at(work, i, h + 1)[:count])


@njit
def _share(layers, step, starts, currents, targets, printed):
    """Loss of a thread's windows, block by block, and its gradient by the flat weights."""
    n, horizon = currents.shape
    filled, loss = block_mlp.padded(layers), 0.0
    work, gradient = network_block.workspace(filled, horizon, True), block_mlp.zeros(filled)
    transposed = filled.w1[:STATES].T.copy(), filled.w2.T.copy(), filled.w3.T.copy()
    for begin in range(0, n, BLOCK):
        end = min(begin + BLOCK, n)
        network_block.load(work, starts[begin:end], currents[begin:end])
        for h in range(horizon):
            network_block.advance(filled, step, work, h)
        loss += network_block.errors(work, targets[begin:end], printed)
        work.gz[:] = work.gz.dtype.type(0.0)
        for h in range(horizon - 1, -1, -1):
            network_block.step_backward(transposed, step, work, h)
            if h % CHUNK == 0:
                network_block.add_weights(work, horizon, h // CHUNK, gradient)
    return loss, block_mlp.unpadded(gradient, INPUTS, len(layers.b1), len(layers.b2))


@njit(parallel=True)
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
        losses[t], gradient = _share(layers, step, part[0], part[1], part[2], printed)
        copies.vector(gradients[t], gradient)
    return losses.sum() / (n * STATES), gradients.sum(0) * kind.type(1.0 / (n * STATES))
