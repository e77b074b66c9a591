# SPDX-License-Identifier: Apache-2.0
"""Displacement v of the loop's state from its reference trajectory, compiled.

The paper projects v on the force error (eq. v), so that the certificate cannot represent the instability at high gains.
Here v = (q - q_r) / scale over all loop coordinates (`coordinates`), with q_r from f_r, f_r', f_r'' and the bench
file's model (w, d: the load cell's frequency and damping; F_s(x_p): the load)::

    F_s = f_r + 2 d/w f_r' + f_r''/w^2     x_p = F_s^-1     x_p' = F_s'/k     f_l, f_l' = f_r, f_r'     k = dF_s/dx_p
    f_h = F_s + m F_s''/k + friction       spool: what holds f_h' = F_s' at that velocity

The present friction is used, so that it causes no displacement. The spool's coordinate is the force rate that the open
edges drive, overlap and all. So is that of a current on its way; its reference is the spool's at the time at which it
will have moved the spool. What a lagging sensor shows is displaced by its pressure's share of f_h, and by what it is
behind that pressure beyond the lag of the reference.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.model.coordinates import (
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
from hydro_filter.model.observer import held_rates, hydraulic_slopes, model_state
from hydro_filter.model.parts import NONE
from hydro_filter.model.sample import (
    HYDRAULIC_FORCE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
)
from hydro_sim.jit import njit


@njit
def second_derivative(p, memory, reference_rate):
    """Return f_r'' [N/s^2] from two samples of f_r'."""
    return min(max((reference_rate - memory.reference_rate) / SAMPLE_PERIOD, -p.bend_max), p.bend_max)


@njit
def position_at(p, force):
    """Position [m] at which the load is a force [N], and its stiffness there [N/m]."""
    i = min(max(np.searchsorted(p.forces, force) - 1, 0), len(p.forces) - 2)
    stiffness = (p.forces[i + 1] - p.forces[i]) / (p.positions[i + 1] - p.positions[i])
    return p.positions[i] + (force - p.forces[i]) / stiffness, stiffness


@njit
def load_at(p, position):
    """Load [N] at a position [m]."""
    step = p.positions[1] - p.positions[0]
    i = min(max(int((position - p.positions[0]) / step), 0), len(p.forces) - 2)
    return p.forces[i] + (p.forces[i + 1] - p.forces[i]) * (position - p.positions[i]) / step


@njit
def displace(loop, memory, x, reference, reference_rate, v):
    """Write v, of each coordinate, of a sample x, shape (8,), at f_r [N] and f_r' [N/s]."""
    p, n, bent = loop.model, len(loop.model.rest), second_derivative(loop.model, memory, reference_rate)
    y, state, slopes = np.empty(n), np.empty(len(p.from_whole)), np.empty(p.slopes)
    opening = memory.hidden[n]
    model_state(p, memory.hidden, x, y, True)
    for i in range(len(state)):
        state[i] = y[p.from_whole[i]]
    gain, loss, still, soft_a, soft_b = hydraulic_slopes(p, state, opening)
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
    wanted, wanted_rate = spring_rate + loss * velocity - still, (1.0 + loss / stiffness) * spring_bend
    v[Q_HYDRAULIC] = x[HYDRAULIC_FORCE] - p.bias[0] - p.gain[0] * hydraulic
    if p.force_shown != NONE:
        v[Q_HYDRAULIC] += p.gain[0] * (p.area * (y[0] - p.ratio * y[1]) - y[p.force_shown])
    v[Q_SPOOL] = driven - wanted
    v[Q_SPOOL_RATE] = gain * memory.hidden[n + 1] - wanted_rate
    v[Q_LOAD] = x[LOAD_FORCE] - reference
    v[Q_LOAD_RATE] = x[LOAD_FORCE_RATE] - reference_rate
    v[Q_POSITION] = y[2] - position
    v[Q_VELOCITY] = v[Q_BOX_VELOCITY] = y[3] - velocity
    if len(p.kept) > 0:
        _displace_shown(p, y, v, soft_a, soft_b, spring_rate)
        _displace_commands(p, memory, y, v, still - loss * y[3], wanted, wanted_rate, slopes)
    for i in range(len(loop.scale)):
        v[i] /= loop.scale[i]


@njit
def _displace_shown(p, y, v, soft_a, soft_b, force_rate):
    """What lagging pressure sensors show, and its rate; `force_rate`: f_h' [N/s] of the reference, of its spring."""
    total = p.area * (soft_a + p.ratio * soft_b)
    for i in range(len(p.lagging)):
        signal, rate, chamber = p.lagging[i]
        share = soft_a / total if chamber == 0 else -soft_b / total
        behind = y[signal] - y[chamber] + p.sensor_ages[i] * share * force_rate
        v[LOOP + 2 * i] = share * v[Q_HYDRAULIC] / p.gain[0] + behind
        v[LOOP + 2 * i + 1] = y[rate] - share * force_rate


@njit
def _displace_commands(p, memory, y, v, closed, wanted, wanted_rate, slopes):
    """Currents on their way; `closed`: f_h' [N/s] of the closed valve, `wanted`: the reference's, and its rate."""
    first, begin = len(v) - p.on_their_way, len(y) - p.past
    for i in range(p.on_their_way):
        driven = held_rates(p, y, memory.hidden[begin + i] + p.before + p.after, True, slopes) - closed
        ahead = p.delay - (i + 0.5) * SAMPLE_PERIOD + p.spool_age
        v[first + i] = driven - wanted - ahead * wanted_rate


@njit
def dry_force(p, y, state, slopes):
    """Force [N] of the disturbances against the motion, from the difference of both models' accelerations.

    Where friction can hold, a velocity below `creep` counts by its share: its sign is noise.
    """
    measured, share = y[3], 1.0
    if p.holds and abs(measured) < p.creep:
        share = abs(measured) / p.creep
        y[3] = state[3] = math.copysign(p.creep, measured)
    held_rates(p, y, 0.0, True, slopes)
    whole = slopes[3]
    held_rates(p, state, 0.0, False, slopes)
    y[3] = state[3] = measured
    return share * p.mass * (slopes[3] - whole)
