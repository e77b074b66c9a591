# SPDX-License-Identifier: Apache-2.0
"""The paper's network, compiled, as the certificate needs it: x' or next state, and their Jacobians.

`model` is (layers, center, scale, current_scale, rate_scale) in float64, as `hydro_sim.learned.network_model` has them.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from hydro_filter import network_tangent
from hydro_filter.state import STATES
from hydro_sim.learned.network import INPUTS
from hydro_sim.timing import SAMPLE


@njit(cache=True)
def flow(model, x, current, state_matrix, input_vector, rate):
    """x' (8,) with A (8, 8) and B (8,)."""
    layers, center, scale, current_scale, rate_scale = model
    z, slopes = np.empty(INPUTS), np.empty((STATES, INPUTS))
    a1, a2 = np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    for i in range(STATES):
        z[i] = (x[i] - center[i]) / scale[i]
    z[STATES] = current / current_scale
    network_tangent.network_slopes(layers, z, a1, a2, rate, slopes)
    for i in range(STATES):
        rate[i] *= rate_scale[i]
        input_vector[i] = rate_scale[i] * slopes[i, STATES] / current_scale
        for j in range(STATES):
            state_matrix[i, j] = rate_scale[i] * slopes[i, j] / scale[j]


@njit(cache=True)
def transition(model, x, current, state_matrix, input_vector, after):
    """x a sample later, shape (8,), with A_d = I + T A and B_d = T B: the model's own step."""
    flow(model, x, current, state_matrix, input_vector, after)
    for i in range(STATES):
        after[i] = x[i] + SAMPLE * after[i]
        input_vector[i] *= SAMPLE
        for j in range(STATES):
            state_matrix[i, j] *= SAMPLE
        state_matrix[i, i] += 1.0


@njit(cache=True, parallel=True)
def flows(layers, center, scale, current_scale, rate_scale, x, currents, state_matrices, input_vectors, rates):
    """`flow` of many states; the model comes in parts because parallel loops take no nested tuples."""
    for k in prange(len(x)):
        model = (layers, center, scale, current_scale, rate_scale)
        flow(model, x[k], currents[k], state_matrices[k], input_vectors[k], rates[k])


@njit(cache=True, parallel=True)
def transitions(layers, center, scale, current_scale, rate_scale, x, currents, state_matrices, input_vectors, after):
    """`transition` of many states."""
    for k in prange(len(x)):
        model = (layers, center, scale, current_scale, rate_scale)
        transition(model, x[k], currents[k], state_matrices[k], input_vectors[k], after[k])
