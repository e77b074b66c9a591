# SPDX-License-Identifier: Apache-2.0
"""Compiled forward and backward passes of small perceptrons over batches, vectorised along the transitions.

::

    a buffer   row of one neuron | transitions 0 .. 127 | 128 .. 255 | ...   flat, see `hydro_sim.neural.dense`
    networks   `Layers` of any size, padded with zeros to multiples of four here, and transposed for the backward pass
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.neural import block_mlp, dense
from hydro_sim.neural.dense import LOOSE, four

ROW = dense.ROW
"""Stride between rows of a buffer."""

BATCH_MAX = dense.BLOCK * dense.CHUNK
"""Number of transitions in one buffer."""

Floats = npt.NDArray[Any]

_BLOCK = np.uint64(dense.BLOCK)


class PassBuffers(NamedTuple):
    """Activations and gradients of one network: its forward and its backward pass."""

    a1: Floats
    a2: Floats
    y: Floats
    g: Floats
    g1: Floats
    g2: Floats


@njit
def forward(layers, x, buffers, count):
    """Evaluate a padded network on `count` transitions; the outputs go to `buffers.y`."""
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        block_mlp.forward(layers, x, buffers.a1, buffers.a2, buffers.y, at)


@njit
def backpropagate(layers, buffers, count):
    """Backpropagate `buffers.g`, the outputs' gradient, to both hidden layers' pre-activations: `buffers.g2`, `g1`."""
    w3, w2 = layers.w3.T.copy(), layers.w2.T.copy()
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        block_mlp.backward(w3, w2, buffers.g, buffers.a1, buffers.a2, buffers.g1, buffers.g2, at)


@njit
def backward(layers, x, buffers, count, gradient):
    """Write the weights' gradients into `gradient` (not padded), from those of the outputs, `buffers.g`."""
    backpropagate(layers, buffers, count)
    sums = block_mlp.zeros(layers)
    block_mlp.add_gradient(x, buffers.a1, buffers.a2, buffers.g1, buffers.g2, buffers.g, count, sums)
    n, h1 = gradient.w1.shape
    h2, m = gradient.w3.shape
    copies.matrix(gradient.w1, sums.w1[:n, :h1])
    copies.matrix(gradient.w2, sums.w2[:h1, :h2])
    copies.matrix(gradient.w3, sums.w3[:h2, :m])
    copies.vector(gradient.b1, sums.b1[:h1])
    copies.vector(gradient.b2, sums.b2[:h2])
    copies.vector(gradient.b3, sums.b3[:m])


@njit
def product(w, x, y, count):
    """Add w^T x to y, for whole buffers; w of shape (rows of x, rows of y)."""
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.product(w, x, at, y, at)


@njit
def input_rows(w1, first, count):
    """Return the transposed and padded rows of the first layer for some inputs, shape (h1, count)."""
    result = np.zeros((four(w1.shape[1]), four(count)), w1.dtype)
    for j in range(count):
        copies.vector(result[:, j], w1[first + j])
    return result


@njit(fastmath=LOOSE)
def soft_update(targets, parameters, rate):
    """Apply Polyak averaging: targets += rate (parameters - targets)."""
    share = targets.dtype.type(rate)
    for i in range(len(targets)):
        targets[i] += share * (parameters[i] - targets[i])


@njit
def _blocks(count):
    return (count + dense.BLOCK - 1) // dense.BLOCK


@njit
def buffer(rows, kind):
    """Allocate a buffer of this many rows, all zero."""
    return np.zeros(rows * dense.ROW, kind)


@njit
def pass_buffers(layers, kind):
    """Allocate the buffers of one network."""
    h1, h2, m = four(layers.w1.shape[1]), four(layers.w3.shape[0]), four(layers.w3.shape[1])
    return PassBuffers(
        buffer(h1, kind), buffer(h2, kind), buffer(m, kind), buffer(m, kind), buffer(h1, kind), buffer(h2, kind)
    )
