# SPDX-License-Identifier: Apache-2.0
"""Rates of the foreign plant's states with one kind of unnamed physics."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics import chambers, edges, load, motion, pushes, sensors, valve
from benchmarks.beyond_the_table.physics.places import (
    DAMPER_STUB,
    FILM_SQUEEZED,
    GAUGE_SNUBBER,
    HOSE,
    HOSE_CREEP,
    HOSE_WALL_CREEP,
    LIP_POCKET,
    LIP_RELAXES,
    MEMORY,
)
from benchmarks.foreign_truth.equations import (
    CELL_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
    rates,
    stiffness,
)


@njit
def rested(kind, bench, start):
    """The kind's own state where chamber A has stood at a pressure [Pa] and B balances it."""
    if kind in (GAUGE_SNUBBER, DAMPER_STUB, LIP_RELAXES):
        return start / bench.area_ratio
    if kind == FILM_SQUEEZED:
        return 1.0
    return start if kind in (HOSE, HOSE_CREEP, LIP_POCKET, HOSE_WALL_CREEP) else 0.0


@njit
def memory_rate(kind, size, shape, bench, current, slope, state):
    """Rate of the kind's own state; `slope` is the current's [A/s]."""
    rate = valve.memory_rate(kind, size, shape, bench, current, slope, state)
    rate += chambers.memory_rate(kind, size, shape, bench, current, state)
    rate += motion.memory_rate(kind, shape, state) + pushes.memory_rate(kind, shape, bench, state)
    rate += load.memory_rate(kind, size, shape, bench, state)
    return rate + sensors.memory_rate(kind, size, shape, bench, state)


@njit
def all_rates(kind, size, shape, bench, time, current, slope, state, out):
    """Time derivatives of the states with the kind's physics, dry friction left out."""
    given = valve.drawn(kind, size, shape, bench, time, current, state)
    rates(bench, time, given, state, out)
    volume_a = bench.dead_volume_a + bench.piston_area * state[POSITION]
    volume_b = bench.dead_volume_b + bench.area_ratio * bench.piston_area * (bench.stroke - state[POSITION])
    lost_a, lost_b = chambers.lost_flows(kind, size, shape, bench, time, state)
    blocked_a, blocked_b = edges.blocked_flows(kind, size, shape, bench, time, given, state)
    out[PRESSURE_A] -= stiffness(bench, state[PRESSURE_A]) / volume_a * (lost_a + blocked_a)
    out[PRESSURE_B] -= stiffness(bench, state[PRESSURE_B]) / volume_b * (lost_b + blocked_b)
    taken = chambers.compliance(kind, size, shape, state)
    out[PRESSURE_B] /= 1.0 + taken * stiffness(bench, state[PRESSURE_B]) / volume_b
    added = load.extra_load(kind, size, shape, bench, time, state)
    pushed = motion.extra_force(kind, size, shape, bench, time, given, state)
    out[VELOCITY] += (pushed - added) / bench.moving_mass
    carried = load.mass(kind, size)
    out[VELOCITY] *= bench.moving_mass / (bench.moving_mass + carried)
    out[CELL_RATE] += (2.0 * math.pi * bench.load_cell_bandwidth) ** 2 * (added + carried * out[VELOCITY])
    out[MEMORY] = memory_rate(kind, size, shape, bench, current, slope, state)
