# SPDX-License-Identifier: Apache-2.0
"""Forces on the piston that the load does not see: friction, and with it what `pushes` has."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    ASKEW_LOAD_FRICTION,
    BACKUP_RING,
    BLOWN_LIP,
    BORE_SCORE,
    COLD_START,
    CUSHION,
    DRAG,
    DRY_RAIL,
    EDDY_RING,
    FILM_SQUEEZED,
    FRICTION_LAG,
    FRICTION_POSITION,
    GLAND_PRESSURE,
    GUIDE_SWELLS,
    HEAT,
    HONED_WAVES,
    LIP_FILM,
    LIP_RELAXES,
    MEMORY,
    PISTON_LIP_FRICTION,
    ROD_SEAL,
    SCRAPER_DIGS,
    SEAL,
    SEAL_FILM_DRAG,
    SHEAR_THINNING,
    SIDE_LOAD,
    SPRING_BOWS,
    SQUEEZE_FILM,
    STARVED_FILM,
    TIGHT_SPOT,
    TURBULENT_DRAG,
)
from benchmarks.beyond_the_table.physics.pushes import push
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, VELOCITY, outside, spring

TURN = 2e-3
"""m/s over which friction turns its sign round."""
STRIBECK = 0.05
"""m/s at which a film has mostly formed."""
SCORED = 0.043
"""m, middle of the scored length of the bore."""
DRAWN_IN = 8e-3
"""m of travel that draw a film in again."""
RING_TURN = 5e-3
"""m/s over which a backup ring's friction turns its sign round, and that of a guide under a bowed spring."""
JOINT = 1e-3
"""m about the joint of two rails in which a carriage passes from one to the other."""
RAIL_TURN = 5e-3
"""m/s over which a dry rail's friction turns its sign round."""
LIP_TURN = 5e-3
"""m/s over which the friction of a lip that has yet to flow turns its sign round."""
SPOT, SPOT_TURN = 2e-3, 3e-3
"""m about a tight spot of the bore; m/s over which its friction turns its sign round."""
RUBBED = 0.1
"""m/s at which a guide has warmed by 1 in the end."""
DRY_TURN = 5e-3
"""m/s over which the friction of a piston's lips or of a guide under a load askew turns its sign round."""
FILM_SLOW = 1e-4
"""m/s below which a film's drag is in proportion, lest its root be steep without end."""


@njit
def extra_force(kind, size, shape, bench, time, current, state):
    """Force [N] on the piston, beside the load's, at a time [s] under a current [A]."""
    position, velocity, memory = state[POSITION], state[VELOCITY], state[MEMORY]
    if kind in (DRAG, TURBULENT_DRAG):
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
    if kind in (GLAND_PRESSURE, ROD_SEAL):
        return -size * state[PRESSURE_B] * math.tanh(velocity / shape)
    if kind == SIDE_LOAD:
        return -size * abs(spring(bench, position)) * math.tanh(velocity / shape)
    if kind == TIGHT_SPOT:
        return -size * math.exp(-(((position - shape) / SPOT) ** 2)) * math.tanh(velocity / SPOT_TURN)
    if kind == LIP_FILM:
        return -size * velocity / math.sqrt(abs(velocity) + shape)
    if kind == COLD_START:
        return -size * math.exp(-time / shape) * velocity
    if kind == FILM_SQUEEZED:
        return -size * memory * math.tanh(velocity / TURN)
    if kind == BACKUP_RING:
        return -size * max(state[PRESSURE_B] - shape, 0.0) * math.tanh(velocity / RING_TURN)
    if kind == STARVED_FILM:
        return -size * outside(velocity, shape)
    if kind == SPRING_BOWS:
        return -size * max(bench.spring_rest_position - position, 0.0) ** 2 * math.tanh(velocity / RING_TURN)
    if kind == GUIDE_SWELLS:
        return -size * memory * math.tanh(velocity / TURN)
    if kind == BLOWN_LIP:
        return -size * state[PRESSURE_A] * velocity
    if kind == EDDY_RING:
        return -size * velocity / (1.0 + (velocity / shape) ** 2)
    if kind == DRY_RAIL:
        beyond = 0.5 * (1.0 + math.tanh((position - shape) / JOINT))
        return -size * beyond * math.tanh(velocity / RAIL_TURN)
    if kind == SCRAPER_DIGS:
        return -size * min(velocity, 0.0)
    if kind == HONED_WAVES:
        return -size * math.sin(math.pi * position / shape) ** 2 * velocity
    if kind == LIP_RELAXES:
        return -size * max(state[PRESSURE_B] - memory, 0.0) * math.tanh(velocity / LIP_TURN)
    if kind == SHEAR_THINNING:
        return -size * velocity / (1.0 + abs(velocity) / shape)
    if kind == SQUEEZE_FILM:
        return -size * velocity / (1.0 - position / shape) ** 3
    if kind == SEAL_FILM_DRAG:
        return -size * velocity / math.sqrt(abs(velocity) + FILM_SLOW)
    if kind == PISTON_LIP_FRICTION:
        return -size * abs(state[PRESSURE_A] - state[PRESSURE_B]) * math.tanh(velocity / DRY_TURN)
    if kind == ASKEW_LOAD_FRICTION:
        return -size * abs(spring(bench, position)) * math.tanh(velocity / DRY_TURN)
    return push(kind, size, shape, bench, current, state)


@njit
def memory_rate(kind, shape, state):
    """Rate of warmth (travelled, or of a guide), of a film's velocity [m/s2], of lips."""
    if kind == HEAT:
        return abs(state[VELOCITY]) / shape - state[MEMORY] / 10.0
    if kind == FILM_SQUEEZED:
        return (1.0 - state[MEMORY]) / shape - abs(state[VELOCITY]) * state[MEMORY] / DRAWN_IN
    if kind == GUIDE_SWELLS:
        return (abs(state[VELOCITY]) / RUBBED - state[MEMORY]) / shape
    if kind == LIP_RELAXES:
        return (state[PRESSURE_B] - state[MEMORY]) / shape
    return (state[VELOCITY] - state[MEMORY]) / shape if kind == FRICTION_LAG else 0.0
