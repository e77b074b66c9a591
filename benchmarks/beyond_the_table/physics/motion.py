# SPDX-License-Identifier: Apache-2.0
"""Forces on the piston that the load does not see."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    BORE_SCORE,
    COLD_START,
    CUSHION,
    DRAG,
    FRICTION_LAG,
    FRICTION_POSITION,
    GLAND_PRESSURE,
    HEAT,
    LIP_FILM,
    MEMORY,
    ROD_BELLOWS,
    SEAL,
    SHEAR_THINNING,
)
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, VELOCITY

TURN = 2e-3
"""m/s over which friction turns its sign round."""
STRIBECK = 0.05
"""m/s at which a film has mostly formed."""
SCORED = 0.043
"""m, middle of the scored length of the bore."""


@njit
def extra_force(kind, size, shape, bench, time, state):
    """Force [N] on the piston, beside the load's, at a time [s]."""
    position, velocity, memory = state[POSITION], state[VELOCITY], state[MEMORY]
    if kind == DRAG:
        return -size * velocity * abs(velocity)
    if kind == FRICTION_POSITION:
        return -size * ((position - bench.spring_rest_position) / shape) ** 2 * velocity
    if kind == SEAL:
        return -size * abs(state[PRESSURE_A] - state[PRESSURE_B]) * math.tanh(velocity / shape)
    if kind == CUSHION:
        return -size * max(position - shape, 0.0) * velocity
    if kind == HEAT:
        return -size * math.exp(-memory) * velocity
    if kind == FRICTION_LAG:
        return -size * math.exp(-((memory / STRIBECK) ** 2)) * math.tanh(velocity / TURN)
    if kind == BORE_SCORE:
        return -size * math.exp(-(((position - SCORED) / shape) ** 2)) * math.tanh(velocity / TURN)
    if kind == GLAND_PRESSURE:
        return -size * state[PRESSURE_B] * math.tanh(velocity / shape)
    if kind == LIP_FILM:
        return -size * velocity / math.sqrt(abs(velocity) + shape)
    if kind == ROD_BELLOWS:
        return -size * (position - bench.spring_rest_position - memory)
    if kind == COLD_START:
        return -size * math.exp(-time / shape) * velocity
    return -size * velocity / (1.0 + abs(velocity) / shape) if kind == SHEAR_THINNING else 0.0


@njit
def memory_rate(kind, shape, bench, state):
    """Rate of the travelled warmth, of the velocity that the film has followed [m/s2], of the bellows' air [m/s]."""
    if kind == HEAT:
        return abs(state[VELOCITY]) / shape - state[MEMORY] / 10.0
    if kind == ROD_BELLOWS:
        return (state[POSITION] - bench.spring_rest_position - state[MEMORY]) / shape
    return (state[VELOCITY] - state[MEMORY]) / shape if kind == FRICTION_LAG else 0.0
