# SPDX-License-Identifier: Apache-2.0
"""Hidden states of the structured model: spool, its rate, bristle; simulated open loop from measured inputs."""

from __future__ import annotations

import numpy as np

from hydro_sim.jit import njit
from hydro_sim.structured import integration
from hydro_sim.structured.integration import STEP, SUBSTEPS
from hydro_sim.structured.physics import BRISTLE, COULOMB, SPOOL_DAMPING, SPOOL_OMEGA, STRIBECK, STRIBECK_VELOCITY

SPOOL, SPOOL_RATE, BRISTLE_STATE = range(3)
HIDDEN = 3


@njit
def steady(c, velocity, current, hidden):
    """Equilibrium of the hidden states, shape (3,), under a constant current [A] and velocity [m/s]."""
    level = c[COULOMB] + c[STRIBECK] * np.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))
    hidden[SPOOL], hidden[SPOOL_RATE] = current, 0.0
    hidden[BRISTLE_STATE] = np.sign(velocity) * level / c[BRISTLE]


@njit
def follow(c, velocity, current, hidden):
    """Advance the hidden states by one sample, in place.

    The spool follows the current [A] that the valve got, the bristle the measured velocity [m/s].
    """
    for _ in range(SUBSTEPS):
        hidden[BRISTLE_STATE] = integration.half_bristle(c, hidden[BRISTLE_STATE], velocity)
        hidden[BRISTLE_STATE] = integration.half_bristle(c, hidden[BRISTLE_STATE], velocity)
    hidden[SPOOL], hidden[SPOOL_RATE] = lag(
        c[SPOOL_OMEGA], c[SPOOL_DAMPING], current, hidden[SPOOL], hidden[SPOOL_RATE]
    )


@njit(inline="always")
def lag(w, d, target, position, rate):
    """Position and rate of `y'' = w (w (target - y) - 2 d y')` one sample later, the target held."""
    for _ in range(SUBSTEPS):
        y, slope, total_rate, total_pull = position, rate, 0.0, 0.0
        for stage in range(4):
            pull = w * (w * (target - y) - 2.0 * d * slope)
            weight = STEP / 6.0 if stage == 0 or stage == 3 else STEP / 3.0
            total_rate, total_pull = total_rate + weight * slope, total_pull + weight * pull
            reach = STEP if stage == 2 else 0.5 * STEP
            y, slope = position + reach * slope, rate + reach * pull
        position += total_rate
        rate += total_pull
    return position, rate
