# SPDX-License-Identifier: Apache-2.0
"""Forward derivatives of the structured model (`hydro_sim.learned`): what a nudge of state or current does, exactly.

Nudges travel as the columns of one array, through every stage of the integrator and the network, beside the state::

    d  (10, n)   rows: the nine states of `integration` in their order, then the valve current; a column, a direction
    y' = rates(y, z, u, r)      d' = partials @ d          the same Runge-Kutta steps and splitting for both

Identity columns give Jacobians. `physics` has the same derivatives backwards, for its gradients; forwards all columns
share one set of partial derivatives, which is what makes a Jacobian cheap. Where a slope jumps (a valve's edge at zero
opening, an end stop, a ReLU) the derivative is the one of the side the model is on.
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

PARTIALS = STATES + OUTPUTS
"""Columns of `partials`: y, z, and what the network adds."""


@njit(cache=True)
def partials(c, y, z, r, p):
    """Write d(y')/d(y, z, r) into `p`, shape (8, 12); that by the current is spool_omega^2 in row 5 alone."""
    p[:] = 0.0
    _chambers(c, y, r, p)
    _motion(c, y, z, p)
    p[2, 3] = p[4, 5] = p[6, 7] = 1.0
    w = c[SPOOL_OMEGA]
    p[5, 4], p[5, 5] = -w * w, -2.0 * c[SPOOL_DAMPING] * w
    w = c[CELL_OMEGA]
    p[7, 2], p[7, 6], p[7, 7] = w * w * c[SPRING], -w * w, -2.0 * c[CELL_DAMPING] * w


@njit(cache=True)
def _chambers(c, y, r, p):
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
    into_a = flow_a * (1.0 + r[0]) - area * y[3] - leak
    into_b = area_b * y[3] - flow_b * (1.0 + r[1]) + leak
    p[0, 0] = soft_a * (side * gain_a * opening * bend_a * (1.0 + r[0]) - c[LEAK])
    p[0, 1], p[1, 0] = soft_a * c[LEAK], soft_b * c[LEAK]
    p[0, 2], p[0, 3] = -soft_a * area / volume_a * into_a, -soft_a * area
    p[0, 4], p[0, 9] = soft_a * gain_a * root_a * (1.0 + r[0]), soft_a * flow_a
    p[1, 1] = soft_b * (side * gain_b * opening * bend_b * (1.0 + r[1]) - c[LEAK])
    p[1, 2], p[1, 3] = soft_b * area_b / volume_b * into_b, soft_b * area_b
    p[1, 4], p[1, 10] = -soft_b * gain_b * root_b * (1.0 + r[1]), -soft_b * flow_b


@njit(cache=True)
def _motion(c, y, z, p):
    """Row x_p''."""
    velocity = y[3]
    _, level, slip, fading, share = physics.friction(c, velocity, z)
    sign = 1.0 if velocity >= 0.0 else -1.0
    stick = c[BRISTLE] * abs(velocity) / level
    slip_slope = 1.0 - c[BRISTLE] * sign / level * z + stick * z / level * level_slope(c, velocity, share)
    fading_slope = -2.0 * velocity / c[DAMPING_VELOCITY] ** 2 * fading
    dry_by_velocity = c[BRISTLE_DAMPING] * (fading_slope * slip + fading * slip_slope)
    dry_by_bristle = c[BRISTLE] - c[BRISTLE_DAMPING] * fading * stick
    stiff, damp = _stop_slopes(c, y[2], velocity)
    p[3, 0], p[3, 1] = c[AREA] / c[MASS], -c[RATIO] * c[AREA] / c[MASS]
    p[3, 2] = -(c[SPRING] + stiff) / c[MASS]
    p[3, 3] = -(c[VISCOUS] + damp + dry_by_velocity) / c[MASS]
    p[3, 8], p[3, 11] = -dry_by_bristle / c[MASS], 1.0 / c[MASS]


@njit(cache=True)
def level_slope(c, velocity, share):
    """Slope of the friction level [N] by the velocity."""
    return -2.0 * velocity / c[STRIBECK_VELOCITY] ** 2 * c[STRIBECK] * share


@njit(cache=True)
def _stop_slopes(c, position, velocity):
    """Slopes of an end stop's force, if one presses."""
    into = position if position < 0.0 else max(position - c[STROKE], 0.0)
    force = STOP_STIFFNESS * into + STOP_DAMPING * velocity
    pressed = (into < 0.0 and force < 0.0) or (into > 0.0 and force > 0.0)
    return (STOP_STIFFNESS, STOP_DAMPING) if pressed else (0.0, 0.0)


@njit(cache=True)
def push(p, spool_square, d, dr, out):
    """out = d(y')/d... @ d, shape (8, n), of nudges d, shape (10, n), of the state and dr, shape (3, n), of r."""
    for k in range(d.shape[1]):
        pressure_a, pressure_b, position, velocity, spool = d[0, k], d[1, k], d[2, k], d[3, k], d[4, k]
        out[0, k] = p[0, 0] * pressure_a + p[0, 1] * pressure_b + p[0, 2] * position + p[0, 3] * velocity
        out[0, k] += p[0, 4] * spool + p[0, 9] * dr[0, k]
        out[1, k] = p[1, 0] * pressure_a + p[1, 1] * pressure_b + p[1, 2] * position + p[1, 3] * velocity
        out[1, k] += p[1, 4] * spool + p[1, 10] * dr[1, k]
        out[2, k] = velocity
        out[3, k] = p[3, 0] * pressure_a + p[3, 1] * pressure_b + p[3, 2] * position + p[3, 3] * velocity
        out[3, k] += p[3, 8] * d[8, k] + p[3, 11] * dr[2, k]
        out[4, k] = d[5, k]
        out[5, k] = p[5, 4] * spool + p[5, 5] * d[5, k] + spool_square * d[9, k]
        out[6, k] = d[7, k]
        out[7, k] = p[7, 2] * position + p[7, 6] * d[6, k] + p[7, 7] * d[7, k]


@njit(cache=True)
def half_bristle(c, state, d):
    """`integration.half_bristle` of the state in place, and of its nudges."""
    velocity, deflection = state[3], state[8]
    share = math.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))
    level = c[physics.COULOMB] + c[STRIBECK] * share
    sign = 1.0 if velocity >= 0.0 else -1.0
    decay = c[BRISTLE] * abs(velocity) * 0.5 * STEP / level
    kept = math.exp(-decay)
    filling, bend = integration._filling(decay, kept)
    decay_slope = c[BRISTLE] * 0.5 * STEP * sign / level - decay / level * level_slope(c, velocity, share)
    by_velocity = 0.5 * STEP * filling + (0.5 * STEP * velocity * bend - kept * deflection) * decay_slope
    state[8] = deflection * kept + 0.5 * STEP * velocity * filling
    for k in range(d.shape[1]):
        d[8, k] = kept * d[8, k] + by_velocity * d[3, k]


@njit(cache=True)
def advance(c, state, current, r, d, dr):
    """One sample of 1 ms of the state, shape (9,), and of its nudges, in place: `integration.advance` with columns."""
    n, square = d.shape[1], c[SPOOL_OMEGA] ** 2
    slope, probe, p, total = np.empty(8), np.empty(8), np.empty((8, PARTIALS)), np.empty(8)
    moved, nudged, summed = np.empty((8, n)), d.copy(), np.empty((8, n))
    for _ in range(SUBSTEPS):
        half_bristle(c, state, d)
        probe[:] = state[:8]
        nudged[:] = d
        for stage in range(4):
            physics.rates(c, probe, state[8], current, r, slope)
            partials(c, probe, state[8], r, p)
            push(p, square, nudged, dr, moved)
            weight = 1.0 if stage == 0 or stage == 3 else 2.0
            reach = STEP if stage == 2 else 0.5 * STEP
            for i in range(8):
                total[i] = slope[i] if stage == 0 else total[i] + weight * slope[i]
                probe[i] = state[i] + reach * slope[i]
                for k in range(n):
                    summed[i, k] = moved[i, k] if stage == 0 else summed[i, k] + weight * moved[i, k]
                    nudged[i, k] = d[i, k] + reach * moved[i, k]
        for i in range(8):
            state[i] += STEP / 6.0 * total[i]
            for k in range(n):
                d[i, k] += STEP / 6.0 * summed[i, k]
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
    """`structured.residual` and dr/d(p_a, p_b, x_p, x_p', spool), shape (3, 5); nothing if the last layer is zero."""
    r[:] = 0.0
    slopes[:] = 0.0
    if not (np.any(layers.w3) or np.any(layers.b3)):
        return
    x, a1, a2 = np.empty(INPUTS), np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    for i in range(INPUTS):
        x[i] = (s[i] - center[i]) / scale[i]
    network_slopes(layers, x, a1, a2, r, slopes)
    for i in range(OUTPUTS):
        r[i] *= OUTPUT_SCALES[i]
        for j in range(INPUTS):
            slopes[i, j] *= OUTPUT_SCALES[i] / scale[j]
