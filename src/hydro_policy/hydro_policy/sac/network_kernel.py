# SPDX-License-Identifier: Apache-2.0
"""Compiled forward and backward passes of perceptrons with two hidden ReLU layers over batches, and Adam.

::

    a1 = relu(x W1 + b1)    a2 = relu(a1 W2 + b2)    y = a2 W3 + b3

    networks   `Layers` of any size, padded with zeros to multiples of four here, and transposed for the backward pass

Transitions lie along the vector registers, in dense layers::

    one row, one neuron   | transitions 0 .. BLOCK-1 | the next block | .. CHUNK blocks | GAP |

    y += w^T x            a block at a time               4 x 4 weights in registers, transitions stream
    gw += x g^T           all blocks in one sum           4 x 4 sums in registers, transitions stream

A buffer is flat, `rows * ROW` numbers, and `at` is where a block begins in its rows. Layers have a multiple of four
rows; weights and activations of the rows that fill them up are zero. With 32 neurons `product` is about one and a half
times and `outer` three times as fast as BLAS, which copies its operands before it multiplies.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_sim.jit import copy_matrix, copy_vector, njit

LOOSE = {"reassoc", "contract"}
"""Sums may be reordered and fused, which vectorizes them; NaN and infinity keep their meaning."""
BLOCK = 128
"""Transitions that are processed together: eight vectors of float32, and a layer fits the first-level cache."""
CHUNK = 4
"""Blocks whose weight gradients are summed at once: a chunk of two layers fits the second-level cache."""
GAP = 16
"""Numbers between rows, one cache line: rows a power of two apart would share the same few places of the cache."""
ROW = BLOCK * CHUNK + GAP
"""Numbers from one row of a buffer to the next."""

BATCH_MAX = BLOCK * CHUNK
"""Number of transitions in one buffer."""

Floats = npt.NDArray[Any]

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam."""

# Unsigned throughout: a signed index may be negative, which numba checks for, and which keeps a loop from vectorizing.
_U = np.uint64
_0, _1, _2, _3, _4 = _U(0), _U(1), _U(2), _U(3), _U(4)
_BLOCK, _ROW, _ROW2, _ROW3 = _U(BLOCK), _U(ROW), _U(2 * ROW), _U(3 * ROW)


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
def four(count):
    """`count` rounded up to a multiple of four."""
    return (count + 3) // 4 * 4


@njit
def row(buffer, j, at):
    """Row j of a block of a buffer, a view of shape (BLOCK,)."""
    begin = _U(j) * _ROW + at
    return buffer[begin : begin + _BLOCK]


@njit
def clear(y, at, rows):
    """y = 0."""
    for j in range(rows):
        row(y, j, at)[:] = y.dtype.type(0.0)


@njit(fastmath=LOOSE)
def fill(y, at, b):
    """y = b for every transition."""
    for j in range(_U(b.shape[0])):
        begin, value = at + j * _ROW, b[j]
        for k in range(_BLOCK):
            y[begin + k] = value


@njit(fastmath=LOOSE)
def relu(y, at, rows):
    """y = max(y, 0); NaN stays."""
    zero = y.dtype.type(0.0)
    for j in range(_U(rows)):
        begin = at + j * _ROW
        for k in range(_BLOCK):
            y[begin + k] = zero if y[begin + k] < zero else y[begin + k]


@njit(fastmath=LOOSE)
def mask(g, a, at, rows):
    """g = 0 where the activation `a` is."""
    zero = g.dtype.type(0.0)
    for j in range(_U(rows)):
        begin = at + j * _ROW
        for k in range(_BLOCK):
            g[begin + k] = g[begin + k] if a[begin + k] > zero else zero


@njit(fastmath=LOOSE)
def product(w, x, x_at, y, y_at):
    """y += w^T x, for w of shape (n, m), n and m multiples of four; adds for n rows of x and m of y."""
    n, m = _U(w.shape[0]), _U(w.shape[1])
    for i in range(_0, n, _4):
        p = x_at + i * _ROW
        for j in range(_0, m, _4):
            q = y_at + j * _ROW
            w00, w01, w02, w03 = w[i, j], w[i, j + _1], w[i, j + _2], w[i, j + _3]
            w10, w11, w12, w13 = w[i + _1, j], w[i + _1, j + _1], w[i + _1, j + _2], w[i + _1, j + _3]
            w20, w21, w22, w23 = w[i + _2, j], w[i + _2, j + _1], w[i + _2, j + _2], w[i + _2, j + _3]
            w30, w31, w32, w33 = w[i + _3, j], w[i + _3, j + _1], w[i + _3, j + _2], w[i + _3, j + _3]
            for k in range(_BLOCK):
                x0, x1, x2, x3 = x[p + k], x[p + _ROW + k], x[p + _ROW2 + k], x[p + _ROW3 + k]
                y0 = y[q + k] + w00 * x0 + w10 * x1 + w20 * x2 + w30 * x3
                y1 = y[q + _ROW + k] + w01 * x0 + w11 * x1 + w21 * x2 + w31 * x3
                y2 = y[q + _ROW2 + k] + w02 * x0 + w12 * x1 + w22 * x2 + w32 * x3
                y3 = y[q + _ROW3 + k] + w03 * x0 + w13 * x1 + w23 * x2 + w33 * x3
                y[q + k], y[q + _ROW + k], y[q + _ROW2 + k], y[q + _ROW3 + k] = y0, y1, y2, y3


@njit(fastmath=LOOSE)
def outer(x, g, gw, gb, count):
    """gw += x g^T, gb += g 1 over the first `count` numbers of each row; gw of shape (n, m), multiples of four."""
    n, m, zero = _U(gw.shape[0]), _U(gw.shape[1]), gw.dtype.type(0.0)
    for i in range(_0, n, _4):
        p = i * _ROW
        for j in range(_0, m, _4):
            q = j * _ROW
            s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = zero
            s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = zero
            for k in range(_U(count)):
                x0, x1, x2, x3 = x[p + k], x[p + _ROW + k], x[p + _ROW2 + k], x[p + _ROW3 + k]
                g0, g1, g2, g3 = g[q + k], g[q + _ROW + k], g[q + _ROW2 + k], g[q + _ROW3 + k]
                s00, s01, s02, s03 = s00 + x0 * g0, s01 + x0 * g1, s02 + x0 * g2, s03 + x0 * g3
                s10, s11, s12, s13 = s10 + x1 * g0, s11 + x1 * g1, s12 + x1 * g2, s13 + x1 * g3
                s20, s21, s22, s23 = s20 + x2 * g0, s21 + x2 * g1, s22 + x2 * g2, s23 + x2 * g3
                s30, s31, s32, s33 = s30 + x3 * g0, s31 + x3 * g1, s32 + x3 * g2, s33 + x3 * g3
            for r, sums in enumerate(
                ((s00, s01, s02, s03), (s10, s11, s12, s13), (s20, s21, s22, s23), (s30, s31, s32, s33))
            ):
                for c in range(4):
                    gw[i + _U(r), j + _U(c)] += sums[c]
    for j in range(m):
        total = zero
        for k in range(_U(count)):
            total += g[j * _ROW + k]
        gb[j] += total


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
        fill(a1, at, layers.b1)
        product(layers.w1, x, at, a1, at)
        relu(a1, at, len(layers.b1))
        fill(a2, at, layers.b2)
        product(layers.w2, a1, at, a2, at)
        relu(a2, at, len(layers.b2))
        fill(y, at, layers.b3)
        product(layers.w3, a2, at, y, at)


@njit(fastmath=LOOSE)
def backpropagate(layers, buffers, count):
    """Backpropagate `buffers.g`, the outputs' gradient, to both hidden layers' pre-activations: `buffers.g2`, `g1`."""
    w3, w2, g1, g2 = layers.w3.T.copy(), layers.w2.T.copy(), buffers.g1, buffers.g2
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        clear(g2, at, w3.shape[1])
        product(w3, buffers.g, at, g2, at)
        mask(g2, buffers.a2, at, w3.shape[1])
        clear(g1, at, w2.shape[1])
        product(w2, g2, at, g1, at)
        mask(g1, buffers.a1, at, w2.shape[1])


@njit
def backward(layers, x, buffers, count, gradient):
    """Write the weights' gradients into `gradient` (not padded), from those of the outputs, `buffers.g`."""
    backpropagate(layers, buffers, count)
    sums = Layers(
        np.zeros_like(layers.w1), np.zeros_like(layers.b1), np.zeros_like(layers.w2),
        np.zeros_like(layers.b2), np.zeros_like(layers.w3), np.zeros_like(layers.b3),
    )  # fmt: skip
    outer(buffers.a2, buffers.g, sums.w3, sums.b3, count)
    outer(buffers.a1, buffers.g2, sums.w2, sums.b2, count)
    outer(x, buffers.g1, sums.w1, sums.b1, count)
    n, h1 = gradient.w1.shape
    h2, m = gradient.w3.shape
    copy_matrix(gradient.w1, sums.w1[:n, :h1])
    copy_matrix(gradient.w2, sums.w2[:h1, :h2])
    copy_matrix(gradient.w3, sums.w3[:h2, :m])
    copy_vector(gradient.b1, sums.b1[:h1])
    copy_vector(gradient.b2, sums.b2[:h2])
    copy_vector(gradient.b3, sums.b3[:m])


@njit
def whole_product(w, x, y, count):
    """Add w^T x to y, for whole buffers; w of shape (rows of x, rows of y)."""
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        product(w, x, at, y, at)


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
    return (count + BLOCK - 1) // BLOCK


@njit
def buffer(rows, kind):
    """Allocate a buffer of this many rows, all zero."""
    return np.zeros(rows * ROW, kind)


@njit
def pass_buffers(layers, kind):
    """Allocate the buffers of one network."""
    h1, h2, m = four(layers.w1.shape[1]), four(layers.w3.shape[0]), four(layers.w3.shape[1])
    return PassBuffers(
        buffer(h1, kind), buffer(h2, kind), buffer(m, kind), buffer(m, kind), buffer(h1, kind), buffer(h2, kind)
    )
