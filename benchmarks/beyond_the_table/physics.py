# SPDX-License-Identifier: Apache-2.0
"""What each kind does to the foreign plant; `kinds` says it in words."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.kinds import NAMES
from benchmarks.foreign_truth.equations import (
    CELL,
    CELL_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    SPOOL,
    VELOCITY,
    flow_gain,
    opening,
    outside,
    rates,
    root,
    rub,
    spring,
    stiffness,
)

MEMORY = SPOOL
"""The foreign plant's spool follows at once where a kind is there: its state is the kind's."""
(ROD_SEAL, SIDE_LOAD, TIGHT_SPOT, TURBULENT_DRAG, RELIEF_B, SCORED_BORE, HOSE_CREEP, SEAL_WEEPS, VALVE_PLAY, NULL_SHIFT,
 SUPPLY_HUNTS, SPRING_GUIDE, CARRIAGE, COIL_CONTACT, ENCODER_FLEX, CELL_ZERO_WARMS, SEAL_FILM_DRAG, PISTON_LIP_FRICTION,
 ASKEW_LOAD_FRICTION, CABLE_LOOP_SPRING, ROD_SEAL_SCRATCH, HOSE_WALL_CREEP, BORE_WORN_MID, RELIEF_WEEPS_A,
 FLOW_CURVE_BENDS, TORQUE_MOTOR_PLAY, NULL_WARMS_UP, COILS_TOUCH, SPRING_PLATE_MASS, SPRING_RUBS_GUIDE, LOAD_CELL_BOW,
 GAUGE_SPAN_B) = range(len(NAMES))  # fmt: skip
SPOT, SPOT_TURN = 2e-3, 3e-3
"""m about a tight spot of the bore; m/s over which its friction turns its sign round."""
DRY_TURN = 5e-3
"""m/s over which the friction of a piston's lips or of a guide under a load askew turns its sign round."""
FILM_SLOW = 1e-4
"""m/s below which a film's drag is in proportion, lest its root be steep without end."""
WORN_MID = 0.04
"""m, where a bore is worn most by a piston that works about its middle."""
WEEP_TURN = 1e-3
"""m/s over which a seal that comes out begins to weep."""
DRAGGED = 2e-5
"""s in which a current that is further off than its play drags the spool along."""
KEPT = 1e-4
"""s in which it is kept where play has dragged a spool: sooner than the current's next step."""


@njit
def force(kind, size, shape, bench, state):
    """Force [N] on the piston that the load does not see."""
    a, b, position, velocity = state[PRESSURE_A], state[PRESSURE_B], state[POSITION], state[VELOCITY]
    if kind == TURBULENT_DRAG:
        return -size * velocity * abs(velocity)
    if kind == ROD_SEAL:
        return -size * b * math.tanh(velocity / shape)
    if kind == SIDE_LOAD:
        return -size * abs(spring(bench, position)) * math.tanh(velocity / shape)
    if kind == TIGHT_SPOT:
        return -size * math.exp(-(((position - shape) / SPOT) ** 2)) * math.tanh(velocity / SPOT_TURN)
    if kind == SEAL_FILM_DRAG:
        return -size * velocity / math.sqrt(abs(velocity) + FILM_SLOW)
    if kind == PISTON_LIP_FRICTION:
        return -size * abs(a - b) * math.tanh(velocity / DRY_TURN)
    if kind == ASKEW_LOAD_FRICTION:
        return -size * abs(spring(bench, position)) * math.tanh(velocity / DRY_TURN)
    return -size * (position - shape) if kind == CABLE_LOOP_SPRING else 0.0


@njit
def extra_load(kind, size, shape, bench, state):
    """Force [N] that the load adds to its spring's, but for a mass of its own."""
    position, velocity = state[POSITION], state[VELOCITY]
    if kind in (COIL_CONTACT, COILS_TOUCH):
        return size * max(position - shape, 0.0)
    if kind == SPRING_RUBS_GUIDE:
        return size * abs(position - bench.spring_rest_position) * math.tanh(velocity / shape)
    return size * math.tanh(velocity / shape) if kind == SPRING_GUIDE else 0.0


@njit
def mass(kind, size):
    """Mass [kg] that the load's cell accelerates."""
    return size if kind in (CARRIAGE, SPRING_PLATE_MASS) else 0.0


@njit
def lost_flows(kind, size, shape, bench, state):
    """Flows [m3/s] out of chamber A and out of chamber B."""
    a, b, position = state[PRESSURE_A], state[PRESSURE_B], state[POSITION]
    if kind in (HOSE_CREEP, HOSE_WALL_CREEP):
        return size * (a - state[MEMORY]) / shape, 0.0
    if kind == RELIEF_WEEPS_A:
        return size * max(a - shape, 0.0), 0.0
    if kind == RELIEF_B:
        return 0.0, size * max(b - shape, 0.0)
    if kind == SEAL_WEEPS:
        return 0.0, size * b * max(math.tanh(state[VELOCITY] / WEEP_TURN), 0.0)
    if kind == ROD_SEAL_SCRATCH:
        return 0.0, size * root(b - bench.tank_pressure)
    across = 0.0
    if kind == SCORED_BORE and position > shape:
        across = size * (a - b)
    if kind == BORE_WORN_MID:
        across = size * (a - b) * math.exp(-(((position - WORN_MID) / shape) ** 2))
    return across, -across


@njit
def hunted_flows(size, shape, bench, time, current, state):
    """Flows [m3/s] that a supply that hunts does not give: into chamber A and out of chamber B."""
    moved = flow_gain(bench) * opening(bench, time, current)
    over = bench.supply_pressure - (state[PRESSURE_A] if moved >= 0.0 else state[PRESSURE_B])
    short = moved * (root(over) - root(over + size * math.sin(2.0 * math.pi * shape * time)))
    return (short, 0.0) if moved >= 0.0 else (0.0, -short)


@njit
def drawn(kind, size, shape, time, current, state):
    """Current [A] that an ideal valve would have been given."""
    if kind == VALVE_PLAY and size > 0.0:
        return state[MEMORY]
    if kind == NULL_SHIFT:
        return current - size * (state[PRESSURE_A] - state[PRESSURE_B])
    if kind == FLOW_CURVE_BENDS:
        return current / (1.0 + size * abs(current))
    if kind == TORQUE_MOTOR_PLAY:
        return dragged(size, current, state[MEMORY])
    return current + size * (1.0 - math.exp(-time / shape)) if kind == NULL_WARMS_UP else current


@njit
def dragged(play, current, before):
    """Where [A] a spool stands that had stood elsewhere before and is dragged along behind play of this width."""
    return min(max(before, current - 0.5 * play), current + 0.5 * play)


@njit
def memory_rate(kind, size, shape, current, state):
    """Rate of the kind's own state."""
    if kind in (HOSE_CREEP, HOSE_WALL_CREEP):
        return (state[PRESSURE_A] - state[MEMORY]) / shape
    if kind == VALVE_PLAY:
        return outside(current - state[MEMORY], size) / DRAGGED
    return (dragged(size, current, state[MEMORY]) - state[MEMORY]) / KEPT if kind == TORQUE_MOTOR_PLAY else 0.0


@njit
def rested(kind, start):
    """The kind's own state where chamber A has stood at a pressure [Pa]."""
    return start if kind in (HOSE_CREEP, HOSE_WALL_CREEP) else 0.0


@njit
def misread(kind, size, shape, bench, time, state, row):
    """Add to a row's readings what the kind does to them."""
    if kind == ENCODER_FLEX:
        row[6] += size * spring(bench, state[POSITION])
    if kind == CELL_ZERO_WARMS:
        row[2] += size * (1.0 - math.exp(-time / shape))
    if kind == LOAD_CELL_BOW:
        row[2] += size * state[CELL] ** 2
    if kind == GAUGE_SPAN_B:
        row[5] += size * state[PRESSURE_B]


@njit
def brake(kind, size, bench, state, seconds):
    """Let the piston's dry friction act for a while on the load's mass too: its cell reads that."""
    before, carried = state[VELOCITY], mass(kind, size)
    rub(bench, state, seconds * bench.moving_mass / (bench.moving_mass + carried))
    corner = 2.0 * math.pi * bench.load_cell_bandwidth
    state[CELL_RATE] += corner**2 * carried * (state[VELOCITY] - before)


@njit
def all_rates(physics, bench, time, current, state, out):
    """Time derivatives of the states with a kind's physics (kind, size, shape), dry friction left out."""
    kind, size, shape = physics
    if kind < 0:
        rates(bench, time, current, state, out)
        return
    given = drawn(kind, size, shape, time, current, state)
    rates(bench, time, given, state, out)
    volume_a = bench.dead_volume_a + bench.piston_area * state[POSITION]
    volume_b = bench.dead_volume_b + bench.area_ratio * bench.piston_area * (bench.stroke - state[POSITION])
    if kind == SUPPLY_HUNTS:
        lost_a, lost_b = hunted_flows(size, shape, bench, time, given, state)
    else:
        lost_a, lost_b = lost_flows(kind, size, shape, bench, state)
    out[PRESSURE_A] -= stiffness(bench, state[PRESSURE_A]) / volume_a * lost_a
    out[PRESSURE_B] -= stiffness(bench, state[PRESSURE_B]) / volume_b * lost_b
    added, carried = extra_load(kind, size, shape, bench, state), mass(kind, size)
    out[VELOCITY] += (force(kind, size, shape, bench, state) - added) / bench.moving_mass
    out[VELOCITY] *= bench.moving_mass / (bench.moving_mass + carried)
    out[CELL_RATE] += (2.0 * math.pi * bench.load_cell_bandwidth) ** 2 * (added + carried * out[VELOCITY])
    out[MEMORY] = memory_rate(kind, size, shape, current, state)
