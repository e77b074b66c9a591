# SPDX-License-Identifier: Apache-2.0
"""Feedback gain K = du/dx of the force law (paper eq. fl_rl), in closed form.

    u = (f_c' + K_p (f_c - f_l) + I - C_1 h) / (C_2 g)        g = g(x_p, p_a, p_b), h = h(x_p, x_p')

    du/df_l  = -K_p / (C_2 g)            du/dx_p  = -(C_1 dh/dx_p + C_2 u dg/dx_p) / (C_2 g)
    du/dx_p' = -C_1 (dh/dx_p') / (C_2 g) du/dp_a  = -u (dg/dp_a) / g,  the same for p_b

The paper's law has f_c = f_r and C_1 = C_2 = 1. K does not depend on f_c: a reference that is shaped leaves the loop
alone. With F(x, u) = h + g u the right side of eq. q13, and h linear in the velocity, C_1 h + C_2 g u is F at C_1 x_p'
and C_2 u: K is its slope at held u over -C_2 g, except along f_l. F's slopes by the pressures go by way of the roots of
the pressure drops (paper eq. q13-q15 with physics.md's erratum). As in `hydro_sim.box.force_law`, C_2 g is no less
than a floor (there dg/dx = 0) and the position is one within the stroke. The integral I, of either form, is the law's
own memory and no function of x: K_i has no place in K, and the certificate does not see it.

K is that of the law before the valve's limit. Beyond the limit the valve passes none of it on: the remaining authority
of the correction is in the QP's bounds (`loop_decision`), not in K.
"""

from __future__ import annotations

import numpy as np

from hydro_filter.model.state import LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, VELOCITY
from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq
from hydro_sim.model.hydraulics import input_gain

PAPER_SCALES = (1.0, 1.0)
"""C_1 and C_2 of the paper's law."""

SMALLEST_DROP = 1e3
"""Pa; the slope of a square root is taken no nearer to zero pressure drop than this: it is infinite there."""


@njit
def gradient(constants, state, current, proportional_gain, gain_floor, out, scales=PAPER_SCALES):
    """Write K, shape (8,), for the law's own current [A], K_p [1/s] and (C_1, C_2); `constants` of shape (1,)."""
    bench, (c_1, c_2) = constants[0], scales
    gain = c_2 * input_gain(bench, state[POSITION], state[PRESSURE_A], state[PRESSURE_B], current)
    felt = c_2 * current if gain > gain_floor else 0.0  # at the floor the law does not depend on changes of g
    gain = max(gain, gain_floor)
    out[:] = state
    out[VELOCITY] *= c_1
    by_position, by_velocity, by_a, by_b = force_rate_slopes(bench, out, felt)
    out[:] = 0.0
    out[LOAD_FORCE] = -proportional_gain / gain
    out[PRESSURE_A] = -by_a / gain
    out[PRESSURE_B] = -by_b / gain
    out[POSITION] = -by_position / gain if 0.0 <= state[POSITION] <= bench.stroke else 0.0
    out[VELOCITY] = -c_1 * by_velocity / gain


@njit
def force_rate_slopes(bench, state, current):
    """Slopes of F(x, u), f_h' of eq. q13, at held u: dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b."""
    root_a, root_b, slope_a, slope_b = root_slopes(bench, state[PRESSURE_A], state[PRESSURE_B], current)
    area, ratio = bench.piston_area, bench.area_ratio
    area_b, displaced = ratio * area, area * state[VELOCITY]
    per_volume_a = 1.0 / (bench.dead_volume_a + area * state[POSITION])
    per_volume_b = 1.0 / (bench.dead_volume_b + area_b * (bench.stroke - state[POSITION]))
    stiffness_a, stiffness_b = bench.bulk_modulus * per_volume_a, bench.bulk_modulus * per_volume_b
    into_a = bench.valve_gain * root_a * current - displaced
    into_b = ratio * displaced - bench.valve_gain * root_b * current
    by_position = -(
        area * (into_a * (stiffness_a * per_volume_a * area) + ratio * (into_b * (stiffness_b * per_volume_b * area_b)))
    )
    by_velocity = -(area * (stiffness_a * area + ratio * (stiffness_b * area_b)))
    opening = current * bench.valve_gain
    by_a = area * (stiffness_a * opening) * slope_a
    by_b = area * (ratio * (stiffness_b * opening)) * slope_b
    return by_position, by_velocity, by_a, by_b


@njit
def root_slopes(bench, pressure_a, pressure_b, opening):
    """Roots of the pressure drops at A and at B under an opening, and their slopes by the pressures."""
    out, back = eq.edge_drops(bench.supply_pressure, bench.tank_pressure, pressure_a, pressure_b)
    (drop_a, drop_b), sign = (out, 1.0) if opening >= 0.0 else (back, -1.0)
    root_a, root_b = eq.signed_root(drop_a), eq.signed_root(drop_b)
    size_a, size_b = np.sqrt(max(abs(drop_a), SMALLEST_DROP)), np.sqrt(max(abs(drop_b), SMALLEST_DROP))
    return root_a, root_b, -0.5 * sign / size_a, 0.5 * sign / size_b
