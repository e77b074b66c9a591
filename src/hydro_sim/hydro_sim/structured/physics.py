# SPDX-License-Identifier: Apache-2.0
"""Equations of the structured model: `model.equations` with textbook extensions; `derivatives` has theirs.

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

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq

(
    BULK, AREA, RATIO, DEAD_A, DEAD_B, SUPPLY, TANK, KA_POSITIVE, KA_NEGATIVE, KB_POSITIVE, KB_NEGATIVE, OFFSET, LEAK,
    MASS, VISCOUS, SPRING, REST, SPOOL_OMEGA, SPOOL_DAMPING, CELL_OMEGA, CELL_DAMPING, COULOMB, STRIBECK,
    STRIBECK_VELOCITY, BRISTLE, BRISTLE_DAMPING, DAMPING_VELOCITY, GAIN_H, BIAS_H, GAIN_L, BIAS_L, STROKE,
) = range(32)  # fmt: skip
CONSTANTS = 32

LAMINAR = 1e4  # Pa: below about this pressure drop the root is rounded off, so that its slope is finite


@register_jitable
def root(drop):
    """sqrt of a pressure drop [Pa], odd and rounded off at zero."""
    return drop / np.sqrt(np.sqrt(drop * drop + LAMINAR * LAMINAR))


class Numbers(NamedTuple):
    """What `model.equations` needs of `c`, by the names in bench.yaml."""

    piston_area: Any
    area_ratio: Any
    dead_volume_a: Any
    dead_volume_b: Any
    stroke: Any


@register_jitable
def numbers(c):
    """The `Numbers` in c."""
    return Numbers(c[AREA], c[RATIO], c[DEAD_A], c[DEAD_B], c[STROKE])


@register_jitable
def stiffnesses(c, position):
    """beta/V [Pa/m3] of both chambers at piston position [m]."""
    return eq.stiffnesses(numbers(c), (c[BULK], c[BULK]), position)


@register_jitable
def flow_gains(c, pressure_a, pressure_b, opening):
    """Flows [m3/s/A] into both chambers per opening of the valve, on the side of `opening` [A]; and k_a there."""
    out, back = eq.edge_drops(c[SUPPLY], c[TANK], pressure_a, pressure_b)
    positive = opening >= 0.0
    k_a, k_b = eq.choose(positive, c[KA_POSITIVE], c[KA_NEGATIVE]), eq.choose(positive, c[KB_POSITIVE], c[KB_NEGATIVE])
    into_a, into_b = k_a * root(eq.choose(positive, out[0], back[0])), -k_b * root(eq.choose(positive, out[1], back[1]))
    return into_a, into_b, k_a


@register_jitable
def chambers(c, y, r):
    """p_a', p_b' [Pa/s]."""
    opening, leak = y[4] + c[OFFSET], c[LEAK] * (y[0] - y[1])
    gain_a, gain_b, _ = flow_gains(c, y[0], y[1], opening)
    flows = gain_a * opening * (1.0 + r[0]) - leak, gain_b * opening * (1.0 + r[1]) + leak
    return eq.pressure_rates(numbers(c), stiffnesses(c, y[2]), flows, y[3])


@register_jitable
def friction_level(c, velocity):
    """Dry friction [N] while sliding at a velocity [m/s]."""
    return c[COULOMB] + c[STRIBECK] * np.exp(-((velocity / c[STRIBECK_VELOCITY]) ** 2))


@register_jitable
def friction(c, velocity, bristle):
    """Dry friction [N] against motion."""
    speed = eq.choose(velocity >= 0.0, velocity, -velocity)
    slip = velocity - c[BRISTLE] * speed / friction_level(c, velocity) * bristle
    fading = np.exp(-((velocity / c[DAMPING_VELOCITY]) ** 2))
    return c[BRISTLE] * bristle + c[BRISTLE_DAMPING] * fading * slip


@register_jitable
def lag(omega, damping, target, value, rate):
    """Second derivative of a value that follows a target."""
    return omega * (omega * (target - value) - 2.0 * damping * rate)


@register_jitable
def rates_under(c, y, current, r, against, slope):
    """y' into `slope`, with forces [N] `against` the motion: dry friction, end stops."""
    spring = c[SPRING] * (y[2] - c[REST])
    driven = eq.hydraulic_force(numbers(c), y[0], y[1]) - c[VISCOUS] * y[3] - spring + r[2] - against
    slope[0], slope[1] = chambers(c, y, r)
    slope[2], slope[3] = y[3], driven / c[MASS]
    slope[4], slope[5] = y[5], lag(c[SPOOL_OMEGA], c[SPOOL_DAMPING], current, y[4], y[5])
    slope[6], slope[7] = y[7], lag(c[CELL_OMEGA], c[CELL_DAMPING], spring, y[6], y[7])


@njit
def rates(c, y, z, current, r, slope):
    """y' into `slope`, shape (8,)."""
    rates_under(c, y, current, r, friction(c, y[3], z) + eq.stop_force(numbers(c), y[2], y[3]), slope)
