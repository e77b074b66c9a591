# SPDX-License-Identifier: Apache-2.0
"""Displacement of a bench file's loop from its reference trajectory, compiled: see `displacement`.

The spool's coordinate is the force rate that the open edges drive, overlap and all.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hydro_filter.model.bench_states import held_rates, hydraulic_slopes, model_state
from hydro_filter.model.displacement import second_derivative
from hydro_filter.model.loop_model import (
    LOOP,
    Q_BOX_VELOCITY,
    Q_HYDRAULIC,
    Q_LOAD,
    Q_LOAD_RATE,
    Q_POSITION,
    Q_SPOOL,
    Q_SPOOL_RATE,
    Q_VELOCITY,
)
from hydro_filter.model.state import (
    HYDRAULIC_FORCE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
)

CREEP = 2e-3
"""m/s, below which the sign of a measured velocity is noise: dry friction that holds counts by its share of this."""


@njit(cache=True)
def position_at(p, force):
    """Position [m] at which the load is a force [N], and its stiffness there [N/m]."""
    i = min(max(np.searchsorted(p.forces, force) - 1, 0), len(p.forces) - 2)
    stiffness = (p.forces[i + 1] - p.forces[i]) / (p.positions[i + 1] - p.positions[i])
    return p.positions[i] + (force - p.forces[i]) / stiffness, stiffness


@njit(cache=True)
def load_at(p, position):
    """Load [N] at a position [m]."""
    step = p.positions[1] - p.positions[0]
    i = min(max(int((position - p.positions[0]) / step), 0), len(p.forces) - 2)
    return p.forces[i] + (p.forces[i + 1] - p.forces[i]) * (position - p.positions[i]) / step


@njit(cache=True)
def displace(loop, memory, x, reference, reference_rate, v):
    """Write v, shape (8,), of a sample x, shape (8,), at f_r [N] and f_r' [N/s]: see `displacement`."""
    p, n, bent = loop.model, len(loop.model.rest), second_derivative(memory, reference_rate)
    y, state, slopes = np.empty(n), np.empty(len(p.from_whole)), np.empty(p.slopes)
    opening = memory.hidden[n]
    model_state(p, memory.hidden, x, y, True)
    for i in range(len(state)):
        state[i] = y[p.from_whole[i]]
    gain, loss, still, _, _ = hydraulic_slopes(p, state, opening)
    spring = (reference - p.bias[1] + p.lag * reference_rate + p.inertia * bent) / p.gain[1]
    spring_rate, spring_bend = (reference_rate + p.lag * bent) / p.gain[1], bent / p.gain[1]
    position, stiffness = position_at(p, spring)
    velocity = spring_rate / stiffness
    driven = held_rates(p, y, opening, True, slopes) - (still - loss * y[3])
    dry = dry_force(p, y, state, slopes)
    pushing = p.area * (y[0] - p.ratio * y[1]) - load_at(p, y[2])
    state[3] = velocity
    held_rates(p, state, 0.0, False, slopes)
    hydraulic = spring + p.mass * spring_bend / stiffness + pushing - p.mass * slopes[3] + dry
    v[Q_HYDRAULIC] = x[HYDRAULIC_FORCE] - p.bias[0] - p.gain[0] * hydraulic
    v[Q_SPOOL] = driven - (spring_rate + loss * velocity - still)
    v[Q_SPOOL_RATE] = gain * memory.hidden[n + 1] - (1.0 + loss / stiffness) * spring_bend
    v[Q_LOAD] = x[LOAD_FORCE] - reference
    v[Q_LOAD_RATE] = x[LOAD_FORCE_RATE] - reference_rate
    v[Q_POSITION] = y[2] - position
    v[Q_VELOCITY] = v[Q_BOX_VELOCITY] = y[3] - velocity
    for i in range(LOOP):
        v[i] /= loop.scale[i]


@njit(cache=True)
def dry_force(p, y, state, slopes):
    """Force [N] of the disturbances against the motion, from the difference of both models' accelerations.

    Where friction can hold, a velocity below `CREEP` counts by its share: its sign is noise.
    """
    measured, share = y[3], 1.0
    if p.holds and abs(measured) < CREEP:
        share = abs(measured) / CREEP
        y[3] = state[3] = math.copysign(CREEP, measured)
    held_rates(p, y, 0.0, True, slopes)
    whole = slopes[3]
    held_rates(p, state, 0.0, False, slopes)
    y[3] = state[3] = measured
    return share * p.mass * (slopes[3] - whole)
