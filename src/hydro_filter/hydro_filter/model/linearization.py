# SPDX-License-Identifier: Apache-2.0
"""The loop over one sample, compiled: linearization by the model's exact Jacobian (`bench_jacobian`), displacement v.

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

from hydro_core.signals import SAMPLE_PERIOD
from hydro_filter.model.coordinates import (
    INPUT,
    LOOP,
    Q_BOX_VELOCITY,
    Q_HYDRAULIC,
    Q_LOAD,
    Q_LOAD_RATE,
    Q_POSITION,
    Q_SPOOL,
    Q_SPOOL_RATE,
    Q_VELOCITY,
    law_feedback,
)
from hydro_filter.model.observer import held_rates, hydraulic_slopes, model_state, set_opening
from hydro_filter.model.parts import NONE
from hydro_filter.model.sample import HYDRAULIC_FORCE, LOAD_FORCE, LOAD_FORCE_RATE, PRESSURE_A
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model import machine_code

CLOSED = 1e-9
"""A: where the spool is taken to stand, still, in a sample in which it passes zero.

g differs on both sides, and a sample with a part of each has the derivatives of neither: it is linearized on the side
that the spool comes from.
"""


@njit
def linearize(loop, hidden, x, nominal_current, current, proportional_gain, scales, step):
    """Linearize at x (8,) and the simulated states into `step`, for nominal and actual current [A], K_p, (C_1, C_2)."""
    p, scale, n, whole = loop.model, loop.scale, len(loop.model.from_whole), len(loop.model.rest)
    model_state(p, hidden, x, step.whole, True)
    for i in range(n):
        step.before[i] = step.whole[p.from_whole[i]]
    opening = hidden[whole]
    side = math.copysign(1.0, opening)
    gain, _, _, soft_a, soft_b = hydraulic_slopes(p, step.before, opening)
    total = p.gain[0] * p.area * (soft_a + p.ratio * soft_b)
    share_a, share_b = soft_a / total, -soft_b / total
    _advance(p, step, opening, side, current)
    crossed = p.loop_spool != NONE and side * (step.after[p.loop_spool] + p.after) < 0.0
    if crossed:  # see CLOSED
        keeping = set_opening(p, step.before, p.loop_spool, p.loop_spool_rate, side * CLOSED)
        _advance(p, step, side * CLOSED, side, keeping)
    later = hydraulic_slopes(p, step.after, math.copysign(opening, side))[0]
    _embed(p, scale, share_a, share_b, gain, step.embedded)
    step.moved[:] = 0.0
    for j in range(n + 1):
        for c in range(len(scale)):
            nudge = step.embedded[j, c]
            if nudge != 0.0:
                for i in range(n):
                    step.moved[i, c] += step.by_state[i, j] * nudge
    _read(p, scale, gain, later, step)
    felt_a, felt_b = p.direct[0] * share_a, p.direct[1] * share_b
    law_feedback(loop, x, math.copysign(nominal_current, side), proportional_gain, scales, felt_a, felt_b, step)
    for i in range(len(p.lagging)):  # the law reads what the sensor shows
        chamber, column = p.lagging[i, 2], LOOP + 2 * i
        step.feedback[column] = step.law[PRESSURE_A + chamber] * p.gain[2 + chamber] * scale[column]


@njit
def _advance(p, step, opening, side, current):
    """Advance the loop's model and its Jacobian by a sample; an opening near zero is moved to its side of zero."""
    copy_vector(step.after, step.before)
    if p.loop_spool != NONE:
        if abs(opening) < CLOSED:
            step.after[p.loop_spool] = side * CLOSED - p.after
    else:
        closed = side * CLOSED - p.before - p.after
        for i in range(len(step.after) - p.past, len(step.after)):
            if abs(step.after[i] + p.before + p.after) < CLOSED:
                step.after[i] = closed
        if abs(current + p.before + p.after) < CLOSED:
            current = closed
    machine_code.jacobian(
        p.loop_jacobian_at, p.loop_k, step.after, current, step.reading, step.by_state, step.by_reading
    )


@njit
def _embed(p, scale, share_a, share_b, gain, embedded):
    """Tangents of the loop's states for the coordinates; of the current in the box's column, `INPUT`."""
    embedded[:] = 0.0
    embedded[0, Q_HYDRAULIC], embedded[1, Q_HYDRAULIC] = scale[Q_HYDRAULIC] * share_a, scale[Q_HYDRAULIC] * share_b
    if p.loop_spool != NONE:
        embedded[p.loop_spool, Q_SPOOL] = scale[Q_SPOOL] / gain
    if p.loop_spool_rate != NONE:
        embedded[p.loop_spool_rate, Q_SPOOL_RATE] = scale[Q_SPOOL_RATE] / gain
    if p.loop_cell_rate != NONE:
        embedded[p.loop_cell, Q_LOAD] = scale[Q_LOAD] / p.gain[1]
        embedded[p.loop_cell_rate, Q_LOAD_RATE] = scale[Q_LOAD_RATE] / p.gain[1]
    embedded[2, Q_POSITION], embedded[3, Q_VELOCITY] = scale[Q_POSITION], scale[Q_VELOCITY]
    for i in range(len(p.kept)):
        unit = scale[LOOP + i]
        embedded[p.kept[i], LOOP + i] = unit / gain if i >= len(p.kept) - p.on_their_way else unit
    embedded[len(embedded) - 1, INPUT] = 1.0


@njit
def _read(p, scale, gain, later, step):
    """F and G from the tangents a sample later; `gain`, `later`: g before and after the sample."""
    moved, embedded, F, n = step.moved, step.embedded, step.transition, len(step.before)
    area, memory = p.gain[0] * p.area / scale[Q_HYDRAULIC], p.memories[1]
    for c in range(len(scale)):
        F[Q_HYDRAULIC, c] = area * (moved[0, c] - p.ratio * moved[1, c])
        if p.loop_spool != NONE:
            spool, before = moved[p.loop_spool, c], embedded[p.loop_spool, c]
        else:
            spool = embedded[n, c] if p.past == 0 else moved[n - p.past + p.at_valve, c]
            before = scale[Q_SPOOL] / gain if c == Q_SPOOL else 0.0
        turned = moved[p.loop_spool_rate, c] if p.loop_spool_rate != NONE else (spool - before) / SAMPLE_PERIOD
        F[Q_SPOOL, c], F[Q_SPOOL_RATE, c] = later / scale[Q_SPOOL] * spool, later / scale[Q_SPOOL_RATE] * turned
        F[Q_LOAD, c] = p.gain[1] / scale[Q_LOAD] * moved[p.loop_cell, c]
        F[Q_POSITION, c] = moved[2, c] / scale[Q_POSITION]
        F[Q_VELOCITY, c] = moved[3, c] / scale[Q_VELOCITY]
        if p.loop_cell_rate != NONE:
            F[Q_LOAD_RATE, c] = p.gain[1] / scale[Q_LOAD_RATE] * moved[p.loop_cell_rate, c]
        else:  # an ideal cell shows the load itself, and its rate
            stiffness = step.by_state[p.loop_cell, 2] / step.by_state[2, 2]
            F[Q_LOAD_RATE, c] = p.gain[1] / scale[Q_LOAD_RATE] * stiffness * moved[3, c]
        for i in range(len(p.kept)):
            unit = later if i >= len(p.kept) - p.on_their_way else 1.0
            F[LOOP + i, c] = unit / scale[LOOP + i] * moved[p.kept[i], c]
        F[Q_BOX_VELOCITY, c] = (1.0 - memory) / SAMPLE_PERIOD * (moved[2, c] - embedded[2, c]) / scale[Q_BOX_VELOCITY]
    for i in range(len(scale)):
        step.push[i], F[i, INPUT] = F[i, INPUT], 0.0
    F[Q_BOX_VELOCITY, Q_BOX_VELOCITY] = memory  # the differentiator's


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
