# SPDX-License-Identifier: Apache-2.0
"""Model monitor: detects from one-step prediction errors whether the model still fits the bench.

Of three consecutive samples the middle one gives the model's state, and the outer two its change. The equations are
then independent, and none contains the lag of the box's velocity. Their errors, T = 1 ms::

    load             f_l - (gain F + bias)        F: the spring's force at x_p, behind the load cell's amplifier     N
    motion           m (x_p'' - model's)          x_p'' of three positions                                           N
    hydraulic force  f_h - (A p_a - alpha A p_b), with the cell's gain and bias                                      N
    chamber a, b     (p_next - p_last) / 2 - T p'                                                                  Pa

The test is a two-sided CUSUM (Page, Biometrika 41, 1954) of each error relative to its allowance::

    z = error / (ALLOWED + SHARE size), within +-CLIP       up = max(0, up + z - 1)     down = max(0, down - z - 1)

A sum above `ALARM` means that the equation does not hold. A learned model has small lasting errors (friction, leakage,
temperature) and large ones for some milliseconds (a spool at its rate limit): the allowance covers the former, the clip
the latter. Sensor noise is far below both: in the mean over the 50 samples of an alarm 0.1 N of load, 0.3 N of motion,
0.2 N of hydraulic force, 85 Pa of a chamber. Noise alone therefore raises no alarm.

An alarm persists until the equations have held for `RETURN` samples that excite the bench at least half as much as when
it was raised: neither a gap nor a new arming ends it. Measurements: safety.md.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba.extending import overload

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.controller import bench_errors
from hydro_filter.model.bench_parts import BENCH_MEMORY_DTYPE, BenchLoop
from hydro_filter.model.hidden_states import BRISTLE_STATE, HIDDEN, SPOOL, SPOOL_RATE, lag
from hydro_filter.model.loop import Loop, is_bench_file_loop
from hydro_filter.model.state import HYDRAULIC_FORCE, LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B
from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq
from hydro_sim.structured import physics, rollout
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.physics import (
    AREA,
    BIAS_H,
    BIAS_L,
    CELL_DAMPING,
    CELL_OMEGA,
    GAIN_H,
    GAIN_L,
    MASS,
    RATIO,
    REST,
    SPRING,
)  # fmt: skip
from hydro_sim.structured.rollout import INPUTS, OUTPUTS

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

ALLOWED: FloatArray = np.array([7.5, 15.0, 12.0, 3e3, 3e3])
"""N, N, N, Pa, Pa in a sample: 2.5 % of 300 N; dry friction; a cell's drift; 0.03 l/min."""
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
        ("last", np.float64, (5,)), ("middle", np.float64, (5,)), ("hidden", np.float64, (HIDDEN,)),
        ("cell", np.float64), ("cell_rate", np.float64), ("seen", np.int64),
        ("sums", np.float64, (COUNT, 2)), ("runs", np.int64, (COUNT, 2)),
        ("broken", np.int64), ("ratio", np.float64), ("effort", np.float64), ("held", np.int64),
    ],
    align=True,
)  # fmt: skip
"""What is remembered of one bench: readings of the last two samples, hidden states of the middle one, the load cell's
amplifier, the sums and for how long each is above zero; which equation is broken (1 + its place, 0: none), how many
times what is allowed it was off, what moved then, and for how many samples the equations have held since."""


BENCH_MONITOR_DTYPE = np.dtype(
    [
        (name, BENCH_MEMORY_DTYPE["hidden"]) if name == "hidden" else (name, MONITOR_DTYPE[name])
        for name in MONITOR_DTYPE.names or ()
    ],
    align=True,
)
"""The same with the states that a bench file's model has."""


def monitor_of(loop: Loop) -> npt.NDArray[np.void]:
    """Return a new monitor, shape (1,)."""
    return np.zeros(1, BENCH_MONITOR_DTYPE if isinstance(loop, BenchLoop) else MONITOR_DTYPE)


@njit
def reset(m):
    """Reset at the start or after a gap; a reported fault is kept. `m`: one record of `MONITOR_DTYPE`."""
    m.seen = m.held = 0
    m.sums[:] = 0.0
    m.runs[:] = 0


@njit
def update(model, limit, m, x, hidden):
    """Process sample x, shape (8,), with its hidden states (3,); `limit` scales the allowed errors.

    `model` is `StructuredModel.compiled`, or a bench file's `BenchParts`. `m.broken` afterwards says which equation
    does not hold.
    """
    _show(model, m, x, hidden)
    if m.seen > SETTLING:
        _judge(model, limit, m, x)
    m.seen += 1
    copies.vector(m.last, m.middle)
    m.middle[F_H], m.middle[F_L], m.middle[X_P] = x[HYDRAULIC_FORCE], x[LOAD_FORCE], x[POSITION]
    m.middle[P_A], m.middle[P_B] = x[PRESSURE_A], x[PRESSURE_B]
    copies.vector(m.hidden, hidden)


def _show(model, m, x, hidden):
    raise NotImplementedError("compiled code only")


@overload(_show, inline="always")
def _shown(model, m, x, hidden):
    return (bench_errors.load_cell_reading if is_bench_file_loop(model) else amplifier_reading).py_func


def _errors(model, m, x, error, size):
    raise NotImplementedError("compiled code only")


@overload(_errors, inline="always")
def _found(model, m, x, error, size):
    return (bench_errors.errors if is_bench_file_loop(model) else errors).py_func


@njit
def amplifier_reading(model, m, x, hidden):
    """Return the output of the load cell's amplifier at the middle sample."""
    c = model[0]
    if m.seen == 0:
        m.cell, m.cell_rate = (x[LOAD_FORCE] - c[BIAS_L]) / c[GAIN_L], 0.0
    elif m.seen > 1:
        spring = c[SPRING] * (0.5 * (m.last[X_P] + m.middle[X_P]) - c[REST])
        m.cell, m.cell_rate = lag(c[CELL_OMEGA], c[CELL_DAMPING], spring, m.cell, m.cell_rate)


@njit
def errors(model, m, x, error, size):
    """Return each equation's error at the middle sample and the scale of its left-hand side; both shape (5,)."""
    c, layers, center, scale, _ = model
    s, slope, inputs, r = np.empty(STATES), np.empty(8), np.empty(INPUTS), np.empty(OUTPUTS)
    first, second = np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    readings, position = m.middle, m.middle[X_P]
    speed = (x[POSITION] - m.last[X_P]) / (2.0 * SAMPLE_PERIOD)
    s[0], s[1], s[2], s[3] = readings[P_A], readings[P_B], position, speed
    s[4], s[5], s[6], s[7], s[8] = m.hidden[SPOOL], m.hidden[SPOOL_RATE], m.cell, m.cell_rate, m.hidden[BRISTLE_STATE]
    rollout.residual(layers, center, scale, s, inputs, first, second, r)
    physics.rates(c, s[:8], s[8], 0.0, r, slope)
    bend = (x[POSITION] - 2.0 * position + m.last[X_P]) / SAMPLE_PERIOD**2
    pushed = c[GAIN_H] * c[AREA] * (s[0] - c[RATIO] * s[1])
    error[0] = readings[F_L] - c[GAIN_L] * m.cell - c[BIAS_L]
    error[1] = c[MASS] * (bend - slope[3])
    error[2] = readings[F_H] - pushed - c[BIAS_H]
    error[3] = 0.5 * (x[PRESSURE_A] - m.last[P_A]) - SAMPLE_PERIOD * slope[0]
    error[4] = 0.5 * (x[PRESSURE_B] - m.last[P_B]) - SAMPLE_PERIOD * slope[1]
    stiff = physics.stiffnesses(c, position)
    displaced_a, displaced_b = eq.pressure_rates(physics.numbers(c), stiff, (0.0, 0.0), SAMPLE_PERIOD * abs(speed))
    size[0] = abs(c[GAIN_L] * m.cell)
    size[1] = abs(c[SPRING] * (position - c[REST]))
    size[2] = abs(pushed)
    size[3] = SAMPLE_PERIOD * abs(slope[0]) - displaced_a
    size[4] = SAMPLE_PERIOD * abs(slope[1]) + displaced_b


@njit
def _judge(model, limit, m, x):
    """Update the sums and the alarm."""
    error, size = np.empty(COUNT), np.empty(COUNT)
    _errors(model, m, x, error, size)
    highest = 0.0
    for i in range(COUNT):
        z = min(max(error[i] / (limit * (ALLOWED[i] + SHARE * size[i])), -CLIP), CLIP)
        for side in range(2):
            total = min(max(m.sums[i, side] + (z if side == 0 else -z) - 1.0, 0.0), 2.0 * ALARM)
            m.sums[i, side] = total
            m.runs[i, side] = m.runs[i, side] + 1 if total > 0.0 else 0
            highest = max(highest, total)
            if total > ALARM and m.broken == 0:
                m.broken, m.held = i + 1, 0
                m.ratio, m.effort = 1.0 + total / m.runs[i, side], max(0.5 * size[i], limit * ALLOWED[i])
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
