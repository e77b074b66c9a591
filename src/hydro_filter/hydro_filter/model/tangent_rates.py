# SPDX-License-Identifier: Apache-2.0
"""Derivatives of `hydro_sim.structured.physics.rates`: y' of the structured model and d(y')/d(y, z, r), row by row.

`physics` has the same derivatives backwards, for its gradients. Where a slope jumps (a valve's edge at zero opening, an
end stop) the derivative is that of the side the model is on.
"""

from __future__ import annotations

from numba import njit

from hydro_sim.structured import physics
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.physics import (
    AREA,
    BRISTLE,
    BRISTLE_DAMPING,
    BULK,
    CELL_DAMPING,
    CELL_OMEGA,
    DAMPING_VELOCITY,
    DEAD_A,
    DEAD_B,
    KA_NEGATIVE,
    KA_POSITIVE,
    KB_NEGATIVE,
    KB_POSITIVE,
    LEAK,
    MASS,
    OFFSET,
    RATIO,
    REST,
    SPOOL_DAMPING,
    SPOOL_OMEGA,
    SPRING,
    STOP_DAMPING,
    STOP_STIFFNESS,
    STRIBECK,
    STRIBECK_VELOCITY,
    STROKE,
    SUPPLY,
    TANK,
    VISCOUS,
)
from hydro_sim.structured.rollout import OUTPUTS

PARTIALS = STATES + OUTPUTS
"""Columns of the derivatives: y, z, and what the network adds."""


@njit(cache=True)
def rates(c, y, z, current, r, slope, p):
    """`physics.rates`, y' into `slope`, and d(y')/d(y, z, r) into `p`, shape (8, 12), zero where it always is.

    That by the current is spool_omega^2 in row 5 alone.
    """
    area_b = c[RATIO] * c[AREA]
    _chambers(c, y, r, slope, p)
    dry, dry_by_velocity, dry_by_bristle = _friction(c, y[3], z)
    stop, stiff, damp = _stop(c, y[2], y[3])
    spring = c[SPRING] * (y[2] - c[REST])
    slope[2] = y[3]
    slope[3] = (c[AREA] * y[0] - area_b * y[1] - c[VISCOUS] * y[3] - spring + r[2] - stop - dry) / c[MASS]
    p[3, 0], p[3, 1], p[3, 2] = c[AREA] / c[MASS], -area_b / c[MASS], -(c[SPRING] + stiff) / c[MASS]
    p[3, 3] = -(c[VISCOUS] + damp + dry_by_velocity) / c[MASS]
    p[3, 8], p[3, 11] = -dry_by_bristle / c[MASS], 1.0 / c[MASS]
    w, d = c[SPOOL_OMEGA], c[SPOOL_DAMPING]
    slope[4], slope[5] = y[5], w * (w * (current - y[4]) - 2.0 * d * y[5])
    p[5, 4], p[5, 5] = -w * w, -2.0 * d * w
    w, d = c[CELL_OMEGA], c[CELL_DAMPING]
    slope[6], slope[7] = y[7], w * (w * (spring - y[6]) - 2.0 * d * y[7])
    p[7, 2], p[7, 6], p[7, 7] = w * w * c[SPRING], -w * w, -2.0 * d * w


@njit(cache=True)
def _chambers(c, y, r, slope, p):
    """Rows p_a', p_b'."""
    area, area_b = c[AREA], c[RATIO] * c[AREA]
    volume_a, volume_b = c[DEAD_A] + area * y[2], c[DEAD_B] + area_b * (c[STROKE] - y[2])
    opening = y[4] + c[OFFSET]
    if opening >= 0.0:
        drop_a, drop_b, gain_a, gain_b, side = c[SUPPLY] - y[0], y[1] - c[TANK], c[KA_POSITIVE], c[KB_POSITIVE], -1.0
    else:
        drop_a, drop_b, gain_a, gain_b, side = y[0] - c[TANK], c[SUPPLY] - y[1], c[KA_NEGATIVE], c[KB_NEGATIVE], 1.0
    (root_a, bend_a), (root_b, bend_b) = physics.root(drop_a), physics.root(drop_b)
    flow_a, flow_b = gain_a * opening * root_a, gain_b * opening * root_b
    leak = c[LEAK] * (y[0] - y[1])
    soft_a, soft_b = c[BULK] / volume_a, c[BULK] / volume_b
    slope[0] = soft_a * (flow_a * (1.0 + r[0]) - area * y[3] - leak)
    slope[1] = soft_b * (area_b * y[3] - flow_b * (1.0 + r[1]) + leak)
    p[0, 0] = soft_a * (side * gain_a * opening * bend_a * (1.0 + r[0]) - c[LEAK])
    p[0, 1], p[1, 0] = soft_a * c[LEAK], soft_b * c[LEAK]
    p[0, 2], p[0, 3] = -area / volume_a * slope[0], -soft_a * area
    p[0, 4], p[0, 9] = soft_a * gain_a * root_a * (1.0 + r[0]), soft_a * flow_a
    p[1, 1] = soft_b * (side * gain_b * opening * bend_b * (1.0 + r[1]) - c[LEAK])
    p[1, 2], p[1, 3] = area_b / volume_b * slope[1], soft_b * area_b
    p[1, 4], p[1, 10] = -soft_b * gain_b * root_b * (1.0 + r[1]), -soft_b * flow_b


@njit(cache=True)
def _friction(c, velocity, z):
    """`physics.friction` [N] and its slopes by velocity and bristle; a model without bristles costs nothing."""
    if c[BRISTLE] == 0.0 and c[BRISTLE_DAMPING] == 0.0:
        return 0.0, 0.0, 0.0
    dry, level, slip, fading, share = physics.friction(c, velocity, z)
    sign = 1.0 if velocity >= 0.0 else -1.0
    stick = c[BRISTLE] * abs(velocity) / level
    slip_slope = 1.0 - c[BRISTLE] * sign / level * z + stick * z / level * level_slope(c, velocity, share)
    fading_slope = -2.0 * velocity / c[DAMPING_VELOCITY] ** 2 * fading
    by_velocity = c[BRISTLE_DAMPING] * (fading_slope * slip + fading * slip_slope)
    return dry, by_velocity, c[BRISTLE] - c[BRISTLE_DAMPING] * fading * stick


@njit(cache=True)
def level_slope(c, velocity, share):
    """Slope of the friction level [N] by the velocity."""
    return -2.0 * velocity / c[STRIBECK_VELOCITY] ** 2 * c[STRIBECK] * share


@njit(cache=True)
def _stop(c, position, velocity):
    """Force [N] of an end stop, and its slopes by position and velocity if it presses."""
    into = position if position < 0.0 else max(position - c[STROKE], 0.0)
    force = STOP_STIFFNESS * into + STOP_DAMPING * velocity
    if (into < 0.0 and force < 0.0) or (into > 0.0 and force > 0.0):
        return force, STOP_STIFFNESS, STOP_DAMPING
    return 0.0, 0.0, 0.0
