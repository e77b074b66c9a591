# SPDX-License-Identifier: Apache-2.0
"""Compiled forward and backward passes of perceptrons with two hidden ReLU layers over batches, and Adam.

::

    a1 = relu(x W1 + b1)    a2 = relu(a1 W2 + b2)    y = a2 W3 + b3

    a buffer   row of one neuron | transitions 0 .. 127 | 128 .. 255 | ...   flat, see `dense`
    networks   `Layers` of any size, padded with zeros to multiples of four here, and transposed for the backward pass
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_policy.sac import dense
from hydro_policy.sac.dense import LOOSE, four
from hydro_sim.jit import copy_matrix, copy_vector, njit

ROW = dense.ROW
"""Stride between rows of a buffer."""

BATCH_MAX = dense.BLOCK * dense.CHUNK
"""Number of transitions in one buffer."""

Floats = npt.NDArray[Any]

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam."""

_BLOCK = np.uint64(dense.BLOCK)


class Layers(NamedTuple):
    """Views of a flat vector of weights."""

    w1: npt.NDArray[np.floating]
    b1: npt.NDArray[np.floating]
    w2: npt.NDArray[np.floating]
    b2: npt.NDArray[np.floating]
    w3: npt.NDArray[np.floating]
    b3: npt.NDArray[np.floating]


class Adam(NamedTuple):
    """One optimizer: flat vectors of one type, shape (n,), changed in place."""

    parameters: npt.NDArray[Any]
    gradient: npt.NDArray[Any]
    first_moment: npt.NDArray[Any]
    second_moment: npt.NDArray[Any]
    learning_rate: float
    steps: int
    """Steps done before this call."""


class PassBuffers(NamedTuple):
    """Activations and gradients of one network: its forward and its backward pass."""

    a1: Floats
    a2: Floats
    y: Floats
    g: Floats
    g1: Floats
    g2: Floats


@njit
def padded(layers):
    """A copy of `layers` whose sizes are multiples of four."""
    n, h1 = layers.w1.shape
    h2, m = layers.w3.shape
    kind = layers.w1.dtype
    w1, b1 = np.zeros((four(n), four(h1)), kind), np.zeros(four(h1), kind)
    w2, b2 = np.zeros((four(h1), four(h2)), kind), np.zeros(four(h2), kind)
    w3, b3 = np.zeros((four(h2), four(m)), kind), np.zeros(four(m), kind)
    copy_matrix(w1, layers.w1)
    copy_matrix(w2, layers.w2)
    copy_matrix(w3, layers.w3)
    copy_vector(b1, layers.b1)
    copy_vector(b2, layers.b2)
    copy_vector(b3, layers.b3)
    return Layers(w1, b1, w2, b2, w3, b3)


@njit(fastmath=LOOSE)
def forward(layers, x, buffers, count):
    """Evaluate a padded network on `count` transitions; the outputs go to `buffers.y`."""
    a1, a2, y = buffers.a1, buffers.a2, buffers.y
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.fill(a1, at, layers.b1)
        dense.product(layers.w1, x, at, a1, at)
        dense.relu(a1, at, len(layers.b1))
        dense.fill(a2, at, layers.b2)
        dense.product(layers.w2, a1, at, a2, at)
        dense.relu(a2, at, len(layers.b2))
        dense.fill(y, at, layers.b3)
        dense.product(layers.w3, a2, at, y, at)


@njit(fastmath=LOOSE)
def backpropagate(layers, buffers, count):
    """Backpropagate `buffers.g`, the outputs' gradient, to both hidden layers' pre-activations: `buffers.g2`, `g1`."""
    w3, w2, g1, g2 = layers.w3.T.copy(), layers.w2.T.copy(), buffers.g1, buffers.g2
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.clear(g2, at, w3.shape[1])
        dense.product(w3, buffers.g, at, g2, at)
        dense.mask(g2, buffers.a2, at, w3.shape[1])
        dense.clear(g1, at, w2.shape[1])
        dense.product(w2, g2, at, g1, at)
        dense.mask(g1, buffers.a1, at, w2.shape[1])


@njit
def backward(layers, x, buffers, count, gradient):
    """Write the weights' gradients into `gradient` (not padded), from those of the outputs, `buffers.g`."""
    backpropagate(layers, buffers, count)
    sums = Layers(
        np.zeros_like(layers.w1), np.zeros_like(layers.b1), np.zeros_like(layers.w2),
        np.zeros_like(layers.b2), np.zeros_like(layers.w3), np.zeros_like(layers.b3),
    )  # fmt: skip
    dense.outer(buffers.a2, buffers.g, sums.w3, sums.b3, count)
    dense.outer(buffers.a1, buffers.g2, sums.w2, sums.b2, count)
    dense.outer(x, buffers.g1, sums.w1, sums.b1, count)
    n, h1 = gradient.w1.shape
    h2, m = gradient.w3.shape
    copy_matrix(gradient.w1, sums.w1[:n, :h1])
    copy_matrix(gradient.w2, sums.w2[:h1, :h2])
    copy_matrix(gradient.w3, sums.w3[:h2, :m])
    copy_vector(gradient.b1, sums.b1[:h1])
    copy_vector(gradient.b2, sums.b2[:h2])
    copy_vector(gradient.b3, sums.b3[:m])


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
        copy_vector(result[:, j], w1[first + j])
    return result


@njit(fastmath=LOOSE)
def soft_update(targets, parameters, rate):
    """Apply Polyak averaging: targets += rate (parameters - targets)."""
    share = targets.dtype.type(rate)
    for i in range(len(targets)):
        targets[i] += share * (parameters[i] - targets[i])


@njit(fastmath=LOOSE)
def adam_step(adam, count):
    """Update the parameters by `adam.gradient`, as torch.optim.Adam does; this is step `adam.steps + count`.

    Kingma and Ba (2015), algorithm 1, with the bias corrections in the rate and in the root.
    """
    kind = adam.parameters.dtype.type
    number = adam.steps + count
    rate = kind(adam.learning_rate / (1.0 - BETA_1**number))
    root = kind(1.0 / math.sqrt(1.0 - BETA_2**number))
    old_1, new_1, old_2, new_2 = kind(BETA_1), kind(1.0 - BETA_1), kind(BETA_2), kind(1.0 - BETA_2)
    epsilon = kind(EPSILON)
    for i in range(len(adam.parameters)):
        g = adam.gradient[i]
        adam.first_moment[i] = old_1 * adam.first_moment[i] + new_1 * g
        adam.second_moment[i] = old_2 * adam.second_moment[i] + new_2 * g * g
        adam.parameters[i] -= rate * adam.first_moment[i] / (math.sqrt(adam.second_moment[i]) * root + epsilon)


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
