# SPDX-License-Identifier: Apache-2.0
"""What an ideal valve would have been given."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.edges import drops
from benchmarks.beyond_the_table.physics.places import (
    COIL_WARMS,
    DITHER_LEFT,
    FEEDBACK_LINK,
    FLOW_CURVE_BENDS,
    FLUX_CREEPS,
    JET_FORCE,
    LOAD_NULL,
    MEMORY,
    MOTOR_SATURATES,
    NOTCHED_SPOOL,
    NULL_SHIFT,
    NULL_WARMS,
    NULL_WARMS_UP,
    PILOT_CLOGGED,
    PIPE_INERTIA,
    REMANENCE,
    RETURN_POT,
    SPOOL_RATE,
    SPOOL_STOP,
    TORQUE_MOTOR_PLAY,
    VALVE_CURVE,
    VALVE_HYSTERESIS,
    VALVE_PLAY,
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
MAGNETISED = 0.05
"""s in which iron follows a current that is strong enough."""
DRAGGED = 2e-5
"""s in which a current that is further off than its play drags the spool along."""
SHORT_PIPE = 2e-4
"""s, lag of the shortest pipe."""
KEPT = 1e-4
"""s in which it is kept where play has dragged a spool: sooner than the current's next step."""


@njit
def drawn(kind, size, shape, bench, time, current, state):
    """Current [A] that an ideal valve would have been given at a time [s]."""
    memory = state[MEMORY]
    if kind == VALVE_HYSTERESIS:
        return current - size * memory
    if kind == VALVE_CURVE:
        return current * (1.0 - size * abs(current) / shape)
    if kind == SPOOL_STOP:
        return current - size * max(current - shape, 0.0)
    if kind in (NULL_WARMS, REMANENCE):
        return current + size * memory
    if kind == JET_FORCE:
        over_a, over_b = drops(bench, current >= 0.0, state)
        return current / (1.0 + size * (over_a + over_b))
    if kind in (LOAD_NULL, NULL_SHIFT):
        return current - size * (state[PRESSURE_A] - state[PRESSURE_B])
    if kind == COIL_WARMS:
        return current * (1.0 - size * memory)
    if kind == VALVE_RIDES:
        return current - size * acceleration(bench, state)
    if kind == NOTCHED_SPOOL:
        return current - size * min(max(current, -shape), shape)
    if kind == MOTOR_SATURATES:
        return current / math.sqrt(1.0 + size * (current / shape) ** 2)
    if kind == FEEDBACK_LINK:
        return current - size * (state[POSITION] - bench.spring_rest_position)
    if kind == FLUX_CREEPS:
        return current - size * (current - memory)
    if kind == DITHER_LEFT:
        return current + size * math.sin(2.0 * math.pi * time / shape)
    if kind == FLOW_CURVE_BENDS:
        return current / (1.0 + size * abs(current))
    if kind == TORQUE_MOTOR_PLAY:
        return dragged(size, current, memory)
    if kind == NULL_WARMS_UP:
        return current + size * (1.0 - math.exp(-time / shape))
    if kind == PILOT_CLOGGED and size > 0.0:
        return memory
    if kind == VALVE_PLAY and size > 0.0:
        return memory
    return memory if kind == SPOOL_RATE else current


@njit
def dragged(play, current, before):
    """Where [A] a spool stands that had stood elsewhere before and is dragged along behind play of this width."""
    return min(max(before, current - 0.5 * play), current + 0.5 * play)


@njit
def acceleration(bench, state):
    """Acceleration [m/s2] of the piston under the oil, its friction and the spring alone."""
    velocity, area = state[VELOCITY], bench.piston_area
    force = area * (state[PRESSURE_A] - bench.area_ratio * state[PRESSURE_B])
    force -= bench.viscous_friction * velocity + spring(bench, state[POSITION])
    dry = outside(force, bench.coulomb) if abs(velocity) < HELD else force - math.copysign(bench.coulomb, velocity)
    return dry / bench.moving_mass


@njit
def memory_rate(kind, size, shape, bench, current, slope, state):
    """Rate of magnetisation, spool or flux [A/s], of a warmth, of return pressure [Pa/s], of a pipe's flow [m3/s2].

    `slope` is the current's [A/s].
    """
    memory = state[MEMORY]
    if kind == VALVE_HYSTERESIS:
        return (slope - abs(slope) * memory) / shape
    if kind == VALVE_PLAY:
        return outside(current - memory, size) / DRAGGED
    if kind == SPOOL_RATE:
        return min(max(2.0 * math.pi * shape * (current - memory), -size), size)
    if kind == FLUX_CREEPS:
        return (current - memory) / shape
    if kind == REMANENCE:
        return (current - memory) / MAGNETISED if abs(current) > shape else 0.0
    if kind == PIPE_INERTIA:
        moved = flow_gain(bench) * opening(bench, 0.0, current)
        return (moved * root(drops(bench, moved >= 0.0, state)[0]) - memory) / max(size, SHORT_PIPE)
    if kind == TORQUE_MOTOR_PLAY:
        return (dragged(size, current, memory) - memory) / KEPT
    if kind == COIL_WARMS:
        return ((current / WARM) ** 2 - memory) / shape
    if kind == RETURN_POT:
        moved = flow_gain(bench) * opening(bench, 0.0, current)
        over = state[PRESSURE_B] if moved >= 0.0 else state[PRESSURE_A]
        return (size * abs(moved * root(over - bench.tank_pressure - memory)) - memory) / shape
    if kind == PILOT_CLOGGED:
        return (current - memory) / (max(size, NOZZLE) if current > memory else NOZZLE)
    return (abs(current) / bench.valve_nominal_current - memory) / shape if kind == NULL_WARMS else 0.0
