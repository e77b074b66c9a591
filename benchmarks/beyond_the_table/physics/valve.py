# SPDX-License-Identifier: Apache-2.0
"""What an ideal valve would have been given, and flows over its edges that it would have passed."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    JET_FORCE,
    LOAD_NULL,
    MEMORY,
    NULL_WARMS,
    RETURN_FILTER,
    SILTED_EDGE,
    SPOOL_RATE,
    SPOOL_STOP,
    TRANSITION,
    VALVE_CURVE,
    VALVE_HYSTERESIS,
)
from benchmarks.foreign_truth.equations import PRESSURE_A, PRESSURE_B, flow_gain, opening, root


@njit
def drawn(kind, size, shape, bench, current, state):
    """Current [A] that an ideal valve would have been given."""
    memory = state[MEMORY]
    if kind == VALVE_HYSTERESIS:
        return current - size * memory
    if kind == VALVE_CURVE:
        return current * (1.0 - size * abs(current) / shape)
    if kind == SPOOL_STOP:
        return current - size * max(current - shape, 0.0)
    if kind == NULL_WARMS:
        return current + size * memory
    if kind == JET_FORCE:
        over_a, over_b = drops(bench, current >= 0.0, state)
        return current / (1.0 + size * (over_a + over_b))
    if kind == LOAD_NULL:
        return current - size * (state[PRESSURE_A] - state[PRESSURE_B])
    return memory if kind == SPOOL_RATE else current


@njit
def drops(bench, out, state):
    """Pressure [Pa] that each chamber's open edge takes, driving the piston out or in."""
    a, b = state[PRESSURE_A], state[PRESSURE_B]
    if out:
        return bench.supply_pressure - a, b - bench.tank_pressure
    return a - bench.tank_pressure, bench.supply_pressure - b


@njit
def blocked_flows(kind, size, bench, time, current, state):
    """Flows [m3/s] that the edges do not pass: into chamber A and out of chamber B, as `lost_flows` counts them."""
    if kind != TRANSITION and kind != RETURN_FILTER and kind != SILTED_EDGE:
        return 0.0, 0.0
    moved = flow_gain(bench) * opening(bench, time, current)
    out = moved >= 0.0
    over_a, over_b = drops(bench, out, state)
    if kind == SILTED_EDGE:
        return 0.0, -size * max(moved, 0.0) * root(over_b)
    if kind == TRANSITION:
        short_a = root(over_a) - over_a / math.sqrt(abs(over_a) + size)
        short_b = root(over_b) - over_b / math.sqrt(abs(over_b) + size)
        return moved * short_a, -moved * short_b
    # q = moved sqrt(over - size q^2), solved for q: only the edge to the tank has the filter behind it
    short = moved * (1.0 - 1.0 / math.sqrt(1.0 + size * moved**2))
    return (0.0, -short * root(over_b)) if out else (short * root(over_a), 0.0)


@njit
def memory_rate(kind, size, shape, bench, current, slope, state):
    """Rate of the magnetisation, the spool [A/s] or the warmth of the valve; `slope` is the current's [A/s]."""
    memory = state[MEMORY]
    if kind == VALVE_HYSTERESIS:
        return (slope - abs(slope) * memory) / shape
    if kind == SPOOL_RATE:
        return min(max(2.0 * math.pi * shape * (current - memory), -size), size)
    return (abs(current) / bench.valve_nominal_current - memory) / shape if kind == NULL_WARMS else 0.0
