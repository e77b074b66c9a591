# SPDX-License-Identifier: Apache-2.0
"""Dense layers over a batch, compiled: the products of Soft Actor-Critic's networks, at vector speed.

Transitions lie along the vector registers. A batch of activations is one flat array, `rows * ROW` numbers::

    one row, one neuron    | transitions 0 .. BLOCK-1 | the next block | .. BLOCKS blocks | GAP |

    affine    y = w^T x + b                4 x 4 weights in registers, transitions stream, a block at a time
    outer     gw = x g^T, gb = g 1         4 x 4 sums in registers, transitions stream, the whole batch

`w` has a multiple of four rows and columns. With 32 neurons `affine` is about one and a half times and `outer` three
times as fast as BLAS, which copies its operands before it multiplies.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_sim.jit import njit

Floats = npt.NDArray[Any]

BLOCK_SIZE = 128
"""Transitions that are processed together: eight vectors of float32, and a layer fits the first-level cache."""
BLOCK_COUNT = 4
ROW_GAP = 16
"""Numbers between rows, one cache line: rows a power of two apart would share the same few places of the cache."""
STRIDE = BLOCK_SIZE * BLOCK_COUNT + ROW_GAP  # numbers from one row to the next
BATCH_MAX = BLOCK_SIZE * BLOCK_COUNT  # largest batch

FASTMATH_FLAGS = {"reassoc", "contract"}
"""Sums may be reordered and fused, which vectorizes them; NaN and infinity keep their meaning."""

# Unsigned throughout: a signed index may be negative, which numba checks for, and which keeps a loop from vectorizing.
_U = np.uint64
_0, _1, _2, _3, _4 = _U(0), _U(1), _U(2), _U(3), _U(4)
_BLOCK, _ROW, _ROW2, _ROW3 = _U(BLOCK_SIZE), _U(STRIDE), _U(2 * STRIDE), _U(3 * STRIDE)


@njit(fastmath=FASTMATH_FLAGS)
def affine(w, b, x, y, at):
    """Affine layer y = w^T x + b, for the block that starts at `at`; w of shape (rows of x, rows of y)."""
    n, m, at = _U(w.shape[0]), _U(w.shape[1]), _U(at)
    for j in range(m):
        for k in range(_BLOCK):
            y[at + j * _ROW + k] = b[j]
    for i in range(_0, n, _4):
        p = at + i * _ROW
        for j in range(_0, m, _4):
            q = at + j * _ROW
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


@njit(fastmath=FASTMATH_FLAGS)
def outer(x, g, gw, gb, batch):
    """Gradients of an affine layer: gw = x g^T and gb = g 1, sums over the first `batch` transitions."""
    n, m, zero = _U(gw.shape[0]), _U(gw.shape[1]), gw.dtype.type(0.0)
    for i in range(_0, n, _4):
        p = i * _ROW
        for j in range(_0, m, _4):
            q = j * _ROW
            s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = zero
            s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = zero
            for k in range(_U(batch)):
                x0, x1, x2, x3 = x[p + k], x[p + _ROW + k], x[p + _ROW2 + k], x[p + _ROW3 + k]
                g0, g1, g2, g3 = g[q + k], g[q + _ROW + k], g[q + _ROW2 + k], g[q + _ROW3 + k]
                s00, s01, s02, s03 = s00 + x0 * g0, s01 + x0 * g1, s02 + x0 * g2, s03 + x0 * g3
                s10, s11, s12, s13 = s10 + x1 * g0, s11 + x1 * g1, s12 + x1 * g2, s13 + x1 * g3
                s20, s21, s22, s23 = s20 + x2 * g0, s21 + x2 * g1, s22 + x2 * g2, s23 + x2 * g3
                s30, s31, s32, s33 = s30 + x3 * g0, s31 + x3 * g1, s32 + x3 * g2, s33 + x3 * g3
            sums = ((s00, s01, s02, s03), (s10, s11, s12, s13), (s20, s21, s22, s23), (s30, s31, s32, s33))
            for r in range(4):
                for c in range(4):
                    gw[i + _U(r), j + _U(c)] = sums[r][c]
    for j in range(m):
        total = zero
        for k in range(_U(batch)):
            total += g[j * _ROW + k]
        gb[j] = total


@njit(fastmath=FASTMATH_FLAGS)
def relu(y, rows, at):
    """ReLU in place: y = max(y, 0), for the block that starts at `at`."""
    zero = y.dtype.type(0.0)
    for j in range(_U(rows)):
        begin = _U(at) + j * _ROW
        for k in range(_BLOCK):
            y[begin + k] = zero if y[begin + k] < zero else y[begin + k]


@njit(fastmath=FASTMATH_FLAGS)
def relu_gradient(g, y, rows, at):
    """Gradient of ReLU in place: g = 0 where the activation y is 0, for the block that starts at `at`."""
    zero = g.dtype.type(0.0)
    for j in range(_U(rows)):
        begin = _U(at) + j * _ROW
        for k in range(_BLOCK):
            g[begin + k] = g[begin + k] if y[begin + k] > zero else zero
