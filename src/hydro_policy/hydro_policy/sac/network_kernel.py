# SPDX-License-Identifier: Apache-2.0
"""Small perceptrons on buffers: forward, backward, Adam, compiled; transitions lie along the vector registers.

::

    a buffer   row of one neuron | transitions 0 .. 127 | 128 .. 255 | ...   flat, see `hydro_sim.neural.dense`
    networks   `Layers` of any size, here padded with zeros to multiples of four, and transposed for the way back
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from hydro_sim import copies
from hydro_sim.neural import dense
from hydro_sim.neural.mlp import LOOSE, Layers

ROW = dense.ROW
"""Numbers from one row of a buffer to the next."""

BATCH_MAX = dense.BLOCK * dense.CHUNK
"""Transitions that one buffer holds."""

Floats = npt.NDArray[Any]

_BLOCK = np.uint64(dense.BLOCK)
_BETA_1, _BETA_2, _EPSILON = 0.9, 0.999, 1e-8


class Adam(NamedTuple):
    """One optimizer: flat vectors, changed in place."""

    parameters: Floats
    gradient: Floats
    first_moment: Floats
    second_moment: Floats
    learning_rate: float
    steps: int


class Pass(NamedTuple):
    """Buffers of one network's way forward and back."""

    a1: Floats
    a2: Floats
    y: Floats
    g: Floats
    g1: Floats
    g2: Floats


@njit(cache=True)
def forward(layers, x, way, count):
    """Outputs of a padded network into way.y."""
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.fill(way.a1, at, layers.b1)
        dense.product(layers.w1, x, at, way.a1, at)
        dense.relu(way.a1, at, len(layers.b1))
        dense.fill(way.a2, at, layers.b2)
        dense.product(layers.w2, way.a1, at, way.a2, at)
        dense.relu(way.a2, at, len(layers.b2))
        dense.fill(way.y, at, layers.b3)
        dense.product(layers.w3, way.a2, at, way.y, at)


@njit(cache=True)
def to_inputs(layers, way, count):
    """From way.g, the gradient by the outputs, to those by both layers' sums, way.g2 and way.g1."""
    w3, w2 = layers.w3.T.copy(), layers.w2.T.copy()
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.clear(way.g2, at, len(layers.b2))
        dense.product(w3, way.g, at, way.g2, at)
        dense.mask(way.g2, way.a2, at, len(layers.b2))
        dense.clear(way.g1, at, len(layers.b1))
        dense.product(w2, way.g2, at, way.g1, at)
        dense.mask(way.g1, way.a1, at, len(layers.b1))


@njit(cache=True)
def backward(layers, x, way, count, gradient):
    """Gradients of a padded network by its weights, given way.g, into `gradient` (not padded)."""
    to_inputs(layers, way, count)
    sums = dense.zeros(layers)
    dense.outer(way.a2, way.g, sums.w3, sums.b3, count)
    dense.outer(way.a1, way.g2, sums.w2, sums.b2, count)
    dense.outer(x, way.g1, sums.w1, sums.b1, count)
    n, h1 = gradient.w1.shape
    h2, m = gradient.w3.shape
    copies.matrix(gradient.w1, sums.w1[:n, :h1])
    copies.matrix(gradient.w2, sums.w2[:h1, :h2])
    copies.matrix(gradient.w3, sums.w3[:h2, :m])
    copies.vector(gradient.b1, sums.b1[:h1])
    copies.vector(gradient.b2, sums.b2[:h2])
    copies.vector(gradient.b3, sums.b3[:m])


@njit(cache=True)
def product(w, x, y, count):
    """Add w^T x to y, whole buffers; w of shape (rows of x, rows of y)."""
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.product(w, x, at, y, at)


@njit(cache=True)
def input_rows(w1, first, count):
    """Transpose of the first layer's rows of some inputs, padded: shape (h1, count)."""
    result = np.zeros((four(w1.shape[1]), four(count)), w1.dtype)
    for j in range(count):
        copies.vector(result[:, j], w1[first + j])
    return result


@njit(cache=True)
def padded(layers):
    """A copy whose sizes are multiples of four."""
    n, h1 = layers.w1.shape
    h2, m = layers.w3.shape
    kind = layers.w1.dtype
    w1, b1 = np.zeros((four(n), four(h1)), kind), np.zeros(four(h1), kind)
    w2, b2 = np.zeros((four(h1), four(h2)), kind), np.zeros(four(h2), kind)
    w3, b3 = np.zeros((four(h2), four(m)), kind), np.zeros(four(m), kind)
    copies.matrix(w1, layers.w1)
    copies.matrix(w2, layers.w2)
    copies.matrix(w3, layers.w3)
    copies.vector(b1, layers.b1)
    copies.vector(b2, layers.b2)
    copies.vector(b3, layers.b3)
    return Layers(w1, b1, w2, b2, w3, b3)


@njit(cache=True, fastmath=LOOSE)
def adam_step(adam, step):
    """torch.optim.Adam's step, `step` of this call."""
    kind = adam.parameters.dtype.type
    number = adam.steps + step
    rate = kind(adam.learning_rate / (1.0 - _BETA_1**number))
    root = kind(1.0 / math.sqrt(1.0 - _BETA_2**number))
    old_1, new_1, old_2, new_2 = kind(_BETA_1), kind(1.0 - _BETA_1), kind(_BETA_2), kind(1.0 - _BETA_2)
    epsilon = kind(_EPSILON)
    for i in range(len(adam.parameters)):
        g = adam.gradient[i]
        adam.first_moment[i] = old_1 * adam.first_moment[i] + new_1 * g
        adam.second_moment[i] = old_2 * adam.second_moment[i] + new_2 * g * g
        adam.parameters[i] -= rate * adam.first_moment[i] / (math.sqrt(adam.second_moment[i]) * root + epsilon)


@njit(cache=True, fastmath=LOOSE)
def follow(targets, parameters, rate):
    """Move `targets` towards `parameters` by this share of the way."""
    share = targets.dtype.type(rate)
    for i in range(len(targets)):
        targets[i] += share * (parameters[i] - targets[i])


@njit(cache=True)
def four(count):
    """`count` rounded up to a multiple of four."""
    return (count + 3) // 4 * 4


@njit(cache=True)
def _blocks(count):
    return (count + dense.BLOCK - 1) // dense.BLOCK


@njit(cache=True)
def buffer(rows, kind):
    """A new one of so many rows, zero."""
    return np.zeros(rows * dense.ROW, kind)


@njit(cache=True)
def new_pass(layers, kind):
    """Buffers for one network's ways."""
    h1, h2, m = four(layers.w1.shape[1]), four(layers.w3.shape[0]), four(layers.w3.shape[1])
    return Pass(
        buffer(h1, kind), buffer(h2, kind), buffer(m, kind), buffer(m, kind), buffer(h1, kind), buffer(h2, kind)
    )
