# SPDX-License-Identifier: Apache-2.0
"""Forces of the load: its cell reads them too."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    LEAF_SPRING,
    MEMORY,
    MOUNT,
    REBOUND_DAMPER,
    SPRING_HYSTERESIS,
    STOP_SPRING,
)
from benchmarks.foreign_truth.equations import POSITION, VELOCITY, spring


@njit
def extra_load(kind, size, shape, bench, state):
    """Force [N] that the load adds to its spring's."""
    position, velocity = state[POSITION], state[VELOCITY]
    if kind == SPRING_HYSTERESIS:
        return size * state[MEMORY]
    if kind == MOUNT:
        return spring(bench, position - state[MEMORY]) - spring(bench, position)
    if kind == STOP_SPRING:
        return size * max(position - shape, 0.0)
    if kind == REBOUND_DAMPER:
        return size * max(velocity, 0.0) ** 2
    if kind == LEAF_SPRING:
        stretch = abs(position - bench.spring_rest_position)
        return size * bench.spring_stiffness * stretch * math.tanh(velocity / shape)
    return 0.0


@njit
def memory_rate(kind, size, shape, bench, state):
    """Rate of the spring's path, and of the mount's foot [m/s]."""
    memory, velocity = state[MEMORY], state[VELOCITY]
    if kind == SPRING_HYSTERESIS:
        return (velocity - abs(velocity) * memory) / shape
    if kind == MOUNT:
        load = spring(bench, state[POSITION] - memory)
        return (size * load / bench.spring_stiffness - memory) / shape
    return 0.0
