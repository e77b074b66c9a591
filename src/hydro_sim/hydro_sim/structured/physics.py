# SPDX-License-Identifier: Apache-2.0
"""Equations of the structured model and their gradients: `model.hydraulics` with textbook extensions.

::

    y = [ p_a  p_b  x_p  x_p'  spool  spool'  F  F' ]     integrated        spool in A of the command that would hold it
    z = bristle deflection [m], advanced between the steps  (F: f_l behind the amplifier of its load cell)
    r = [ r_a  r_b  r_f ]  what the network adds, held over a sample

    p_a' = beta/V_a (q_a (1 + r_a) - A x_p' - leak)          q_a = k_a s root(p_s - p_a)  or  k_a s root(p_a - p_t)
    p_b' = beta/V_b (alpha A x_p' - q_b (1 + r_b) + leak)    s = spool + offset: one k for either sign and chamber
    m x_p'' = f_h - b x_p' - friction - k_s (x_p - x_rest) + r_f
    spool'' = w (w (u - spool) - 2 zeta spool')              F'' = w_l (w_l (k_s (x_p - x_rest) - F) - 2 zeta_l F')

    friction = sigma_0 z + sigma_1 exp(-(x_p'/v_d)^2) slip   slip = z' = x_p' - sigma_0 |x_p'| / level z
    level    = F_c + F_s exp(-(x_p'/v_s)^2)

Source: paper eq. q13-q15 (with physics.md's erratum); Merritt, Hydraulic Control Systems, 1967 (spool, leakage);
Canudas de Wit et al., IEEE TAC 40(3), 1995 (LuGre friction). All numbers in `c` are learned; `constants` says what
they are.
"""

from __future__ import annotations

import math

from numba import njit

(
    BULK, AREA, RATIO, DEAD_A, DEAD_B, SUPPLY, TANK, KA_POSITIVE, KA_NEGATIVE, KB_POSITIVE, KB_NEGATIVE, OFFSET, LEAK,
    MASS, VISCOUS, SPRING, REST, SPOOL_OMEGA, SPOOL_DAMPING, CELL_OMEGA, CELL_DAMPING, COULOMB, STRIBECK,
    STRIBECK_VELOCITY, BRISTLE, BRISTLE_DAMPING, DAMPING_VELOCITY, GAIN_H, BIAS_H, GAIN_L, BIAS_L, STROKE,
) = range(32)  # fmt: skip
CONSTANTS = 32

LAMINAR = 1e4  # Pa: below about this pressure drop the root is rounded off, so that its slope is finite
STOP_STIFFNESS, STOP_DAMPING = 1e7, 4e3  # N/m, N s/m: end stops, never reached in training


@njit(cache=True)
def root(drop):
    """sqrt of a pressure drop [Pa], odd and rounded off at zero; and its slope."""
    square = drop * drop
    rounded = square + LAMINAR * LAMINAR
    width = math.sqrt(math.sqrt(rounded))
    return drop / width, (1.0 - 0.5 * square / rounded) / width


@njit(cache=True)
def _valve(c, y, opening):
    """Pressure drops' signs and gains of the two open lands: drop_a, drop_b, side (1 or -1), k_a, k_b."""
    if opening >= 0.0:
        return c[SUPPLY] - y[0], y[1] - c[TANK], c[KA_POSITIVE], c[KB_POSITIVE]
    return y[0] - c[TANK], c[SUPPLY] - y[1], c[KA_NEGATIVE], c[KB_NEGATIVE]


@njit(cache=True)
def friction(c, velocity, bristle):
    """Dry friction [N] against motion, and what its gradient needs: level, slip, fading damping, Stribeck's share."""
    share = math.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))
    level = c[COULOMB] + c[STRIBECK] * share
    slip = velocity - c[BRISTLE] * abs(velocity) / level * bristle
    fading = math.exp(-((velocity / c[DAMPING_VELOCITY]) ** 2))
    return c[BRISTLE] * bristle + c[BRISTLE_DAMPING] * fading * slip, level, slip, fading, share


@njit(cache=True)
def rates(c, y, z, current, r, slope):
    """y' into `slope`, shape (8,)."""
    area_b = c[RATIO] * c[AREA]
    volume_a = c[DEAD_A] + c[AREA] * y[2]
    volume_b = c[DEAD_B] + area_b * (c[STROKE] - y[2])
    opening = y[4] + c[OFFSET]
    drop_a, drop_b, gain_a, gain_b = _valve(c, y, opening)
    flow_a = gain_a * opening * root(drop_a)[0] * (1.0 + r[0])
    flow_b = gain_b * opening * root(drop_b)[0] * (1.0 + r[1])
    leak = c[LEAK] * (y[0] - y[1])
    slope[0] = c[BULK] / volume_a * (flow_a - c[AREA] * y[3] - leak)
    slope[1] = c[BULK] / volume_b * (area_b * y[3] - flow_b + leak)
    spring = c[SPRING] * (y[2] - c[REST])
    driven = c[AREA] * y[0] - area_b * y[1] - c[VISCOUS] * y[3] - spring + r[2] - _stop(c, y[2], y[3])
    slope[2] = y[3]
    slope[3] = (driven - friction(c, y[3], z)[0]) / c[MASS]
    slope[4] = y[5]
    slope[5] = c[SPOOL_OMEGA] * (c[SPOOL_OMEGA] * (current - y[4]) - 2.0 * c[SPOOL_DAMPING] * y[5])
    slope[6] = y[7]
    slope[7] = c[CELL_OMEGA] * (c[CELL_OMEGA] * (spring - y[6]) - 2.0 * c[CELL_DAMPING] * y[7])


@njit(cache=True)
def _stop(c, position, velocity):
    """Force [N] of the end stops. Training never reaches them, so it has no gradient."""
    if position < 0.0:
        return min(STOP_STIFFNESS * position + STOP_DAMPING * velocity, 0.0)
    if position > c[STROKE]:
        return max(STOP_STIFFNESS * (position - c[STROKE]) + STOP_DAMPING * velocity, 0.0)
    return 0.0


@njit(cache=True)
def rates_back(c, y, z, current, r, g, gy, gr, gc):
    """Add to gy, gr, gc the gradients of g . y' by y, r, c; returns that by z."""
    _chambers_back(c, y, r, g, gy, gr, gc)
    spring_force = c[SPRING] * (y[2] - c[REST])
    w, d, pull = c[SPOOL_OMEGA], c[SPOOL_DAMPING], current - y[4]
    gy[5] += g[4] - 2.0 * w * d * g[5]
    gy[4] -= w * w * g[5]
    gc[SPOOL_OMEGA] += (2.0 * w * pull - 2.0 * d * y[5]) * g[5]
    gc[SPOOL_DAMPING] -= 2.0 * w * y[5] * g[5]
    w, d, pull = c[CELL_OMEGA], c[CELL_DAMPING], spring_force - y[6]
    gy[7] += g[6] - 2.0 * w * d * g[7]
    gy[6] -= w * w * g[7]
    gc[CELL_OMEGA] += (2.0 * w * pull - 2.0 * d * y[7]) * g[7]
    gc[CELL_DAMPING] -= 2.0 * w * y[7] * g[7]
    push = g[3] / c[MASS]
    gspring = w * w * g[7] - push
    gy[2] += c[SPRING] * gspring
    gc[SPRING] += (y[2] - c[REST]) * gspring
    gc[REST] -= c[SPRING] * gspring
    return _motion_back(c, y, z, r, push, g[2], spring_force, gy, gr, gc)


@njit(cache=True)
def _motion_back(c, y, z, r, push, gx, spring_force, gy, gr, gc):
    """The part of x_p' and x_p'' (but the spring); `push` is the gradient by the force on the mass."""
    velocity, ratio, area = y[3], c[RATIO], c[AREA]
    dry, level, slip, fading, share = friction(c, velocity, z)
    driven = area * y[0] - ratio * area * y[1] - c[VISCOUS] * velocity - spring_force + r[2] - dry
    gc[MASS] -= driven / c[MASS] * push
    gy[0] += area * push
    gy[1] -= ratio * area * push
    gc[AREA] += (y[0] - ratio * y[1]) * push
    gc[RATIO] -= area * y[1] * push
    gc[VISCOUS] -= velocity * push
    gr[2] += push
    # dry = sigma_0 z + sigma_1 fading slip
    gdry = -push
    gslip = c[BRISTLE_DAMPING] * fading * gdry
    gfading = c[BRISTLE_DAMPING] * slip * gdry
    gc[BRISTLE_DAMPING] += fading * slip * gdry
    ratio_v = velocity / c[DAMPING_VELOCITY]
    gc[DAMPING_VELOCITY] += 2.0 * ratio_v * ratio_v / c[DAMPING_VELOCITY] * fading * gfading
    speed, sign = abs(velocity), 1.0 if velocity >= 0.0 else -1.0
    glevel = c[BRISTLE] * speed * z / (level * level) * gslip
    gvelocity = gx - c[VISCOUS] * push - 2.0 * ratio_v / c[DAMPING_VELOCITY] * fading * gfading
    gvelocity += gslip * (1.0 - c[BRISTLE] * sign * z / level)
    gvelocity += level_back(c, velocity, share, glevel, gc)
    gy[3] += gvelocity
    gc[BRISTLE] += z * gdry - speed * z / level * gslip
    return c[BRISTLE] * gdry - c[BRISTLE] * speed / level * gslip


@njit(cache=True)
def level_back(c, velocity, share, glevel, gc):
    """Gradient of the friction level: adds those by its constants, returns that by velocity."""
    ratio_v = velocity / c[STRIBECK_VELOCITY]
    gc[COULOMB] += glevel
    gc[STRIBECK] += share * glevel
    gc[STRIBECK_VELOCITY] += 2.0 * ratio_v * ratio_v / c[STRIBECK_VELOCITY] * c[STRIBECK] * share * glevel
    return -2.0 * ratio_v / c[STRIBECK_VELOCITY] * c[STRIBECK] * share * glevel


@njit(cache=True)
def _chambers_back(c, y, r, g, gy, gr, gc):
    """The part of p_a' and p_b'."""
    area, ratio = c[AREA], c[RATIO]
    area_b = ratio * area
    rest_of_stroke = c[STROKE] - y[2]
    volume_a, volume_b = c[DEAD_A] + area * y[2], c[DEAD_B] + area_b * rest_of_stroke
    opening = y[4] + c[OFFSET]
    drop_a, drop_b, gain_a, gain_b = _valve(c, y, opening)
    (root_a, bend_a), (root_b, bend_b) = root(drop_a), root(drop_b)
    flow_a, flow_b = gain_a * opening * root_a, gain_b * opening * root_b
    leak = c[LEAK] * (y[0] - y[1])
    into_a = flow_a * (1.0 + r[0]) - area * y[3] - leak
    into_b = area_b * y[3] - flow_b * (1.0 + r[1]) + leak
    ga, gb = c[BULK] / volume_a * g[0], c[BULK] / volume_b * g[1]
    gc[BULK] += into_a / volume_a * g[0] + into_b / volume_b * g[1]
    gva, gvb = -into_a / volume_a * ga, -into_b / volume_b * gb
    gc[DEAD_A] += gva
    gc[DEAD_B] += gvb
    gy[2] += area * gva - area_b * gvb
    gy[3] += area_b * gb - area * ga
    garea_b = rest_of_stroke * gvb + y[3] * gb
    gc[AREA] += y[2] * gva - y[3] * ga + ratio * garea_b
    gc[RATIO] += area * garea_b
    gleak = gb - ga
    gc[LEAK] += (y[0] - y[1]) * gleak
    gy[0] += c[LEAK] * gleak
    gy[1] -= c[LEAK] * gleak
    gr[0] += flow_a * ga
    gr[1] -= flow_b * gb
    ga, gb = (1.0 + r[0]) * ga, -(1.0 + r[1]) * gb  # now by flow_a, flow_b
    gopening = gain_a * root_a * ga + gain_b * root_b * gb
    gy[4] += gopening
    gc[OFFSET] += gopening
    gdrop_a, gdrop_b = gain_a * opening * bend_a * ga, gain_b * opening * bend_b * gb
    if opening >= 0.0:
        gc[KA_POSITIVE] += opening * root_a * ga
        gc[KB_POSITIVE] += opening * root_b * gb
        gc[SUPPLY] += gdrop_a
        gy[0] -= gdrop_a
        gy[1] += gdrop_b
        gc[TANK] -= gdrop_b
    else:
        gc[KA_NEGATIVE] += opening * root_a * ga
        gc[KB_NEGATIVE] += opening * root_b * gb
        gy[0] += gdrop_a
        gc[TANK] -= gdrop_a
        gc[SUPPLY] += gdrop_b
        gy[1] -= gdrop_b
