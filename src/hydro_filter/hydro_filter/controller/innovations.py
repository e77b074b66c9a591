# SPDX-License-Identifier: Apache-2.0
"""Model monitor: detects from one-step prediction errors whether the model still fits the bench.

Of three consecutive samples the middle one gives the model's state, and the outer two its change. The predicted load is
the simulated state of its amplifier. Static friction may have any force up to its level, and nobody knows how bristles
are bent at the start: below `ModelParts.creep` the best-fitting force is used. Behind a lagging sensor, a chamber's
error is what the observer corrects of its pressure in a sample. The equations are then independent, and none contains
the lag of the box's velocity. Their errors, T = 1 ms::

    load             f_l - (gain F + bias)        F: the spring's force at x_p, behind the load cell's amplifier     N
    motion           m (x_p'' - model's)          x_p'' of three positions                                           N
    hydraulic force  f_h - (A p_a - alpha A p_b), with the cell's gain and bias                                      N
    chamber a, b     (p_next - p_last) / 2 - T p'                                                                  Pa

The test is a two-sided CUSUM (Page, Biometrika 41, 1954) of each error relative to its allowance::

    z = error / (allowed + SHARE size), within +-CLIP       up = max(0, up + z - 1)     down = max(0, down - z - 1)

A sum above `ALARM` means that the equation does not hold. A learned model has small lasting errors (friction, leakage,
temperature) and large ones for some milliseconds (a spool at its rate limit): the allowance covers the former, the clip
the latter. Sensor noise is far below both: in the mean over the 50 samples of an alarm 0.1 N of load, 0.3 N of motion,
0.2 N of hydraulic force, 85 Pa of a chamber. Noise alone therefore raises no alarm.

An alarm persists until the equations have held for `RETURN` samples that excite the bench at least half as much as when
it was raised: neither a gap nor a new arming ends it. Measurements: safety.md.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hydro_core.signals import SAMPLE_PERIOD
from hydro_filter.model.observer import held_rates, hydraulic_slopes, model_state
from hydro_filter.model.parts import MEMORY_DTYPE, NONE
from hydro_filter.model.sample import HYDRAULIC_FORCE, LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATES
from hydro_sim.jit import copy_vector, njit

EQUATIONS = ("load", "motion", "hydraulic force", "chamber a", "chamber b")
SUSPECTS = (
    "the spring or its load cell",
    "mass, friction or spring",
    "the piston's area or the load cell of f_h",
    "valve, supply, oil or area",
    "valve, supply, oil or area",
)
"""Cause of a violation of each equation."""
COUNT = len(EQUATIONS)

SHARE = 0.05
"""Further allowance, as a share of the equation's terms: the accuracy of learning, sufficient for the certificate."""
CLIP = 5.0
ALARM = 50.0
"""Samples at twice the allowance; a larger error takes fewer, at least 13."""
RETURN = 3000
"""Samples, 3 s."""
SETTLING = 100
"""Samples after a gap until the simulated spool and amplifier have converged."""

F_H, F_L, P_A, P_B, X_P = range(5)

MONITOR_DTYPE = np.dtype(
    [
        ("last", np.float64, (5,)), ("middle", np.float64, (5,)), ("hidden", MEMORY_DTYPE["hidden"]),
        ("cell", np.float64), ("seen", np.int64),
        ("sums", np.float64, (COUNT, 2)), ("runs", np.int64, (COUNT, 2)),
        ("broken", np.int64), ("ratio", np.float64), ("effort", np.float64), ("held", np.int64),
    ],
    align=True,
)  # fmt: skip
"""What is remembered of one bench: readings of the last two samples, hidden states of the middle one, what the load
cell shows there, the sums and for how long each is above zero; which equation is broken (1 + its place, 0: none), how
many times what is allowed it was off, what moved then, and for how many samples the equations have held since."""


def monitors(count: int = 1) -> npt.NDArray[np.void]:
    """Return new monitors of `count` benches, shape (count,)."""
    return np.zeros(count, MONITOR_DTYPE)


@njit
def reset(m):
    """Reset at the start or after a gap; a reported fault is kept. `m`: one record of `MONITOR_DTYPE`."""
    m.seen = m.held = 0
    m.sums[:] = 0.0
    m.runs[:] = 0


@njit
def update(model, limit, m, x, hidden):
    """Process sample x, shape (8,), with its hidden states (a memory's); `limit` scales the allowed errors.

    `model` is `Loop.model`. `m.broken` afterwards says which equation
    does not hold.
    """
    m.cell = m.hidden[model.cell]
    if model.spool == NONE:  # a valve without lag steps at the middle sample: its mean is used
        m.hidden[len(model.rest)] = 0.5 * (m.hidden[len(model.rest)] + hidden[len(model.rest)])
    if m.seen > SETTLING:
        _judge(model, limit, m, x)
    m.seen += 1
    copy_vector(m.last, m.middle)
    m.middle[F_H], m.middle[F_L], m.middle[X_P] = x[HYDRAULIC_FORCE], x[LOAD_FORCE], x[POSITION]
    m.middle[P_A], m.middle[P_B] = x[PRESSURE_A], x[PRESSURE_B]
    copy_vector(m.hidden, hidden)


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
    if p.level > 0.0 and abs(speed) < p.creep:
        y[3] = state[3] = math.copysign(p.creep, speed)
        held_rates(p, y, opening, True, slopes)
        whole = slopes[3]
        held_rates(p, state, 0.0, False, slopes)
        level = max(p.level, p.mass * abs(slopes[3] - whole))
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


@njit
def _judge(model, limit, m, x):
    """Update the sums and the alarm."""
    error, size = np.empty(COUNT), np.empty(COUNT)
    errors(model, m, x, error, size)
    highest = 0.0
    for i in range(COUNT):
        z = min(max(error[i] / (limit * (model.allowed[i] + SHARE * size[i])), -CLIP), CLIP)
        for side in range(2):
            total = min(max(m.sums[i, side] + (z if side == 0 else -z) - 1.0, 0.0), 2.0 * ALARM)
            m.sums[i, side] = total
            m.runs[i, side] = m.runs[i, side] + 1 if total > 0.0 else 0
            highest = max(highest, total)
            if total > ALARM and m.broken == 0:
                m.broken, m.held = i + 1, 0
                m.ratio, m.effort = 1.0 + total / m.runs[i, side], max(0.5 * size[i], limit * model.allowed[i])
    if m.broken != 0:
        moved = size[m.broken - 1] >= m.effort
        m.held = 0 if highest > 0.5 * ALARM else m.held + moved
        if m.held >= RETURN:
            m.broken = 0


def sentence(m: np.void) -> str:
    """Return which equation is violated, and by how much; empty if none is."""
    if not m["broken"]:
        return ""
    place = int(m["broken"]) - 1
    name, suspects = EQUATIONS[place], SUSPECTS[place]
    return f"the model's {name} ({suspects}) is off by {m['ratio']:.1f} times what is allowed"
