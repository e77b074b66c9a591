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

import numpy as np
from numba import njit, prange

from hydro_sim.learned import mlp
from hydro_sim.learned.mlp import LOOSE

STATES, INPUTS = 8, 9

BLOCK = 128
"""Trajectories that go through the network together: wide enough for BLAS, small enough for the second-level cache."""


@njit(cache=True, fastmath=LOOSE)
def advance(layers, step, z, current, x, a1, a2, y):
    """One sample of z, shape (8,), in place; `x`, shape (9,), and activations are left as the network saw them."""
    for i in range(STATES):
        x[i] = z[i]
    x[STATES] = current
    mlp.forward(layers, x, a1, a2, y)
    for i in range(STATES):
        z[i] += step[i] * y[i]


@njit(cache=True)
def _advance_block(layers, step, z, currents, x, a1, a2, y):
    """One sample of a block of trajectories: z of shape (B, 8) in place, the rest work space of B rows."""
    x[:, :STATES] = z
    x[:, STATES] = currents
    np.dot(x, layers.w1, a1)
    _bias_relu(a1, layers.b1)
    np.dot(a1, layers.w2, a2)
    _bias_relu(a2, layers.b2)
    np.dot(a2, layers.w3, y)
    for k in range(z.shape[0]):
        for i in range(STATES):
            z[k, i] += step[i] * (y[k, i] + layers.b3[i])


@njit(cache=True)
def _bias_relu(a, b):
    for k in range(a.shape[0]):
        for j in range(a.shape[1]):
            a[k, j] = max(a[k, j] + b[j], a.dtype.type(0.0))


@njit(cache=True, parallel=True)
def rollout(layers, step, starts, currents):
    """z after each sample, shape (n, H, 8), from `starts`, shape (n, 8), under scaled currents, shape (n, H)."""
    n, horizon = currents.shape
    states = np.empty((n, horizon, STATES), starts.dtype)
    for block in prange(-(-n // BLOCK)):
        begin, end = block * BLOCK, min((block + 1) * BLOCK, n)
        z = starts[begin:end].copy()
        x, y = np.empty((end - begin, INPUTS), starts.dtype), np.empty((end - begin, STATES), starts.dtype)
        a1 = np.empty((end - begin, layers.b1.shape[0]), starts.dtype)
        a2 = np.empty((end - begin, layers.b2.shape[0]), starts.dtype)
        for h in range(horizon):
            _advance_block(layers, step, z, currents[begin:end, h], x, a1, a2, y)
            states[begin:end, h] = z
    return states


@njit(cache=True)
def _errors(z, targets, printed):
    """Loss of a block from z, shape (H, B, 8), which becomes its gradient by z; targets of shape (B, H, 8)."""
    horizon, count, _ = z.shape
    total, loss = np.zeros((count, STATES), z.dtype), 0.0
    share = z.dtype.type(2.0 / horizon)
    for h in range(horizon):
        part = z.dtype.type(0.0)
        for k in range(count):
            for i in range(STATES):
                error = z[h, k, i] - targets[k, h, i]
                total[k, i] += error
                part += error * error
                z[h, k, i] = share * error
        loss += part
    if not printed:
        return loss / horizon
    for h in range(horizon):
        z[h] = 2 * total
    return float((total * total).sum())


@njit(cache=True)
def _block(layers, transposed, step, starts, currents, targets, printed, gradient):
    """Loss of a block of windows; adds its gradient to `gradient` (Layers). `transposed`: W1, W2, W3 the other way."""
    count, horizon, kind = len(starts), currents.shape[1], starts.dtype
    h1, h2 = layers.b1.shape[0], layers.b2.shape[0]
    x, z = np.empty((horizon, count, INPUTS), kind), np.empty((horizon, count, STATES), kind)
    a1, a2 = np.empty((horizon, count, h1), kind), np.empty((horizon, count, h2), kind)
    now, y = starts.copy(), np.empty((count, STATES), kind)
    for h in range(horizon):
        _advance_block(layers, step, now, currents[:, h], x[h], a1[h], a2[h], y)
        z[h] = now
    loss = _errors(z, targets, printed)
    gz, g1, g2 = np.zeros((count, STATES), kind), np.empty((count, h1), kind), np.empty((count, h2), kind)
    gx, gw1 = np.empty((count, INPUTS), kind), np.empty((INPUTS, h1), kind)
    gw2, gw3 = np.empty((h1, h2), kind), np.empty((h2, STATES), kind)
    for h in range(horizon - 1, -1, -1):
        for k in range(count):
            for i in range(STATES):
                gz[k, i] += z[h, k, i]
                y[k, i] = step[i] * gz[k, i]
        _layer_back(a2[h], y, transposed[2], gw3, gradient.w3, gradient.b3, g2)
        _mask(g2, a2[h])
        _layer_back(a1[h], g2, transposed[1], gw2, gradient.w2, gradient.b2, g1)
        _mask(g1, a1[h])
        _layer_back(x[h], g1, transposed[0], gw1, gradient.w1, gradient.b1, gx)
        for k in range(count):
            for i in range(STATES):
                gz[k, i] += gx[k, i]
    return loss


@njit(cache=True)
def _layer_back(a, gy, w_transposed, scratch, gw, gb, ga):
    """Gradients of y = a W + b: adds those by W, b; sets ga."""
    np.dot(a.T, gy, scratch)
    gw += scratch
    for k in range(gy.shape[0]):
        for j in range(gy.shape[1]):
            gb[j] += gy[k, j]
    np.dot(gy, w_transposed, ga)


@njit(cache=True)
def _mask(g, a):
    for k in range(g.shape[0]):
        for j in range(g.shape[1]):
            g[k, j] = g[k, j] if a[k, j] > 0 else g.dtype.type(0.0)


@njit(cache=True, parallel=True)
def loss_and_gradient(layers, step, starts, currents, targets, printed, threads):
    """Loss of a batch and its gradient by the flat weights; float32 or float64, as the arrays are.

    Shapes: starts (n, 8), scaled currents (n, H), targets (n, H, 8). The batch is cut into blocks that fit the cache.
    """
    n = len(currents)
    h1, h2, kind = layers.b1.shape[0], layers.b2.shape[0], layers.b1.dtype
    transposed = (layers.w1.T.copy(), layers.w2.T.copy(), layers.w3.T.copy())
    losses, blocks = np.zeros(threads), -(-n // BLOCK)
    w1, b1 = np.zeros((threads, INPUTS, h1), kind), np.zeros((threads, h1), kind)
    w2, b2 = np.zeros((threads, h1, h2), kind), np.zeros((threads, h2), kind)
    w3, b3 = np.zeros((threads, h2, STATES), kind), np.zeros((threads, STATES), kind)
    for t in prange(threads):
        gradient = mlp.Layers(w1[t], b1[t], w2[t], b2[t], w3[t], b3[t])
        for block in range(t * blocks // threads, (t + 1) * blocks // threads):
            begin, end = block * BLOCK, min((block + 1) * BLOCK, n)
            part = starts[begin:end], currents[begin:end], targets[begin:end]
            losses[t] += _block(layers, transposed, step, part[0], part[1], part[2], printed, gradient)
    share = kind.type(1.0 / (n * STATES))
    parts = (w1.sum(0).ravel(), b1.sum(0), w2.sum(0).ravel(), b2.sum(0), w3.sum(0).ravel(), b3.sum(0))
    return losses.sum() / (n * STATES), np.concatenate(parts) * share
