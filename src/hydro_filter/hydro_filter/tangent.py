# SPDX-License-Identifier: Apache-2.0
"""Forward derivatives of the structured model (`hydro_sim.learned`): what a nudge of state or current does, exactly.

Nudges travel as the columns of one array, through every stage of the integrator and the network, beside the state::

    d  (10, 8)   rows: the nine states of `integration` in their order, then the valve current; a column, a direction
    y' = rates(y, z, u, r)      d' = partials @ d          the same Runge-Kutta steps and splitting for both

Unit columns give Jacobians. `physics` has the same derivatives backwards, for its gradients; forwards all columns share
one set of partial derivatives, and eight of them fill the vector registers, which is what makes a Jacobian cheap. Where
a slope jumps (a valve's edge at zero opening, an end stop, a ReLU) the derivative is that of the side the model is on.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hydro_sim.learned import integration, mlp, physics
from hydro_sim.learned.integration import STATES, STEP, SUBSTEPS
from hydro_sim.learned.physics import (
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
from hydro_sim.learned.structured import INPUTS, OUTPUT_SCALES, OUTPUTS

SOURCES = STATES + 1
"""Rows of d: the states and the current."""

WIDTH = 8
"""Columns of d."""

PARTIALS = STATES + OUTPUTS
"""Columns of `rates`' derivatives: y, z, and what the network adds."""


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


@njit(cache=True, fastmath={"contract"})
def push(p, spool_square, at, d, dr, weight, reach, total, ahead):
    """m = d(y')/d... @ at: total += weight m, and the nudges one stage ahead are d + reach m.

    All flat, so that the rows' places are known and the loop is vectorized: `at`, `d`, `ahead`, shape (10 * 8,); `dr`,
    shape (3 * 8,), of r; `total`, shape (8 * 8,).
    """
    aa, ab, ax, av, au, ar = p[0, 0], p[0, 1], p[0, 2], p[0, 3], p[0, 4], p[0, 9]
    ba, bb, bx, bv, bu, br = p[1, 0], p[1, 1], p[1, 2], p[1, 3], p[1, 4], p[1, 10]
    va, vb, vx, vv, vz, vr = p[3, 0], p[3, 1], p[3, 2], p[3, 3], p[3, 8], p[3, 11]
    uu, uv, lx, ll, lv = p[5, 4], p[5, 5], p[7, 2], p[7, 6], p[7, 7]
    for k in range(WIDTH):
        a, b, x, v, u = at[k], at[1 * WIDTH + k], at[2 * WIDTH + k], at[3 * WIDTH + k], at[4 * WIDTH + k]
        m0 = aa * a + ab * b + ax * x + av * v + au * u + ar * dr[k]
        m1 = ba * a + bb * b + bx * x + bv * v + bu * u + br * dr[1 * WIDTH + k]
        m3 = va * a + vb * b + vx * x + vv * v + vz * at[8 * WIDTH + k] + vr * dr[2 * WIDTH + k]
        m4, m6 = at[5 * WIDTH + k], at[7 * WIDTH + k]
        m5 = uu * u + uv * m4 + spool_square * at[9 * WIDTH + k]
        m7 = lx * x + ll * at[6 * WIDTH + k] + lv * m6
        total[k] += weight * m0
        total[1 * WIDTH + k] += weight * m1
        total[2 * WIDTH + k] += weight * v
        total[3 * WIDTH + k] += weight * m3
        total[4 * WIDTH + k] += weight * m4
        total[5 * WIDTH + k] += weight * m5
        total[6 * WIDTH + k] += weight * m6
        total[7 * WIDTH + k] += weight * m7
        ahead[k] = d[k] + reach * m0
        ahead[1 * WIDTH + k] = d[1 * WIDTH + k] + reach * m1
        ahead[2 * WIDTH + k] = d[2 * WIDTH + k] + reach * v
        ahead[3 * WIDTH + k] = d[3 * WIDTH + k] + reach * m3
        ahead[4 * WIDTH + k] = d[4 * WIDTH + k] + reach * m4
        ahead[5 * WIDTH + k] = d[5 * WIDTH + k] + reach * m5
        ahead[6 * WIDTH + k] = d[6 * WIDTH + k] + reach * m6
        ahead[7 * WIDTH + k] = d[7 * WIDTH + k] + reach * m7


@njit(cache=True)
def half_bristle(c, state, d):
    """`integration.half_bristle` of the state in place, and of its nudges."""
    velocity, deflection = state[3], state[8]
    kept, by_velocity = 1.0, 0.5 * STEP
    if c[BRISTLE] == 0.0:  # a model without bristles: they go along with the velocity, and push nothing
        state[8] = deflection + 0.5 * STEP * velocity
    else:
        share = math.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))
        level = c[physics.COULOMB] + c[STRIBECK] * share
        sign = 1.0 if velocity >= 0.0 else -1.0
        decay = c[BRISTLE] * abs(velocity) * 0.5 * STEP / level
        kept = math.exp(-decay)
        filling, bend = integration._filling(decay, kept)
        decay_slope = c[BRISTLE] * 0.5 * STEP * sign / level - decay / level * level_slope(c, velocity, share)
        by_velocity = 0.5 * STEP * filling + (0.5 * STEP * velocity * bend - kept * deflection) * decay_slope
        state[8] = deflection * kept + 0.5 * STEP * velocity * filling
    for k in range(WIDTH):
        d[8, k] = kept * d[8, k] + by_velocity * d[3, k]


@njit(cache=True)
def advance(c, state, current, r, d, dr):
    """One sample of 1 ms of the state, shape (9,), and of its nudges, in place: `integration.advance` with columns."""
    square = c[SPOOL_OMEGA] ** 2
    slope, probe, total, p = np.empty(8), np.empty(8), np.empty(8), np.zeros((8, PARTIALS))
    summed, ahead, then = np.empty(8 * WIDTH), np.empty(SOURCES * WIDTH), np.empty(SOURCES * WIDTH)
    flat, flat_r = d.reshape(SOURCES * WIDTH), dr.reshape(OUTPUTS * WIDTH)
    for _ in range(SUBSTEPS):
        half_bristle(c, state, d)
        probe[:] = state[:8]
        total[:], summed[:] = 0.0, 0.0
        ahead[:] = then[:] = flat
        for stage in range(4):
            rates(c, probe, state[8], current, r, slope, p)
            weight, reach = 1.0 if stage == 0 or stage == 3 else 2.0, STEP if stage == 2 else 0.5 * STEP
            for i in range(8):
                total[i] += weight * slope[i]
                probe[i] = state[i] + reach * slope[i]
            push(p, square, ahead, flat, flat_r, weight, reach, summed, then)
            ahead, then = then, ahead
        for i in range(8):
            state[i] += STEP / 6.0 * total[i]
        for k in range(8 * WIDTH):
            flat[k] += STEP / 6.0 * summed[k]
        half_bristle(c, state, d)


@njit(cache=True)
def network_slopes(layers, x, a1, a2, y, slopes):
    """y, shape (m,), of `mlp.forward`, and dy/dx, shape (m, n): one pass back for each output."""
    mlp.forward(layers, x, a1, a2, y)
    h1, h2 = a1.shape[0], a2.shape[0]
    g1 = np.empty(h1)
    for row in range(y.shape[0]):
        g1[:] = 0.0
        for j in range(h2):
            if a2[j] > 0.0:
                for i in range(h1):
                    g1[i] += layers.w2[i, j] * layers.w3[j, row]
        for i in range(h1):
            if a1[i] <= 0.0:
                g1[i] = 0.0
        for i in range(x.shape[0]):
            total = 0.0
            for j in range(h1):
                total += layers.w1[i, j] * g1[j]
            slopes[row, i] = total


@njit(cache=True)
def residual(layers, center, scale, s, r, slopes):
    """`structured.residual` and dr/d(p_a, p_b, x_p, x_p', spool), shape (3, 5); whether there is anything."""
    r[:] = 0.0
    slopes[:] = 0.0
    if not (np.any(layers.w3) or np.any(layers.b3)):
        return False
    x, a1, a2 = np.empty(INPUTS), np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    for i in range(INPUTS):
        x[i] = (s[i] - center[i]) / scale[i]
    network_slopes(layers, x, a1, a2, r, slopes)
    for i in range(OUTPUTS):
        r[i] *= OUTPUT_SCALES[i]
        for j in range(INPUTS):
            slopes[i, j] *= OUTPUT_SCALES[i] / scale[j]
    return True
