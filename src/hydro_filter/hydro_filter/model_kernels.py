# SPDX-License-Identifier: Apache-2.0
"""The structured model as the certificate needs it, compiled: next state or rate, and their Jacobians.

Three states appear (`hydro_sim.learned.structured` has s and the full state)::

    s     (9)   p_a  p_b  x_p  x_p'  spool  spool'  F  F'  z          physics
    full  (12)  s and the box's f_h', f_l', x_p'                      everything that is simulated
    x     (8)   f_h  f_h'  f_l  f_l'  p_a  p_b  x_p  x_p'             what is measured (paper eq. state_def)

x does not hold the spool, its rate and the bristle: these are `hidden`, shape (3,), estimated from what is known
(`hidden_states`) and held fixed in derivatives by x. `model` is `StructuredModel.compiled`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from hydro_filter import network_tangent, tangent, tangent_rates
from hydro_filter.hidden_states import BRISTLE_STATE, SPOOL, SPOOL_RATE
from hydro_filter.state import (
    HYDRAULIC_FORCE,
    HYDRAULIC_FORCE_RATE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
)
from hydro_filter.state import STATES as MEASURED
from hydro_filter.tangent import SOURCES, WIDTH
from hydro_sim.learned import structured
from hydro_sim.learned.integration import STATES
from hydro_sim.learned.physics import AREA, BIAS_L, GAIN_H, GAIN_L, RATIO, SPOOL_OMEGA
from hydro_sim.learned.structured import FULL, INPUTS, OUTPUTS, READINGS
from hydro_sim.timing import SAMPLE

NUDGED = 7
"""Columns that a measured state needs: f_l, f_l', p_a, p_b, x_p, x_p' and the current; f_h and f_h' move nothing."""


@njit(cache=True)
def lift(c, x, hidden, full):
    """The full state, shape (12,), of a measurement: each quantity from the reading that shows it best."""
    full[0], full[1], full[2], full[3] = x[PRESSURE_A], x[PRESSURE_B], x[POSITION], x[VELOCITY]
    full[4], full[5], full[8] = hidden[SPOOL], hidden[SPOOL_RATE], hidden[BRISTLE_STATE]
    full[6], full[7] = (x[LOAD_FORCE] - c[BIAS_L]) / c[GAIN_L], x[LOAD_FORCE_RATE] / c[GAIN_L]
    full[9], full[10], full[11] = x[HYDRAULIC_FORCE_RATE], x[LOAD_FORCE_RATE], x[VELOCITY]


@njit(cache=True)
def _lift_nudges(c, d):
    """Nudges of s for columns f_l, f_l', p_a, p_b, x_p, x_p' of x, in this order, then of the current."""
    d[:] = 0.0
    d[6, 0] = d[7, 1] = 1.0 / c[GAIN_L]
    d[0, 2] = d[1, 3] = d[2, 4] = d[3, 5] = d[9, 6] = 1.0


@njit(cache=True, inline="always")
def nudge(model, full, current, d, rates):
    """`structured.advance_full` of the full state, shape (12,), in place, and of nudges d, shape (10, 8), of s and u.

    `rates`, shape (3, 8), becomes the nudges of the box's rates that s is the reason of; those of their own memory are
    its coefficients.
    """
    c, layers, center, scale, memories = model
    s, before, after = full[:STATES], np.empty(READINGS), np.empty(READINGS)
    r, dr, inside = np.empty(OUTPUTS), np.zeros((OUTPUTS, WIDTH)), np.empty(4)
    structured.read(c, s, before)
    _shown(c, d, memories, -1.0, rates)
    _added(layers, center, scale, s, d, r, dr)
    tangent.advance(c, s, current, r, d, dr)
    inside[:] = s[:4]
    structured.bound(c, s)
    for i in range(4):
        if s[i] != inside[i]:
            d[i] = 0.0
    structured.read(c, s, after)
    structured.differentiate(memories, before, after, full[STATES:])
    _shown(c, d, memories, 1.0, rates)


@njit(cache=True, inline="always")
def _added(layers, center, scale, s, d, r, dr):
    """What the network adds, r, and its nudges dr, shape (3, 8), zero before."""
    slopes = np.empty((OUTPUTS, INPUTS))
    if network_tangent.residual(layers, center, scale, s, r, slopes):
        for i in range(OUTPUTS):
            for j in range(INPUTS):
                for k in range(WIDTH):
                    dr[i, k] += slopes[i, j] * d[j, k]


@njit(cache=True)
def _shown(c, d, memories, sign, rates):
    """Nudges of the box's differences of f_h, f_l, x_p before (sign -1: set) and after a sample (sign 1: added)."""
    force, velocity = sign * (1.0 - memories[0]) / SAMPLE, sign * (1.0 - memories[1]) / SAMPLE
    hydraulic, load = force * c[GAIN_H] * c[AREA], force * c[GAIN_L]
    if sign < 0.0:
        rates[:] = 0.0
    for k in range(WIDTH):
        rates[0, k] += hydraulic * (d[0, k] - c[RATIO] * d[1, k])
        rates[1, k] += load * d[6, k]
        rates[2, k] += velocity * d[2, k]


@njit(cache=True)
def transition_full(model, full, current, state_matrix, input_vector, after):
    """The full state a sample later, shape (12,), with A_d (12, 12) and B_d (12,)."""
    memories = model[4]
    d, rates = np.empty((SOURCES, WIDTH)), np.empty((3, WIDTH))
    state_matrix[:] = 0.0
    for first in (0, WIDTH):  # ten columns, eight at a time
        d[:] = 0.0
        for k in range(min(WIDTH, SOURCES - first)):
            d[first + k, k] = 1.0
        after[:] = full
        nudge(model, after, current, d, rates)
        for k in range(min(WIDTH, STATES - first)):
            state_matrix[:STATES, first + k], state_matrix[STATES:, first + k] = d[:STATES, k], rates[:, k]
    input_vector[:STATES], input_vector[STATES:] = d[:STATES, 1], rates[:, 1]
    state_matrix[9, 9] = state_matrix[10, 10] = memories[0]
    state_matrix[11, 11] = memories[1]


@njit(cache=True)
def transition(model, x, hidden, current, state_matrix, input_vector, after):
    """x a sample later, shape (8,), with A_d (8, 8) and B_d (8,), the hidden states at their estimate."""
    c, memories = model[0], model[4]
    d, rates, full = np.empty((SOURCES, WIDTH)), np.empty((3, WIDTH)), np.empty(FULL)
    lift(c, x, hidden, full)
    _lift_nudges(c, d)
    nudge(model, full, current, d, rates)
    reading = np.empty(READINGS)
    structured.read(c, full[:STATES], reading)
    structured.show(reading, full[STATES:], after)
    by = np.empty((MEASURED, NUDGED))
    for k in range(NUDGED):
        by[HYDRAULIC_FORCE, k] = c[GAIN_H] * c[AREA] * (d[0, k] - c[RATIO] * d[1, k])
        by[HYDRAULIC_FORCE_RATE, k], by[LOAD_FORCE_RATE, k], by[VELOCITY, k] = rates[0, k], rates[1, k], rates[2, k]
        by[LOAD_FORCE, k] = c[GAIN_L] * d[6, k]
        by[PRESSURE_A, k], by[PRESSURE_B, k], by[POSITION, k] = d[0, k], d[1, k], d[2, k]
    _put(by, state_matrix, input_vector)
    state_matrix[HYDRAULIC_FORCE_RATE, HYDRAULIC_FORCE_RATE] += memories[0]
    state_matrix[LOAD_FORCE_RATE, LOAD_FORCE_RATE] += memories[0]
    state_matrix[VELOCITY, VELOCITY] += memories[1]


@njit(cache=True)
def _put(by, state_matrix, input_vector):
    """Columns of A and B from those of `_lift_nudges`."""
    state_matrix[:] = 0.0
    for i in range(MEASURED):
        for k in range(NUDGED - 1):
            state_matrix[i, k + LOAD_FORCE] = by[i, k]
        input_vector[i] = by[i, NUDGED - 1]


@njit(cache=True)
def flow(model, ages, x, bristle, current, state_matrix, input_vector, rate):
    """x' (8,) with A (8, 8) and B (8,), the spool taken to be where the current holds it; see `model_dynamics`."""
    c, layers, center, scale, _ = model
    y, slope, p, r = np.empty(STATES), np.empty(8), np.zeros((8, tangent_rates.PARTIALS)), np.empty(OUTPUTS)
    d, dr, moved = np.empty((SOURCES, WIDTH)), np.zeros((OUTPUTS, WIDTH)), np.zeros((8, WIDTH))
    y[0], y[1], y[2], y[3] = x[PRESSURE_A], x[PRESSURE_B], x[POSITION], x[VELOCITY]
    y[4], y[5], y[8] = current, 0.0, bristle
    y[6], y[7] = (x[LOAD_FORCE] - c[BIAS_L]) / c[GAIN_L], x[LOAD_FORCE_RATE] / c[GAIN_L]
    _lift_nudges(c, d)
    d[4, 6] = 1.0
    _added(layers, center, scale, y, d, r, dr)
    tangent_rates.rates(c, y[:8], bristle, current, r, slope, p)
    flat = d.reshape(SOURCES * WIDTH)
    flat_r, summed = dr.reshape(OUTPUTS * WIDTH), moved.reshape(8 * WIDTH)
    tangent.push(p, c[SPOOL_OMEGA] ** 2, flat, flat, flat_r, 1.0, 0.0, summed, np.empty(SOURCES * WIDTH))
    hydraulic = c[GAIN_H] * c[AREA]
    rate[HYDRAULIC_FORCE] = hydraulic * (slope[0] - c[RATIO] * slope[1])
    rate[HYDRAULIC_FORCE_RATE] = (rate[HYDRAULIC_FORCE] - x[HYDRAULIC_FORCE_RATE]) / ages[0]
    rate[LOAD_FORCE], rate[LOAD_FORCE_RATE] = x[LOAD_FORCE_RATE], c[GAIN_L] * slope[7]
    rate[PRESSURE_A], rate[PRESSURE_B], rate[POSITION], rate[VELOCITY] = slope[0], slope[1], x[VELOCITY], slope[3]
    by = np.empty((MEASURED, NUDGED))
    for k in range(NUDGED):
        by[HYDRAULIC_FORCE, k] = hydraulic * (moved[0, k] - c[RATIO] * moved[1, k])
        by[HYDRAULIC_FORCE_RATE, k] = by[HYDRAULIC_FORCE, k] / ages[0]
        by[LOAD_FORCE, k], by[LOAD_FORCE_RATE, k] = c[GAIN_L] * moved[6, k], c[GAIN_L] * moved[7, k]
        by[PRESSURE_A, k], by[PRESSURE_B, k], by[POSITION, k] = moved[0, k], moved[1, k], moved[2, k]
        by[VELOCITY, k] = moved[3, k]
    _put(by, state_matrix, input_vector)
    state_matrix[HYDRAULIC_FORCE_RATE, HYDRAULIC_FORCE_RATE] = -1.0 / ages[0]


@njit(cache=True, parallel=True)
def transitions(c, layers, center, scale, memories, x, hidden, currents, state_matrices, input_vectors, after):
    """`transition` of many states; the model comes in parts because parallel loops take no nested tuples."""
    for k in prange(len(x)):
        model = (c, layers, center, scale, memories)
        transition(model, x[k], hidden[k], currents[k], state_matrices[k], input_vectors[k], after[k])


@njit(cache=True, parallel=True)
def transitions_full(c, layers, center, scale, memories, full, currents, state_matrices, input_vectors, after):
    """`transition_full` of many states."""
    for k in prange(len(full)):
        model = (c, layers, center, scale, memories)
        transition_full(model, full[k], currents[k], state_matrices[k], input_vectors[k], after[k])


@njit(cache=True, parallel=True)
def flows(c, layers, center, scale, memories, ages, x, bristles, currents, state_matrices, input_vectors, rates):
    """`flow` of many states."""
    for k in prange(len(x)):
        model = (c, layers, center, scale, memories)
        flow(model, ages, x[k], bristles[k], currents[k], state_matrices[k], input_vectors[k], rates[k])
