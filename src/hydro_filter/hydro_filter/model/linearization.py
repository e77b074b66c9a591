# SPDX-License-Identifier: Apache-2.0
"""Compiled linearization of the loop over one sample, by the model's exact Jacobian (`bench_jacobian`)."""

from __future__ import annotations

import math

from hydro_bridge.signals import SAMPLE_PERIOD
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
from hydro_filter.model.observer import hydraulic_slopes, model_state, set_opening
from hydro_filter.model.parts import NONE
from hydro_filter.model.sample import PRESSURE_A
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
