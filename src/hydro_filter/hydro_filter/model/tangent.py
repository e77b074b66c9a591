# SPDX-License-Identifier: Apache-2.0
"""Exact forward derivatives (tangents) of the structured model with respect to state and current.

Nudges travel as the columns of one array, through every stage of the integrator and the network, beside the state::

    d  (10, 8)   rows: the nine states of `integration` in their order, then the valve current; a column, a direction
    y' = rates(y, z, u, r)      d' = partials @ d          the same Runge-Kutta steps and splitting for both

Unit columns give Jacobians. Forwards all columns share one set of partial derivatives (`tangent_rates`), and eight of
them fill the vector registers, which is what makes a Jacobian cheap.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_filter.model.tangent_rates import PARTIALS, level_slope, rates
from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.structured import integration
from hydro_sim.structured.integration import STATES, STEP, SUBSTEPS
from hydro_sim.structured.physics import BRISTLE, COULOMB, SPOOL_OMEGA, STRIBECK, STRIBECK_VELOCITY
from hydro_sim.structured.rollout import OUTPUTS

SOURCES = STATES + 1
"""Rows of d: the states and the current."""

WIDTH = 8
"""Columns of d."""


@njit(fastmath={"contract"})
def accumulate(p, spool_square, at, d, dr, weight, reach, total, ahead):
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


@njit
def half_bristle(c, state, d):
    """`integration.half_bristle` of the state and its tangents, in place."""
    velocity, deflection = state[3], state[8]
    kept, by_velocity = 1.0, 0.5 * STEP
    if c[BRISTLE] == 0.0:  # a model without bristles: they follow the velocity without force
        state[8] = deflection + 0.5 * STEP * velocity
    else:
        share = math.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))
        level = c[COULOMB] + c[STRIBECK] * share
        sign = 1.0 if velocity >= 0.0 else -1.0
        decay = c[BRISTLE] * abs(velocity) * 0.5 * STEP / level
        kept = math.exp(-decay)
        filling, bend = integration._filling(decay, kept)
        decay_slope = c[BRISTLE] * 0.5 * STEP * sign / level - decay / level * level_slope(c, velocity, share)
        by_velocity = 0.5 * STEP * filling + (0.5 * STEP * velocity * bend - kept * deflection) * decay_slope
        state[8] = deflection * kept + 0.5 * STEP * velocity * filling
    for k in range(WIDTH):
        d[8, k] = kept * d[8, k] + by_velocity * d[3, k]


@njit
def advance(c, state, current, r, d, dr):
    """`integration.advance` by one sample of 1 ms, of the state, shape (9,), and its tangents, in place."""
    square = c[SPOOL_OMEGA] ** 2
    slope, probe, total, p = np.empty(8), np.empty(8), np.empty(8), np.zeros((8, PARTIALS))
    summed, ahead, then = np.empty(8 * WIDTH), np.empty(SOURCES * WIDTH), np.empty(SOURCES * WIDTH)
    flat, flat_r = d.reshape(SOURCES * WIDTH), dr.reshape(OUTPUTS * WIDTH)
    for _ in range(SUBSTEPS):
        half_bristle(c, state, d)
        copies.vector(probe, state[:8])
        total[:], summed[:] = 0.0, 0.0
        copies.vector(ahead, flat)
        copies.vector(then, flat)
        for stage in range(4):
            rates(c, probe, state[8], current, r, slope, p)
            weight, reach = 1.0 if stage == 0 or stage == 3 else 2.0, STEP if stage == 2 else 0.5 * STEP
            for i in range(8):
                total[i] += weight * slope[i]
                probe[i] = state[i] + reach * slope[i]
            accumulate(p, square, ahead, flat, flat_r, weight, reach, summed, then)
            ahead, then = then, ahead
        for i in range(8):
            state[i] += STEP / 6.0 * total[i]
        for k in range(8 * WIDTH):
            flat[k] += STEP / 6.0 * summed[k]
        half_bristle(c, state, d)
