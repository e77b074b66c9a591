# SPDX-License-Identifier: Apache-2.0
"""Derivatives of `hydro_sim.structured.physics.rates`: y' of the structured model and d(y')/d(y, z, r), row by row.

Those of the equations are `structured.derivatives`; here end stops come on top, and a model without bristles is spared
their friction. Where a slope jumps the derivative is that of the side the model is on.
"""

from __future__ import annotations

from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq
from hydro_sim.structured import derivatives, physics
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.physics import BRISTLE, BRISTLE_DAMPING, MASS, STRIBECK, STRIBECK_VELOCITY
from hydro_sim.structured.rollout import OUTPUTS

PARTIALS = STATES + OUTPUTS
"""Columns of the derivatives: y, z, and what the network adds."""


@njit
def rates(c, y, z, current, r, slope, p):
    """`physics.rates`, y' into `slope`, and d(y')/d(y, z, r) into `p`, shape (8, 12), zero where it always is.

    That by the current is spool_omega^2 in row 5 alone.
    """
    derivatives.partials(c, y, current, r, slope, p)
    p[3, 8] = 0.0
    stop = eq.stop_force(physics.numbers(c), y[2], y[3])
    if stop != 0.0:
        _add(c, stop, eq.STOP_STIFFNESS, eq.STOP_DAMPING, slope, p)
    if c[BRISTLE] != 0.0 or c[BRISTLE_DAMPING] != 0.0:  # a model without bristles costs nothing
        dry, by_velocity, by_bristle = derivatives.friction_partials(c, y[3], z)
        _add(c, dry, 0.0, by_velocity, slope, p)
        p[3, 8] = -by_bristle / c[MASS]


@njit
def _add(c, force, by_position, by_velocity, slope, p):
    """A force [N] against the motion, with its slopes."""
    slope[3] -= force / c[MASS]
    p[3, 2] -= by_position / c[MASS]
    p[3, 3] -= by_velocity / c[MASS]


@njit
def level_slope(c, velocity, share):
    """Slope of the friction level [N] by the velocity."""
    return -2.0 * velocity / c[STRIBECK_VELOCITY] ** 2 * c[STRIBECK] * share
