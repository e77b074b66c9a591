# SPDX-License-Identifier: Apache-2.0
"""The structured model: `physics` with learned constants, and a network for the residual.

::

    state s (9) --+--> (s[:5] - center) / scale --> network 5 -> h1 -> h2 -> 3 --> r      once per sample
                  +--> integration.advance(s, u, r) --> next s --> readings f_h f_l p_a p_b x_p (5) --> x (8)

The last arrow is the box's own differentiation. What is simulated is therefore s and three rates, `FULL` = 12 numbers::

    [ p_a  p_b  x_p  x_p'  spool  spool'  F  F'  z | f_h'  f_l'  x_p' as the box has them ]

Everything is float64: pressures of 1e7 Pa and spool travels of 1e-6 A meet here.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.jit import njit
from hydro_sim.neural import mlp
from hydro_sim.structured import integration
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.physics import AREA, BIAS_H, BIAS_L, GAIN_H, GAIN_L, RATIO, STROKE, SUPPLY

INPUTS, OUTPUTS, READINGS, FULL = 5, 3, 5, 12
OUTPUT_SCALES = (0.02, 0.02, 5.0)
"""Scales of the network's outputs: relative flow into A, out of B, force [N]."""


@njit
def read(c, s, reading):
    """The five readings of a state."""
    reading[0] = c[GAIN_H] * c[AREA] * (s[0] - c[RATIO] * s[1]) + c[BIAS_H]
    reading[1] = c[GAIN_L] * s[6] + c[BIAS_L]
    reading[2], reading[3], reading[4] = s[0], s[1], s[2]


@njit
def residual(layers, center, scale, s, x, a1, a2, r):
    """Output of the network at state s: r, shape (3,)."""
    for i in range(INPUTS):
        x[i] = (s[i] - center[i]) / scale[i]
    mlp.forward(layers, x, a1, a2, r)
    for i in range(OUTPUTS):
        r[i] *= OUTPUT_SCALES[i]


@njit
def advance(c, layers, center, scale, s, current, work, x, a1, a2, r):
    """Advance s, shape (9,), by one sample of 1 ms in place."""
    residual(layers, center, scale, s, x, a1, a2, r)
    integration.advance(c, s, current, r, work)


@njit
def bound(c, s):
    """Bound s to what a bench can reach, whatever was commanded: the simulation stays finite."""
    s[0] = min(max(s[0], 0.0), 2.0 * c[SUPPLY])
    s[1] = min(max(s[1], 0.0), 2.0 * c[SUPPLY])
    s[2] = min(max(s[2], -2e-3), c[STROKE] + 2e-3)
    s[3] = min(max(s[3], -5.0), 5.0)


@njit
def advance_full(c, layers, center, scale, memories, full, current, work, x, a1, a2, r, measured):
    """Advance the full state, shape (12,), by one sample of 1 ms in place; `measured`, shape (8,), becomes the box's x.

    `memories`: the box's coefficients for force rates and for the velocity (hydro_sim.model.sensors).
    """
    s = full[:STATES]
    before, after = np.empty(READINGS), np.empty(READINGS)
    read(c, s, before)
    advance(c, layers, center, scale, s, current, work, x, a1, a2, r)
    bound(c, s)
    read(c, s, after)
    differentiate(memories, before, after, full[STATES:])
    show(after, full[STATES:], measured)


@njit
def differentiate(memories, before, after, rates):
    """The box's three rates a sample later (hydro_sim.model.sensors.condition, without noise)."""
    force, velocity = memories[0], memories[1]
    rates[0] = force * rates[0] + (1.0 - force) * (after[0] - before[0]) / SAMPLE_PERIOD
    rates[1] = force * rates[1] + (1.0 - force) * (after[1] - before[1]) / SAMPLE_PERIOD
    rates[2] = velocity * rates[2] + (1.0 - velocity) * (after[4] - before[4]) / SAMPLE_PERIOD


@njit
def show(reading, rates, measured):
    """Five readings and three rates in the order of x, shape (8,)."""
    measured[0], measured[2], measured[4], measured[5], measured[6] = reading
    measured[1], measured[3], measured[7] = rates


@njit(parallel=True)
def rollout(c, layers, center, scale, memories, starts, currents):
    """x after each sample, shape (n, H, 8), from full states, shape (n, 12), under currents [A], shape (n, H)."""
    n, horizon = currents.shape
    measured = np.empty((n, horizon, 8))
    for k in prange(n):
        work, full = integration.scratch(), starts[k].copy()
        x, r = np.empty(INPUTS), np.empty(OUTPUTS)
        a1, a2 = np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
        for h in range(horizon):
            advance_full(c, layers, center, scale, memories, full, currents[k, h], work, x, a1, a2, r, measured[k, h])
    return measured
