# SPDX-License-Identifier: Apache-2.0
"""Forward derivatives of the networks of `hydro_sim.learned`: dy/dx, and that of what a network adds to the physics.

Where a ReLU bends the derivative is that of the side the model is on.
"""

from __future__ import annotations

import numpy as np

from hydro_sim.jit import njit
from hydro_sim.neural import mlp
from hydro_sim.structured.rollout import INPUTS, OUTPUT_SCALES, OUTPUTS


@njit
def network_slopes(layers, x, a1, a2, y, slopes):
    """y, shape (m,), of `mlp.forward`, and dy/dx, shape (m, n): one pass back for each output."""
    mlp.forward(layers, x, a1, a2, y)
    h1, h2 = a1.shape[0], a2.shape[0]
    g1 = np.empty(h1)
    for row in range(y.shape[0]):
        g1[:] = 0.0
        for j in range(h2):
            if a2[j] > 0.0:
                for i in range(h1):
                    g1[i] += layers.w2[i, j] * layers.w3[j, row]
        for i in range(h1):
            if a1[i] <= 0.0:
                g1[i] = 0.0
        for i in range(x.shape[0]):
            total = 0.0
            for j in range(h1):
                total += layers.w1[i, j] * g1[j]
            slopes[row, i] = total


@njit
def residual(layers, center, scale, s, r, slopes):
    """`structured.residual` and dr/d(p_a, p_b, x_p, x_p', spool), shape (3, 5); whether there is anything."""
    r[:] = 0.0
    slopes[:] = 0.0
    if not (np.any(layers.w3) or np.any(layers.b3)):
        return False
    x, a1, a2 = np.empty(INPUTS), np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    for i in range(INPUTS):
        x[i] = (s[i] - center[i]) / scale[i]
    network_slopes(layers, x, a1, a2, r, slopes)
    for i in range(OUTPUTS):
        r[i] *= OUTPUT_SCALES[i]
        for j in range(INPUTS):
            slopes[i, j] *= OUTPUT_SCALES[i] / scale[j]
    return True
