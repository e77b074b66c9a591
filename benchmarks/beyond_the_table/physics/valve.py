# SPDX-License-Identifier: Apache-2.0
"""What an ideal valve would have been given, and flows over its edges that it would have passed."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    COIL_WARMS,
    EDGE_CHOKES,
    JET_FORCE,
    LOAD_NULL,
    MEMORY,
    MOTOR_SATURATES,
    NOTCHED_SPOOL,
    NULL_WARMS,
    PILOT_CLOGGED,
    PORT_COVERED,
    RETURN_FILTER,
    RETURN_POT,
    SILTED_EDGE,
    SPOOL_RATE,
    SPOOL_STOP,
    SUPPLY_SETS,
    TRANSITION,
    VALVE_CURVE,
    VALVE_HYSTERESIS,
    VALVE_RIDES,
)
from benchmarks.foreign_truth.equations import (
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
    flow_gain,
    opening,
    outside,
    root,
    spring,
)

WARM = 5e-3
"""A that warm a coil by 1 in the end."""
HELD = 1e-5
"""m/s, below which dry friction holds the piston."""
NOZZLE = 2e-4
"""s, lag of a pilot whose nozzle is clean."""


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
    if kind == COIL_WARMS:
        return current * (1.0 - size * memory)
    if kind == VALVE_RIDES:
        return current - size * acceleration(bench, state)
    if kind == NOTCHED_SPOOL:
        return current - size * min(max(current, -shape), shape)
    if kind == MOTOR_SATURATES:
        return current / math.sqrt(1.0 + size * (current / shape) ** 2)
    if kind == PILOT_CLOGGED and size > 0.0:
        return memory
    return memory if kind == SPOOL_RATE else current


@njit
def acceleration(bench, state):
    """Acceleration [m/s2] of the piston under the oil, its friction and the spring alone."""
    velocity, area = state[VELOCITY], bench.piston_area
    force = area * (state[PRESSURE_A] - bench.area_ratio * state[PRESSURE_B])
    force -= bench.viscous_friction * velocity + spring(bench, state[POSITION])
    dry = outside(force, bench.coulomb) if abs(velocity) < HELD else force - math.copysign(bench.coulomb, velocity)
    return dry / bench.moving_mass


@njit
def drops(bench, out, state):
    """Pressure [Pa] that each chamber's open edge takes, driving the piston out or in."""
    a, b = state[PRESSURE_A], state[PRESSURE_B]
    if out:
        return bench.supply_pressure - a, b - bench.tank_pressure
    return a - bench.tank_pressure, bench.supply_pressure - b


@njit
def blocked_flows(kind, size, shape, bench, time, current, state):
    """Flows [m3/s] that the edges do not pass: into chamber A and out of chamber B, as `lost_flows` counts them."""
    if kind not in (TRANSITION, RETURN_FILTER, SILTED_EDGE, EDGE_CHOKES, SUPPLY_SETS, RETURN_POT, PORT_COVERED):
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
    if kind == EDGE_CHOKES:
        over = over_b if out else over_a
        short = moved * (root(over) - root(over - size * max(over - shape, 0.0)))
        return (0.0, -short) if out else (short, 0.0)
    if kind == SUPPLY_SETS:
        over = over_a if out else over_b
        short = moved * (root(over) - root(over - size * (1.0 - math.exp(-time / shape))))
        return (short, 0.0) if out else (0.0, -short)
    if kind == PORT_COVERED:
        return size * max(shape - state[POSITION], 0.0) * moved * root(over_a), 0.0
    if kind == RETURN_POT:
        over = over_b if out else over_a
        short = moved * (root(over) - root(over - state[MEMORY]))
        return (0.0, -short) if out else (short, 0.0)
    # q = moved sqrt(over - size q^2), solved for q: only the edge to the tank has the filter behind it
    short = moved * (1.0 - 1.0 / math.sqrt(1.0 + size * moved**2))
    return (0.0, -short * root(over_b)) if out else (short * root(over_a), 0.0)


@njit
def memory_rate(kind, size, shape, bench, current, slope, state):
    """Rate of magnetisation, spool [A/s], warmth of valve or coil, return pressure [Pa/s]; `slope` is in A/s."""
    memory = state[MEMORY]
    if kind == VALVE_HYSTERESIS:
        return (slope - abs(slope) * memory) / shape
    if kind == SPOOL_RATE:
        return min(max(2.0 * math.pi * shape * (current - memory), -size), size)
    if kind == COIL_WARMS:
        return ((current / WARM) ** 2 - memory) / shape
    if kind == RETURN_POT:
        moved = flow_gain(bench) * opening(bench, 0.0, current)
        over = state[PRESSURE_B] if moved >= 0.0 else state[PRESSURE_A]
        return (size * abs(moved * root(over - bench.tank_pressure - memory)) - memory) / shape
    if kind == PILOT_CLOGGED:
        return (current - memory) / (max(size, NOZZLE) if current > memory else NOZZLE)
    return (abs(current) / bench.valve_nominal_current - memory) / shape if kind == NULL_WARMS else 0.0
