# SPDX-License-Identifier: Apache-2.0
"""Forward and backward passes of a perceptron over a block of windows or transitions, for training.

Layers are padded with zeros to multiples of four (`padded`). Buffers and `at` are as in `dense`; all buffers of a call
are read and written at the same `at`.
"""

from __future__ import annotations

import numpy as np

from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.neural import dense
from hydro_sim.neural.dense import LOOSE, Layers, four


@njit
def padded(layers):
    """A copy of `layers` whose sizes are multiples of four."""
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


@njit
def zeros(layers):
    """Zeros in the shapes of `layers`."""
    return Layers(
        np.zeros_like(layers.w1), np.zeros_like(layers.b1), np.zeros_like(layers.w2),
        np.zeros_like(layers.b2), np.zeros_like(layers.w3), np.zeros_like(layers.b3),
    )  # fmt: skip


@njit(fastmath=LOOSE)
def forward(layers, x, a1, a2, y, at):
    """y of x; the activations go to a1, a2."""
    dense.fill(a1, at, layers.b1)
    dense.product(layers.w1, x, at, a1, at)
    dense.relu(a1, at, len(layers.b1))
    dense.fill(a2, at, layers.b2)
    dense.product(layers.w2, a1, at, a2, at)
    dense.relu(a2, at, len(layers.b2))
    dense.fill(y, at, layers.b3)
    dense.product(layers.w3, a2, at, y, at)


@njit(fastmath=LOOSE)
def backward(w3_transposed, w2_transposed, gy, a1, a2, g1, g2, at):
    """Gradients g2, g1 with respect to the pre-activations of both hidden layers, from gy, that of the output."""
    dense.clear(g2, at, w3_transposed.shape[1])
    dense.product(w3_transposed, gy, at, g2, at)
    dense.mask(g2, a2, at, w3_transposed.shape[1])
    dense.clear(g1, at, w2_transposed.shape[1])
    dense.product(w2_transposed, g2, at, g1, at)
    dense.mask(g1, a1, at, w2_transposed.shape[1])


@njit
def add_gradient(x, a1, a2, g1, g2, gy, count, gradient):
    """Add the weight gradients, summed over the first `count` numbers of each row, to `gradient` (padded)."""
    dense.outer(a2, gy, gradient.w3, gradient.b3, count)
    dense.outer(a1, g2, gradient.w2, gradient.b2, count)
    dense.outer(x, g1, gradient.w1, gradient.b1, count)
