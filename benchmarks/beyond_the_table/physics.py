# SPDX-License-Identifier: Apache-2.0
"""What each kind does to the rates and readings of the foreign plant; its memory is the spool's state."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.kinds import NAMES
from benchmarks.foreign_truth.equations import (
    CELL_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    SPOOL,
    VELOCITY,
    flow_gain,
    opening,
    rates,
    root,
    spring,
    stiffness,
)

MEMORY = SPOOL
"""The foreign plant's spool is not used (it follows at once): its state is the kind's."""
(DRAG, FRICTION_POSITION, VALVE_HYSTERESIS, VALVE_CURVE, LEAK_ORIFICE, HOSE, SPRING_HYSTERESIS, CELL_CREEP, SEAL,
 CUSHION, HEAT, SPOOL_RATE, TRANSITION, LEAK_BY_MOTION, MOUNT, CELL_CURVE) = range(len(NAMES))  # fmt: skip


@njit
def drawn(kind, size, shape, current, memory):
    """Current [A] that an ideal valve would have been given."""
    if kind == VALVE_HYSTERESIS:
        return current - size * memory
    if kind == VALVE_CURVE:
        return current * (1.0 - size * abs(current) / shape)
    return memory if kind == SPOOL_RATE else current


@njit
def extra_force(kind, size, shape, bench, state):
    """Force [N] on the piston, beside the load's."""
    position, velocity, memory = state[POSITION], state[VELOCITY], state[MEMORY]
    if kind == DRAG:
        return -size * velocity * abs(velocity)
    if kind == FRICTION_POSITION:
        return -size * ((position - bench.spring_rest_position) / shape) ** 2 * velocity
    if kind == SEAL:
        return -size * abs(state[PRESSURE_A] - state[PRESSURE_B]) * math.tanh(velocity / shape)
    if kind == CUSHION:
        return -size * max(position - shape, 0.0) * velocity
    return -size * math.exp(-memory) * velocity if kind == HEAT else 0.0


@njit
def extra_load(kind, size, bench, state):
    """Force [N] that the load adds to its spring's."""
    if kind == SPRING_HYSTERESIS:
        return size * state[MEMORY]
    if kind == MOUNT:
        return spring(bench, state[POSITION] - state[MEMORY]) - spring(bench, state[POSITION])
    return 0.0


@njit
def lost_flows(kind, size, shape, bench, time, current, state):
    """Flows [m3/s] out of chamber A and out of chamber B."""
    a, b = state[PRESSURE_A], state[PRESSURE_B]
    if kind == LEAK_ORIFICE:
        return size * root(a - b), -size * root(a - b)
    if kind == LEAK_BY_MOTION:
        flow = size * (a - b) * max(math.tanh(state[VELOCITY] / shape), 0.0)
        return flow, -flow
    if kind == HOSE:
        return size * (a - state[MEMORY]) / shape, 0.0
    if kind == TRANSITION:
        moved = flow_gain(bench) * opening(bench, time, current)
        over_a = bench.supply_pressure - a if moved >= 0.0 else a - bench.tank_pressure
        over_b = b - bench.tank_pressure if moved >= 0.0 else bench.supply_pressure - b
        short_a = root(over_a) - over_a / math.sqrt(abs(over_a) + size)
        short_b = root(over_b) - over_b / math.sqrt(abs(over_b) + size)
        return moved * short_a, -moved * short_b
    return 0.0, 0.0


@njit
def memory_rate(kind, size, shape, bench, current, slope, state):
    """Rate of the kind's own state; `slope` is the current's [A/s]."""
    memory, velocity = state[MEMORY], state[VELOCITY]
    if kind == VALVE_HYSTERESIS:
        return (slope - abs(slope) * memory) / shape
    if kind == HOSE:
        return (state[PRESSURE_A] - memory) / shape
    if kind == SPRING_HYSTERESIS:
        return (velocity - abs(velocity) * memory) / shape
    if kind == CELL_CREEP:
        return (bench.piston_area * (state[PRESSURE_A] - bench.area_ratio * state[PRESSURE_B]) - memory) / shape
    if kind == HEAT:
        return abs(velocity) / shape - memory / 10.0
    if kind == SPOOL_RATE:
        return min(max(2.0 * math.pi * shape * (current - memory), -size), size)
    if kind == MOUNT:
        load = spring(bench, state[POSITION] - memory)
        return (size * load / bench.spring_stiffness - memory) / shape
    return 0.0


@njit
def all_rates(kind, size, shape, bench, time, current, slope, state, out):
    """Time derivatives of the states with the kind's physics, dry friction left out."""
    given = drawn(kind, size, shape, current, state[MEMORY])
    rates(bench, time, given, state, out)
    volume_a = bench.dead_volume_a + bench.piston_area * state[POSITION]
    volume_b = bench.dead_volume_b + bench.area_ratio * bench.piston_area * (bench.stroke - state[POSITION])
    lost_a, lost_b = lost_flows(kind, size, shape, bench, time, given, state)
    out[PRESSURE_A] -= stiffness(bench, state[PRESSURE_A]) / volume_a * lost_a
    out[PRESSURE_B] -= stiffness(bench, state[PRESSURE_B]) / volume_b * lost_b
    load = extra_load(kind, size, bench, state)
    out[VELOCITY] += (extra_force(kind, size, shape, bench, state) - load) / bench.moving_mass
    out[CELL_RATE] += (2.0 * math.pi * bench.load_cell_bandwidth) ** 2 * load
    out[MEMORY] = memory_rate(kind, size, shape, bench, current, slope, state)


@njit
def misread(kind, size, bench, state, row):
    """What the kind adds to the hydraulic force's reading in a row."""
    if kind == CELL_CREEP:
        row[0] += size * state[MEMORY]
    if kind == CELL_CURVE:
        row[0] += size * (bench.piston_area * (state[PRESSURE_A] - bench.area_ratio * state[PRESSURE_B])) ** 2
