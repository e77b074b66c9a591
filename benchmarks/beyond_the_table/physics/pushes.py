# SPDX-License-Identifier: Apache-2.0
"""Forces on the piston that are no friction: springs, weights, fields, jets and what oil drags along."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    CABLE_LOOP_SPRING,
    ECCENTRIC_PINION,
    FLYWEIGHTS,
    HOSE_STIFFENS,
    MEMORY,
    OIL_POT,
    PORT_JET,
    RING_ROLLS,
    ROD_BELLOWS,
    SWITCH_MAGNET,
)
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, VELOCITY

SWITCH = 0.036
"""m, where the switch stands."""


@njit
def push(kind, size, shape, bench, current, state):
    """Force [N] that may give back what it has taken, under a current [A]."""
    position, velocity, memory = state[POSITION], state[VELOCITY], state[MEMORY]
    if kind == ROD_BELLOWS:
        return -size * (position - bench.spring_rest_position - memory)
    if kind == HOSE_STIFFENS:
        return -size * state[PRESSURE_B] * (position - bench.spring_rest_position)
    if kind == SWITCH_MAGNET:
        away = (position - SWITCH) / shape
        return -size * away * math.exp(-(away**2))
    if kind == OIL_POT:
        return -size * (velocity - memory)
    if kind == FLYWEIGHTS:
        return size * velocity**2
    if kind == PORT_JET:
        return size * max(current, 0.0) ** 2 * (bench.supply_pressure - state[PRESSURE_A])
    if kind == RING_ROLLS:
        return -size * state[PRESSURE_B] * memory
    if kind == CABLE_LOOP_SPRING:
        return -size * (position - shape)
    return -size * math.sin(2.0 * math.pi * position / shape) if kind == ECCENTRIC_PINION else 0.0


@njit
def memory_rate(kind, shape, bench, state):
    """Rate of the air in a bellows [m/s], of a pot's velocity [m/s2], of a rolling ring."""
    velocity, memory = state[VELOCITY], state[MEMORY]
    if kind == ROD_BELLOWS:
        return (state[POSITION] - bench.spring_rest_position - memory) / shape
    if kind == RING_ROLLS:
        return (velocity - abs(velocity) * memory) / shape
    return (velocity - memory) / shape if kind == OIL_POT else 0.0
