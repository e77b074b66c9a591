# SPDX-License-Identifier: Apache-2.0
"""One sample of the structured model, and its gradient: four steps of Runge-Kutta 4 with the bristle split off.

A step of 250 us (Strang splitting, second order): half a step of the bristle, exact at constant velocity so that no
velocity makes it stiff; a Runge-Kutta step of y; the other half of the bristle. `state` is [y (8), z], shape (9,).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.jit import njit
from hydro_sim.structured import physics
from hydro_sim.structured.physics import BRISTLE, COULOMB, STRIBECK, STRIBECK_VELOCITY

STATES = 9
SUBSTEPS = 4
STEP = SAMPLE_PERIOD / SUBSTEPS


class Scratch(NamedTuple):
    """Work space of one thread."""

    slopes: FloatArray  # (4, 8)
    probes: FloatArray  # (4, 8), where the slopes were taken
    starts: FloatArray  # (SUBSTEPS, 9)
    middle: FloatArray  # (SUBSTEPS,), the bristle during the Runge-Kutta step


@njit
def scratch():
    """New work space."""
    return Scratch(
        np.empty((4, 8)),
        np.empty((4, 8)),
        np.empty((SUBSTEPS, STATES)),
        np.empty(SUBSTEPS),
    )


@njit
def half_bristle(c, bristle, velocity):
    """Return the deflection [m] half a step later."""
    level = c[COULOMB] + c[STRIBECK] * math.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))
    decay = c[BRISTLE] * abs(velocity) * 0.5 * STEP / level
    kept = math.exp(-decay)
    return bristle * kept + 0.5 * STEP * velocity * _filling(decay, kept)[0]


@njit
def _filling(decay, kept):
    """(1 - exp(-d)) / d and its slope."""
    if decay < 1e-4:
        return 1.0 - 0.5 * decay, -0.5 + decay / 3.0
    return (1.0 - kept) / decay, (kept * (1.0 + decay) - 1.0) / (decay * decay)


@njit
def advance(c, state, current, r, work):
    """Advance by one sample of 1 ms in place; leave in `work` the start of each step."""
    y = state[:8]
    for step in range(SUBSTEPS):
        work.starts[step] = state
        state[8] = half_bristle(c, state[8], state[3])
        work.middle[step] = state[8]
        _runge_kutta(c, y, state[8], current, r, work)
        for i in range(8):
            y[i] += (
                STEP / 6.0 * (work.slopes[0, i] + 2.0 * work.slopes[1, i] + 2.0 * work.slopes[2, i] + work.slopes[3, i])
            )
        state[8] = half_bristle(c, state[8], state[3])


@njit
def _runge_kutta(c, y, z, current, r, work):
    """The four slopes at y."""
    for stage in range(4):
        reach = 0.0 if stage == 0 else (STEP if stage == 3 else 0.5 * STEP)
        for i in range(8):
            work.probes[stage, i] = y[i] if stage == 0 else y[i] + reach * work.slopes[stage - 1, i]
        physics.rates(c, work.probes[stage], z, current, r, work.slopes[stage])
