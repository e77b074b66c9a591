# SPDX-License-Identifier: Apache-2.0
"""A bench file's loop, compiled: a sample linearized, the displacement, and the hidden states followed.

    measured   p_a  p_b  x_p  x_p'  f_l  f_l'       from the readings, at every sample
    followed   all other states of the model         by the model itself, one sample at a time, from what is measured
               and the current that the valve got; they forget where they began as their effects do

Derivatives are `bench_jacobian`'s, of the compiled step, exact. What the valve does is asked of the model's rates: g is
the slope of f_h' from the closed valve to where the spool is, and the spool's coordinate is the force rate that the
open edges drive, overlap and all. A valve without a lag has the last current for its spool.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.model.bench_loop import NONE
from hydro_filter.model.displacement import bend
from hydro_filter.model.loop_model import (
    CLOSED,
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
from hydro_filter.model.state import (
    HYDRAULIC_FORCE,
    HYDRAULIC_FORCE_RATE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
)
from hydro_sim import copies
from hydro_sim.model import machine_code

CREEP = 2e-3
"""m/s, below which the sign of a measured velocity is noise: dry friction that holds counts by its share of this."""

PROBE = 0.1
"""m/s, over which the velocity's part of the flows is taken; they are linear in it."""


@njit(cache=True)
def lift(p, hidden, x, y, cell):
    """Write y, the whole model's state, of what is followed and a measurement; `cell`: also f_l and its rate."""
    for i in range(len(y)):
        y[i] = hidden[i]
    y[0] = (x[PRESSURE_A] - p.bias[2]) / p.gain[2]
    y[1] = (x[PRESSURE_B] - p.bias[3]) / p.gain[3]
    y[2], y[3] = (x[POSITION] - p.bias[4]) / p.gain[4], x[VELOCITY] / p.gain[4]
    for i in range(len(p.lagging)):
        y[p.lagging[i, 0]] = y[p.lagging[i, 1]]
    if cell:
        y[p.cell] = (x[LOAD_FORCE] - p.bias[1]) / p.gain[1]
        if p.cell_rate != NONE:
            y[p.cell_rate] = x[LOAD_FORCE_RATE] / p.gain[1]


@njit(cache=True)
def place(p, y, spool, spool_rate, opening):
    """Put the spool of a state where the valve is open by `opening` [A]; returns the current that keeps it there."""
    if spool == NONE:
        return opening - p.after - p.before
    y[spool] = opening - p.after
    if spool_rate != NONE:
        y[spool_rate] = 0.0
    return opening - p.after - p.before


@njit(cache=True)
def rates_at(p, y, opening, whole, slopes):
    """y' of the whole model or the loop's at a state whose valve is held open by `opening` [A]; returns f_h' [N/s]."""
    current = np.empty(1)
    if whole:
        current[0] = place(p, y, p.spool, p.spool_rate, opening)
        machine_code.rates(p.rates_at, p.k, 1, y, current, slopes)
    else:
        current[0] = place(p, y, p.loop_spool, p.loop_spool_rate, opening)
        machine_code.rates(p.loop_rates_at, p.loop_k, 1, y, current, slopes)
    return p.area * (slopes[0] - p.ratio * slopes[1])


@njit(cache=True)
def hydraulic_slopes(p, state, opening):
    """What moves f_h of the loop's model at a state.

    g [N/s/A] on the opening's side, what f_h' loses per velocity [N/m], f_h' of the closed valve at rest [N/s], and how
    fast a velocity lowers p_a and raises p_b [Pa/m].
    """
    y, slopes = state.copy(), np.empty(p.slopes)
    side = math.copysign(1.0, opening)
    closed = rates_at(p, y, 0.0, False, slopes)
    rate_a, rate_b = slopes[0], slopes[1]
    y[3] += PROBE
    rates_at(p, y, 0.0, False, slopes)
    soft_a, soft_b = (rate_a - slopes[0]) / PROBE, (slopes[1] - rate_b) / PROBE
    y[3] -= PROBE
    size = max(abs(opening), p.least_opening)
    gain = (rates_at(p, y, side * size, False, slopes) - closed) / (side * size)
    stiffness = p.area * (soft_a + p.ratio * soft_b)
    return max(gain, p.least_gain), stiffness, closed + stiffness * y[3], soft_a, soft_b


@njit(cache=True)
def settle(loop, memory, x, current, reference_rate):
    """Take in the first sample: a bench that begins here, its spool where the current of now leads to."""
    if not memory.running:
        p, n = loop.model, len(loop.model.rest)
        memory.hidden[:] = 0.0
        copies.vector(memory.hidden, p.rest)
        lift(p, memory.hidden, x, memory.hidden[:n], True)
        memory.hidden[n] = current + p.before + p.after
        place(p, memory.hidden, p.spool, p.spool_rate, memory.hidden[n])
        memory.reference_rate, memory.current, memory.running = reference_rate, current, True


@njit(cache=True)
def follow(loop, memory, x, current, reference_rate):
    """Move the memory to the next sample, over which the valve holds `current` [A]."""
    p, n, z = loop.model, len(loop.model.rest), np.empty(5)
    opening = memory.hidden[n]
    lift(p, memory.hidden, x, memory.hidden[:n], False)
    machine_code.sample(p.sample_at, p.k, memory.hidden, current, z)
    memory.hidden[n] = (current + p.before if p.spool == NONE else memory.hidden[p.spool]) + p.after
    own_rate = p.spool != NONE and p.spool_rate != NONE
    memory.hidden[n + 1] = memory.hidden[p.spool_rate] if own_rate else (memory.hidden[n] - opening) / SAMPLE_PERIOD
    memory.reference_rate, memory.current = reference_rate, current


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
    p, n, bent = loop.model, len(loop.model.rest), bend(memory, reference_rate)
    y, state, slopes = np.empty(n), np.empty(len(p.from_whole)), np.empty(p.slopes)
    opening = memory.hidden[n]
    lift(p, memory.hidden, x, y, True)
    for i in range(len(state)):
        state[i] = y[p.from_whole[i]]
    gain, loss, still, _, _ = hydraulic_slopes(p, state, opening)
    spring = (reference - p.bias[1] + p.lag * reference_rate + p.inertia * bent) / p.gain[1]
    spring_rate, spring_bend = (reference_rate + p.lag * bent) / p.gain[1], bent / p.gain[1]
    position, stiffness = position_at(p, spring)
    velocity = spring_rate / stiffness
    driven = rates_at(p, y, opening, True, slopes) - (still - loss * y[3])
    dry = dry_force(p, y, state, slopes)
    pushing = p.area * (y[0] - p.ratio * y[1]) - load_at(p, y[2])
    state[3] = velocity
    rates_at(p, state, 0.0, False, slopes)
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
    """Force [N] of the disturbances against the motion: what both models' accelerations differ by. y, state as lifted.

    Where friction can hold, a velocity below `CREEP` counts by its share: its sign is noise.
    """
    measured, share = y[3], 1.0
    if p.holds and abs(measured) < CREEP:
        share = abs(measured) / CREEP
        y[3] = state[3] = math.copysign(CREEP, measured)
    rates_at(p, y, 0.0, True, slopes)
    whole = slopes[3]
    rates_at(p, state, 0.0, False, slopes)
    y[3] = state[3] = measured
    return share * p.mass * (slopes[3] - whole)


@njit(cache=True)
def linearize(loop, hidden, x, nominal_current, current, proportional_gain, step):
    """Fill `step` at x (8,) and what is followed, for a nominal current and the one that the valve got [A]."""
    p, scale, n, whole = loop.model, loop.scale, len(loop.model.from_whole), len(loop.model.rest)
    lift(p, hidden, x, step.whole, True)
    for i in range(n):
        step.before[i] = step.whole[p.from_whole[i]]
    opening = hidden[whole]
    side = math.copysign(1.0, opening)
    gain, _, _, soft_a, soft_b = hydraulic_slopes(p, step.before, opening)
    total = p.gain[0] * p.area * (soft_a + p.ratio * soft_b)
    share_a, share_b = soft_a / total, -soft_b / total
    _advance(p, step, opening, side, current)
    _state_rate(p, x, step)
    crossed = p.loop_spool != NONE and side * (step.after[p.loop_spool] + p.after) < 0.0
    if crossed:  # see `loop_model.CLOSED`
        keeping = place(p, step.before, p.loop_spool, p.loop_spool_rate, side * CLOSED)
        _advance(p, step, side * CLOSED, side, keeping)
    later = hydraulic_slopes(p, step.after, math.copysign(opening, side))[0]
    _embed(p, scale, share_a, share_b, gain, step.embedded)
    step.moved[:] = 0.0
    for j in range(n + 1):
        for c in range(LOOP):
            nudge = step.embedded[j, c]
            if nudge != 0.0:
                for i in range(n):
                    step.moved[i, c] += step.by_state[i, j] * nudge
    _read(p, scale, gain, later, step)
    law_feedback(loop, x, math.copysign(nominal_current, side), proportional_gain, share_a, share_b, step)


@njit(cache=True)
def _advance(p, step, opening, side, current):
    """The loop's model and its Jacobian over a sample; an opening next to zero is taken on its side."""
    copies.vector(step.after, step.before)
    if p.loop_spool != NONE:
        if abs(opening) < CLOSED:
            step.after[p.loop_spool] = side * CLOSED - p.after
    elif abs(current + p.before + p.after) < CLOSED:
        current = side * CLOSED - p.before - p.after
    machine_code.jacobian(
        p.loop_jacobian_at, p.loop_k, step.after, current, step.reading, step.by_state, step.by_reading
    )


@njit(cache=True)
def _embed(p, scale, share_a, share_b, gain, embedded):
    """Nudges of the loop's states for the first seven coordinates, and of the current in the last column."""
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
    embedded[len(embedded) - 1, INPUT] = 1.0


@njit(cache=True)
def _read(p, scale, gain, later, step):
    """F and G from the nudges a sample later; `gain`, `later`: g before and after the sample."""
    moved, embedded, F, n = step.moved, step.embedded, step.transition, len(step.before)
    area, memory = p.gain[0] * p.area / scale[Q_HYDRAULIC], p.memories[1]
    for c in range(LOOP):
        F[Q_HYDRAULIC, c] = area * (moved[0, c] - p.ratio * moved[1, c])
        if p.loop_spool != NONE:
            spool, before = moved[p.loop_spool, c], embedded[p.loop_spool, c]
        else:
            spool, before = embedded[n, c], scale[Q_SPOOL] / gain if c == Q_SPOOL else 0.0
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
        F[Q_BOX_VELOCITY, c] = (1.0 - memory) / SAMPLE_PERIOD * (moved[2, c] - embedded[2, c]) / scale[Q_BOX_VELOCITY]
    for i in range(LOOP):
        step.push[i], F[i, INPUT] = F[i, INPUT], 0.0
    F[Q_BOX_VELOCITY, Q_BOX_VELOCITY] = memory  # the differentiator's


@njit(cache=True)
def _state_rate(p, x, step):
    """x' over the model's sample, without the readings' noise."""
    rate, before, after = step.state_rate, step.before, step.after
    change_a, change_b = after[0] - before[0], after[1] - before[1]
    rate[HYDRAULIC_FORCE] = p.gain[0] * p.area * (change_a - p.ratio * change_b) / SAMPLE_PERIOD
    rate[LOAD_FORCE] = p.gain[1] * (after[p.loop_cell] - before[p.loop_cell]) / SAMPLE_PERIOD
    rate[PRESSURE_A], rate[PRESSURE_B] = p.gain[2] * change_a / SAMPLE_PERIOD, p.gain[3] * change_b / SAMPLE_PERIOD
    rate[POSITION] = p.gain[4] * (after[2] - before[2]) / SAMPLE_PERIOD
    share, lighter = (1.0 - p.memories[0]) / SAMPLE_PERIOD, (1.0 - p.memories[1]) / SAMPLE_PERIOD
    rate[HYDRAULIC_FORCE_RATE] = share * (rate[HYDRAULIC_FORCE] - x[HYDRAULIC_FORCE_RATE])
    rate[LOAD_FORCE_RATE] = share * (rate[LOAD_FORCE] - x[LOAD_FORCE_RATE])
    rate[VELOCITY] = lighter * (rate[POSITION] - x[VELOCITY])
