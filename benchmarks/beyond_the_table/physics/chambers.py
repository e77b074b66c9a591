# SPDX-License-Identifier: Apache-2.0
"""Oil that leaves the chambers by ways that the valve does not know."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    BLOW_BY,
    BORE_WORN_MID,
    BYPASS_GROOVE,
    DAMPER_STUB,
    FLOATING_RING,
    GAP_SILTS,
    GAP_WIDENS,
    HOSE,
    HOSE_CREEP,
    HOSE_WALL_CREEP,
    HOT_LEAK,
    LEAK_BY_MOTION,
    LEAK_ORIFICE,
    LIP_POCKET,
    LIPS_CLOSE,
    LIPS_LIFT,
    MEMORY,
    OIL_EXPANDS,
    PILOT_CHECK,
    PISTON_TILTS,
    PORT_RELIEF,
    PRECHARGED,
    RELIEF_B,
    RELIEF_WEEPS_A,
    ROD_FILM,
    ROD_SCUFFED,
    ROD_SEAL_SCRATCH,
    SCORED_BORE,
    SEAL_WEEPS,
    SLOW_RELIEF,
    TANK_WARMS,
    WEEPING_FITTING,
    WORN_BORE,
    WORN_LAND,
)
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, VELOCITY, root

WORN = 0.045
"""m, where the barrel is worn most."""
WORN_MID = 0.04
"""m, where a bore is worn most by a piston that works about its middle."""
POPPET = 0.04
"""s, lag of a relief valve's poppet."""
FILLED = 0.02
"""s in which a pocket fills over its lip."""
WEEP_TURN = 1e-3
"""m/s over which a seal that comes out begins to weep."""
SILTED = 0.5
"""s in which dirt silts a gap up at rest."""


@njit
def lost_flows(kind, size, shape, bench, time, state):
    """Flows [m3/s] out of chamber A and out of chamber B at a time [s]."""
    a, b, velocity = state[PRESSURE_A], state[PRESSURE_B], state[VELOCITY]
    if kind in (HOSE, HOSE_CREEP, HOSE_WALL_CREEP):
        return size * (a - state[MEMORY]) / shape, 0.0
    if kind in (PORT_RELIEF, RELIEF_WEEPS_A):
        return size * max(a - shape, 0.0), 0.0
    if kind == RELIEF_B:
        return 0.0, size * max(b - shape, 0.0)
    if kind == SEAL_WEEPS:
        return 0.0, size * b * max(math.tanh(velocity / WEEP_TURN), 0.0)
    if kind == ROD_FILM:
        return 0.0, size * bench.area_ratio * bench.piston_area * max(velocity, 0.0)
    if kind in (WEEPING_FITTING, ROD_SEAL_SCRATCH):
        return 0.0, size * root(b - bench.tank_pressure)
    if kind == SLOW_RELIEF:
        return 0.0, size * state[MEMORY]
    if kind == GAP_WIDENS:
        return 0.0, size * max(b - bench.tank_pressure, 0.0) ** 2
    if kind == DAMPER_STUB:
        return 0.0, size * root(b - state[MEMORY])
    if kind == LIPS_CLOSE:
        return 0.0, size * (b - bench.tank_pressure) * max(shape - b, 0.0)
    if kind == WORN_LAND:
        return -size * root(bench.supply_pressure - a), 0.0
    if kind == OIL_EXPANDS:
        return 0.0, -size * math.exp(-time / shape)
    if kind == PILOT_CHECK:
        return 0.0, size * max(a - shape, 0.0) * root(b - bench.tank_pressure)
    if kind == ROD_SCUFFED:
        return 0.0, size * max(shape - state[POSITION], 0.0) * (b - bench.tank_pressure)
    if kind == LIP_POCKET:
        return size * pocket_rate(shape, state), 0.0
    flow = across(kind, size, shape, bench, time, a, b, state)
    return flow, -flow


@njit
def pocket_rate(shape, state):
    """Rate [Pa/s] of the pressure behind a lip that lets oil in only; by another way it leaks back."""
    above = state[PRESSURE_A] - state[MEMORY]
    return above / (FILLED if above > 0.0 else shape)


@njit
def across(kind, size, shape, bench, time, a, b, state):
    """Flow [m3/s] from chamber A to chamber B at a time [s]."""
    if kind == LEAK_ORIFICE:
        return size * root(a - b)
    if kind == LEAK_BY_MOTION:
        return size * (a - b) * max(math.tanh(state[VELOCITY] / shape), 0.0)
    if kind == SCORED_BORE:
        return size * (a - b) if state[POSITION] > shape else 0.0
    if kind == WORN_BORE:
        return size * (a - b) * math.exp(-(((state[POSITION] - WORN) / shape) ** 2))
    if kind == BORE_WORN_MID:
        return size * (a - b) * math.exp(-(((state[POSITION] - WORN_MID) / shape) ** 2))
    if kind == PISTON_TILTS:
        return size * (a - b) * abs(state[POSITION] - bench.spring_rest_position)
    if kind == BLOW_BY:
        return -size * max(b - a - shape, 0.0)
    if kind == FLOATING_RING:
        return size * (a - b) * (1.0 - state[MEMORY] ** 2)
    if kind == TANK_WARMS:
        return size * (a - b) * (1.0 - math.exp(-time / shape))
    if kind == BYPASS_GROOVE:
        return size * max(state[POSITION] - shape, 0.0) * root(a - b)
    if kind == LIPS_LIFT:
        return size * (a - b) * abs(state[VELOCITY])
    return size * (a - b) * state[MEMORY] if kind in (HOT_LEAK, GAP_SILTS) else 0.0


@njit
def compliance(kind, size, shape, state):
    """What chamber B takes [m3/Pa] beside its oil."""
    return size if kind == PRECHARGED and state[PRESSURE_B] > shape else 0.0


@njit
def memory_rate(kind, size, shape, bench, current, state):
    """Rate of the pressure in a hose, damper or pocket or of a late poppet [Pa/s], of warmth, of a ring or a gap."""
    if kind in (HOSE, HOSE_CREEP, HOSE_WALL_CREEP):
        return (state[PRESSURE_A] - state[MEMORY]) / shape
    if kind == HOT_LEAK:
        return (abs(current) / bench.valve_nominal_current - state[MEMORY]) / shape
    if kind == FLOATING_RING:
        return (state[VELOCITY] - abs(state[VELOCITY]) * state[MEMORY]) / shape
    if kind == GAP_SILTS:
        return abs(state[VELOCITY]) * (1.0 - state[MEMORY]) / shape - state[MEMORY] / SILTED
    if kind == DAMPER_STUB:
        return size * root(state[PRESSURE_B] - state[MEMORY]) / shape
    if kind == LIP_POCKET:
        return pocket_rate(shape, state)
    return (max(state[PRESSURE_B] - shape, 0.0) - state[MEMORY]) / POPPET if kind == SLOW_RELIEF else 0.0
