# SPDX-License-Identifier: Apache-2.0
"""Dense layers on a batch of transitions, which lie along the vector registers: products and their gradients.

::

    one row, one neuron   | transitions 0 .. BLOCK-1 | the next block | .. CHUNK blocks | GAP |

    y += w^T x            a block at a time               4 x 4 weights in registers, transitions stream
    gw += x g^T           all blocks in one sum           4 x 4 sums in registers, transitions stream

A buffer is flat, `rows * ROW` numbers, and `at` is where a block begins in its rows. Layers have a multiple of four
rows; weights and activations of the rows that fill them up are zero. With 32 neurons `product` is about one and a half
times and `outer` three times as fast as BLAS, which copies its operands before it multiplies.
"""

from __future__ import annotations

import numpy as np

from hydro_sim.jit import njit

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

# Unsigned throughout: a signed index may be negative, which numba checks for, and which keeps a loop from vectorizing.
_U = np.uint64
_0, _1, _2, _3, _4 = _U(0), _U(1), _U(2), _U(3), _U(4)
_BLOCK, _ROW, _ROW2, _ROW3 = _U(BLOCK), _U(ROW), _U(2 * ROW), _U(3 * ROW)


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
