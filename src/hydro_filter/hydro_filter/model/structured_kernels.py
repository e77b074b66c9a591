# SPDX-License-Identifier: Apache-2.0
"""The structured model for the certificate, compiled: one sample, and its tangents.

Three states appear (`hydro_sim.structured.rollout` has s and the full state)::

    s     (9)   p_a  p_b  x_p  x_p'  spool  spool'  F  F'  z          physics
    full  (12)  s and the box's f_h', f_l', x_p'                      everything that is simulated
    x     (8)   f_h  f_h'  f_l  f_l'  p_a  p_b  x_p  x_p'             what is measured (paper eq. state_def)

x does not hold the spool, its rate and the bristle: these are `hidden`, shape (3,), estimated from what is known
(`hidden_states`) and held fixed in derivatives by x. `model` is `StructuredModel.compiled`.
"""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.model import network_tangent, tangent
from hydro_filter.model.hidden_states import BRISTLE_STATE, SPOOL, SPOOL_RATE
from hydro_filter.model.state import (
    HYDRAULIC_FORCE_RATE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
)
from hydro_filter.model.tangent import WIDTH
from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.structured import rollout
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.physics import AREA, BIAS_L, GAIN_H, GAIN_L, RATIO
from hydro_sim.structured.rollout import INPUTS, OUTPUTS, READINGS

NUDGED = 7
"""Columns that a measured state needs: f_l, f_l', p_a, p_b, x_p, x_p' and the current; f_h and f_h' move nothing."""


@njit
def full_state(c, x, hidden, full):
    """Full state, shape (12,), from a measurement: each quantity from its best sensor."""
    full[0], full[1], full[2], full[3] = x[PRESSURE_A], x[PRESSURE_B], x[POSITION], x[VELOCITY]
    full[4], full[5], full[8] = hidden[SPOOL], hidden[SPOOL_RATE], hidden[BRISTLE_STATE]
    full[6], full[7] = (x[LOAD_FORCE] - c[BIAS_L]) / c[GAIN_L], x[LOAD_FORCE_RATE] / c[GAIN_L]
    full[9], full[10], full[11] = x[HYDRAULIC_FORCE_RATE], x[LOAD_FORCE_RATE], x[VELOCITY]


@njit
def _lift_nudges(c, d):
    """Nudges of s for columns f_l, f_l', p_a, p_b, x_p, x_p' of x, in this order, then of the current."""
    d[:] = 0.0
    d[6, 0] = d[7, 1] = 1.0 / c[GAIN_L]
    d[0, 2] = d[1, 3] = d[2, 4] = d[3, 5] = d[9, 6] = 1.0


@njit(inline="always")
def advance_tangents(model, full, current, d, rates):
    """`structured.advance_full` of the full state, shape (12,), in place, with tangents d, shape (10, 8), of s and u.

    `rates`, shape (3, 8), becomes the nudges of the box's rates that s is the reason of; those of their own memory are
    its coefficients.
    """
    c, layers, center, scale, memories = model
    s, before, after = full[:STATES], np.empty(READINGS), np.empty(READINGS)
    r, dr, inside = np.empty(OUTPUTS), np.zeros((OUTPUTS, WIDTH)), np.empty(4)
    rollout.read(c, s, before)
    _shown(c, d, memories, -1.0, rates)
    _added(layers, center, scale, s, d, r, dr)
    tangent.advance(c, s, current, r, d, dr)
    copies.vector(inside, s[:4])
    rollout.bound(c, s)
    for i in range(4):
        if s[i] != inside[i]:
            d[i] = 0.0
    rollout.read(c, s, after)
    rollout.differentiate(memories, before, after, full[STATES:])
    _shown(c, d, memories, 1.0, rates)


@njit(inline="always")
def _added(layers, center, scale, s, d, r, dr):
    """What the network adds, r, and its nudges dr, shape (3, 8), zero before."""
    slopes = np.empty((OUTPUTS, INPUTS))
    if network_tangent.residual(layers, center, scale, s, r, slopes):
        for i in range(OUTPUTS):
            for j in range(INPUTS):
                for k in range(WIDTH):
                    dr[i, k] += slopes[i, j] * d[j, k]


@njit
def _shown(c, d, memories, sign, rates):
    """Nudges of the box's differences of f_h, f_l, x_p before (sign -1: set) and after a sample (sign 1: added)."""
    force, velocity = sign * (1.0 - memories[0]) / SAMPLE_PERIOD, sign * (1.0 - memories[1]) / SAMPLE_PERIOD
    hydraulic, load = force * c[GAIN_H] * c[AREA], force * c[GAIN_L]
    if sign < 0.0:
        rates[:] = 0.0
    for k in range(WIDTH):
        rates[0, k] += hydraulic * (d[0, k] - c[RATIO] * d[1, k])
        rates[1, k] += load * d[6, k]
        rates[2, k] += velocity * d[2, k]
