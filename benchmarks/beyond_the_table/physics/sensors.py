# SPDX-License-Identifier: Apache-2.0
"""Readings that are not what they read."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    BARREL_STRETCHES,
    BRIDGE_SAGS,
    CABLE_SWINGS,
    CELL_BYPASS,
    CELL_CREEP,
    CELL_CURVE,
    CELL_GAIN_WARMS,
    CELL_HOLDS,
    CELL_HYSTERESIS,
    CELL_PICKUP,
    CELL_RANGES,
    CELL_RECTIFIES,
    CELL_SEATS,
    CELL_SLEW,
    CELL_ZERO_WARMS,
    COUNTS_LOST,
    ENCODER_FLEX,
    ENCODER_PLAY,
    GAUGE_COARSE,
    GAUGE_CROSSTALK,
    GAUGE_LIMIT,
    GAUGE_SNUBBER,
    GAUGE_SPAN_B,
    GAUGE_WARMS,
    LOAD_CELL_BOW,
    MEMORY,
    SCALE_RIPPLE,
    THROAT_TAPPED,
)
from benchmarks.foreign_truth.box import PERIOD
from benchmarks.foreign_truth.equations import (
    CELL,
    CELL_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
    outside,
    spring,
)

RISING = 5e-4
"""s, lag of a snubber whose check valve is open."""
INPUT = 5e-4
"""s, lag of an input that nothing has limited."""
LATE = 1e-6
"""Share of a period by which a conversion may be early: times are sums of steps."""


@njit
def hydraulic_force(bench, state):
    """Force [N] of both pressures."""
    return bench.piston_area * (state[PRESSURE_A] - bench.area_ratio * state[PRESSURE_B])


@njit
def misread(kind, size, shape, bench, time, current, state, row):
    """Add to a row's readings what the kind does to them; `current` [A] acts while they are taken.

    A converter's last value is a state that changes here alone.
    """
    if kind == CELL_CREEP:
        row[0] += size * state[MEMORY]
    if kind == CELL_CURVE:
        row[0] += size * hydraulic_force(bench, state) ** 2
    if kind == CELL_PICKUP:
        row[0] += size * current
    if kind == GAUGE_WARMS:
        row[5] += size * (1.0 - math.exp(-time / shape))
    if kind == GAUGE_SNUBBER and size > 0.0:
        row[5] += state[MEMORY] - state[PRESSURE_B]
    if kind == CELL_BYPASS:
        row[2] += size * max(-state[CELL], 0.0)
    if kind == GAUGE_LIMIT:
        row[5] -= size * max(state[PRESSURE_B] - shape, 0.0)
    if kind == ENCODER_PLAY:
        row[6] -= size * state[MEMORY]
    if kind == ENCODER_FLEX:
        row[6] += size * spring(bench, state[POSITION])
    if kind == CELL_ZERO_WARMS:
        row[2] += size * (1.0 - math.exp(-time / shape))
    if kind == COUNTS_LOST:
        row[6] -= state[MEMORY]
    if kind == CABLE_SWINGS:
        row[2] += size * state[VELOCITY]
    if kind == THROAT_TAPPED:
        row[4] -= size * max(state[VELOCITY], 0.0) ** 2
    if kind == BRIDGE_SAGS:
        row[0] -= size * abs(current) / bench.valve_nominal_current * hydraulic_force(bench, state)
    if kind == CELL_HYSTERESIS:
        row[2] += size * state[MEMORY]
    if kind == GAUGE_CROSSTALK:
        row[5] += size * state[PRESSURE_A]
    if kind == CELL_RECTIFIES:
        row[0] += size * current**2
    if kind == CELL_SEATS:
        row[2] -= size * min(max(state[CELL], -shape), shape)
    if kind == GAUGE_COARSE and size > 0.0:
        row[5] += size * math.floor(state[PRESSURE_B] / size + 0.5) - state[PRESSURE_B]
    if kind == CELL_GAIN_WARMS:
        row[0] += size * (1.0 - math.exp(-time / shape)) * hydraulic_force(bench, state)
    if kind == BARREL_STRETCHES:
        row[6] -= size * state[PRESSURE_B]
    if kind == CELL_RANGES and abs(state[CELL]) > shape:
        row[2] += size * state[CELL]
    if kind == LOAD_CELL_BOW:
        row[2] += size * state[CELL] ** 2
    if kind == GAUGE_SPAN_B:
        row[5] += size * state[PRESSURE_B]
    if kind == SCALE_RIPPLE:
        row[6] += size * math.sin(2.0 * math.pi * state[POSITION] / shape)
    if kind == CELL_HOLDS and size > 0.0:
        if math.floor(time / size + LATE) > math.floor((time - PERIOD) / size + LATE):
            state[MEMORY] = hydraulic_force(bench, state)
        row[0] += state[MEMORY] - hydraulic_force(bench, state)
    if kind == CELL_SLEW and size > 0.0:
        row[0] += state[MEMORY] - hydraulic_force(bench, state)


@njit
def memory_rate(kind, size, shape, bench, state):
    """Rate of what a cell has crept by or shows [N/s], of pressure [Pa/s], of a path, of misses [m/s]."""
    if kind == CELL_CREEP:
        return (hydraulic_force(bench, state) - state[MEMORY]) / shape
    if kind == GAUGE_SNUBBER:
        above = state[PRESSURE_B] - state[MEMORY]
        return above / (RISING if above > 0.0 else max(size, RISING))
    if kind == CELL_SLEW:
        return min(max((hydraulic_force(bench, state) - state[MEMORY]) / INPUT, -size), size)
    if kind == COUNTS_LOST:
        return size * outside(state[VELOCITY], shape)
    if kind == ENCODER_PLAY:
        return (state[VELOCITY] - abs(state[VELOCITY]) * state[MEMORY]) / shape
    if kind == CELL_HYSTERESIS:
        return (state[CELL_RATE] - abs(state[CELL_RATE]) * state[MEMORY]) / shape
    return 0.0
