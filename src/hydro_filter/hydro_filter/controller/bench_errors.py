# SPDX-License-Identifier: Apache-2.0
"""Equation errors of a bench file's model: the five of `innovations`, from the model's own rates.

The predicted load is the simulated state of its amplifier, driven by the measured positions. Static friction may have
any force up to its level: below `bench_displacement.CREEP` the best-fitting one is used. Behind a lagging sensor, a
chamber's error is what the observer corrects of its pressure in a sample.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.model.bench_displacement import CREEP
from hydro_filter.model.bench_parts import NONE
from hydro_filter.model.bench_states import held_rates, hydraulic_slopes, model_state
from hydro_filter.model.state import POSITION, PRESSURE_A, PRESSURE_B, STATES
from hydro_sim.jit import njit

F_H, F_L, P_A, P_B, X_P = range(5)
"""Readings stored by the monitor."""


@njit
def load_cell_reading(model, m, x, hidden):
    """Return the load-cell reading at the middle sample; a valve without lag steps there, and its mean is used."""
    p, n = model, len(model.rest)
    m.cell = m.hidden[p.cell]
    if p.spool == NONE:
        m.hidden[n] = 0.5 * (m.hidden[n] + hidden[n])


@njit
def errors(model, m, x, error, size):
    """Return each equation's error at the middle sample and the scale of its left-hand side; both shape (5,)."""
    p, n, readings = model, len(model.rest), m.middle
    y, state, slopes, measured = np.empty(n), np.empty(len(p.from_whole)), np.empty(p.slopes), np.zeros(STATES)
    measured[PRESSURE_A], measured[PRESSURE_B], measured[POSITION] = readings[P_A], readings[P_B], readings[X_P]
    model_state(p, m.hidden, measured, y, False)
    speed = (x[POSITION] - m.last[X_P]) / (2.0 * SAMPLE_PERIOD * p.gain[4])
    y[3] = speed
    for i in range(len(state)):
        state[i] = y[p.from_whole[i]]
    opening = m.hidden[n]
    bend = (x[POSITION] - 2.0 * readings[X_P] + m.last[X_P]) / (SAMPLE_PERIOD**2 * p.gain[4])
    _, _, _, soft_a, soft_b = hydraulic_slopes(p, state, opening)
    held_rates(p, y, opening, True, slopes)
    rate_a, rate_b, pull = slopes[0], slopes[1], slopes[3]
    error[1] = p.mass * (bend - pull)
    if p.holds and abs(speed) < CREEP:
        y[3] = state[3] = math.copysign(CREEP, speed)
        held_rates(p, y, opening, True, slopes)
        whole = slopes[3]
        held_rates(p, state, 0.0, False, slopes)
        level = p.mass * abs(slopes[3] - whole)
        y[3] = state[3] = speed
        held_rates(p, state, 0.0, False, slopes)
        free = p.mass * (bend - slopes[3])
        error[1] = free - min(max(free, -level), level)
    pushed = p.gain[0] * (p.area * (y[0] - p.ratio * y[1]) if p.force_shown == NONE else m.hidden[p.force_shown])
    error[0] = readings[F_L] - p.gain[1] * m.cell - p.bias[1]
    error[2] = readings[F_H] - pushed - p.bias[0]
    error[3] = 0.5 * (x[PRESSURE_A] - m.last[P_A]) / p.gain[2] - SAMPLE_PERIOD * rate_a
    error[4] = 0.5 * (x[PRESSURE_B] - m.last[P_B]) / p.gain[3] - SAMPLE_PERIOD * rate_b
    for i in range(len(p.lagging)):
        error[3 + p.lagging[i, 2]] = y[p.lagging[i, 2]] - m.hidden[p.lagging[i, 2]]
    size[0] = abs(p.gain[1] * m.cell)
    size[1] = abs(p.area * (y[0] - p.ratio * y[1]))
    size[2] = abs(pushed)
    size[3] = SAMPLE_PERIOD * (abs(rate_a) + soft_a * abs(speed))
    size[4] = SAMPLE_PERIOD * (abs(rate_b) + soft_b * abs(speed))
