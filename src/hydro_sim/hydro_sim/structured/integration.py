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
from hydro_sim.structured import derivatives, physics
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
    g: FloatArray  # (8,)
    gprobe: FloatArray  # (4, 8)


@njit
def scratch():
    """New work space."""
    return Scratch(
        np.empty((4, 8)),
        np.empty((4, 8)),
        np.empty((SUBSTEPS, STATES)),
        np.empty(SUBSTEPS),
        np.empty(8),
        np.empty((4, 8)),
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
def half_bristle_back(c, bristle, velocity, g, gc):
    """Gradients by deflection and velocity of g times the new deflection; adds those by c."""
    share = math.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))
    level = c[COULOMB] + c[STRIBECK] * share
    decay = c[BRISTLE] * abs(velocity) * 0.5 * STEP / level
    kept = math.exp(-decay)
    filling, bend = _filling(decay, kept)
    gdecay = (0.5 * STEP * velocity * bend - kept * bristle) * g
    sign = 1.0 if velocity >= 0.0 else -1.0
    gvelocity = 0.5 * STEP * filling * g + c[BRISTLE] * sign * 0.5 * STEP / level * gdecay
    gc[BRISTLE] += decay / c[BRISTLE] * gdecay
    gvelocity += physics.level_back(c, velocity, share, -decay / level * gdecay, gc)
    return kept * g, gvelocity


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


@njit
def advance_back(c, current, r, gstate, gr, gc, work):
    """Gradient of a sample: `gstate` by the state after it becomes that by the state before; adds those by r and c.

    `work` must be as `advance` left it.
    """
    for step in range(SUBSTEPS - 1, -1, -1):
        start, z = work.starts[step], work.middle[step]
        _runge_kutta(c, start[:8], z, current, r, work)
        velocity = start[3] + STEP / 6.0 * (
            work.slopes[0, 3] + 2.0 * work.slopes[1, 3] + 2.0 * work.slopes[2, 3] + work.slopes[3, 3]
        )
        gz, gvelocity = half_bristle_back(c, z, velocity, gstate[8], gc)
        gstate[3] += gvelocity
        gz += _runge_kutta_back(c, z, current, r, gstate, gr, gc, work)
        gz, gvelocity = half_bristle_back(c, start[8], start[3], gz, gc)
        gstate[8] = gz
        gstate[3] += gvelocity


@njit
def _runge_kutta_back(c, z, current, r, gstate, gr, gc, work):
    """Turns gstate[:8] from after to before the step; returns the gradient by z."""
    gz = 0.0
    for stage in range(3, -1, -1):
        weight = STEP / 6.0 if stage == 0 or stage == 3 else STEP / 3.0
        reach = STEP if stage == 2 else 0.5 * STEP
        for i in range(8):
            work.g[i] = weight * gstate[i]
            if stage < 3:
                work.g[i] += reach * work.gprobe[stage + 1, i]
            work.gprobe[stage, i] = 0.0
        gz += derivatives.rates_back(c, work.probes[stage], z, current, r, work.g, work.gprobe[stage], gr, gc)
    for i in range(8):
        gstate[i] += work.gprobe[0, i] + work.gprobe[1, i] + work.gprobe[2, i] + work.gprobe[3, i]
    return gz
