# SPDX-License-Identifier: Apache-2.0
"""Compiled analytic bench of `dynamics`: x' = f(x, u) with exact A and B, and the slopes of f_h'.

Written by `python -m hydro_filter.model.generate` from `analytic_equations`: edit that, not this.
"""

from __future__ import annotations

from hydro_filter.model.analytic_equations import root_slopes
from hydro_sim.jit import njit


@njit
def state_rate(constants, state, current, out):
    """Write x' into `out`, shape (8,); `constants` of shape (1,)."""
    bench = constants[0]
    root_a, root_b, slope_a, slope_b, _, _ = root_slopes(bench, state[4], state[5], current)
    a0 = 1.0 / (bench.dead_volume_a + bench.piston_area * state[6])
    a1 = bench.bulk_modulus * a0
    a2 = bench.piston_area * state[7]
    a3 = bench.valve_gain * root_a * current - a2
    a4 = a1 * a3
    a5 = bench.area_ratio * bench.piston_area
    a6 = 1.0 / (bench.dead_volume_b + a5 * (bench.stroke - state[6]))
    a7 = bench.bulk_modulus * a6
    a8 = bench.area_ratio * a2 - bench.valve_gain * root_b * current
    a9 = a7 * a8
    out[0] = bench.piston_area * (a4 - bench.area_ratio * a9)
    a10 = current * bench.valve_gain
    a11 = (
        state[0]
        - (bench.viscous_friction * state[7] + bench.spring_stiffness * (state[6] - bench.spring_rest_position))
    ) / bench.moving_mass
    out[1] = (
        bench.piston_area * (a1 * a10) * slope_a * a4
        - (
            bench.piston_area
            * (a3 * (a1 * a0 * bench.piston_area) + bench.area_ratio * (a8 * (a7 * a6 * a5)))
            * state[7]
            + bench.piston_area * (a1 * bench.piston_area + bench.area_ratio * (a7 * a5)) * a11
        )
        + bench.piston_area * (bench.area_ratio * (a7 * a10)) * slope_b * a9
    )
    out[2] = state[3]
    out[3] = bench.spring_stiffness * a11
    out[4] = a4
    out[5] = a9
    out[6] = state[7]
    out[7] = a11


@njit
def linearize(constants, state, current, state_matrix, input_vector):
    """Write A, shape (8, 8), and B, shape (8,); `constants` of shape (1,)."""
    bench = constants[0]
    state_matrix[:] = 0.0
    root_a, root_b, slope_a, slope_b, bend_a, bend_b = root_slopes(bench, state[4], state[5], current)
    a0 = 1.0 / (bench.dead_volume_a + bench.piston_area * state[6])
    a1 = bench.bulk_modulus * a0
    a2 = current * bench.valve_gain
    a3 = a1 * a2
    a4 = bench.piston_area * a3
    a5 = a4 * slope_a
    state_matrix[0, 4] = a5
    a6 = bench.area_ratio * bench.piston_area
    a7 = 1.0 / (bench.dead_volume_b + a6 * (bench.stroke - state[6]))
    a8 = bench.bulk_modulus * a7
    a9 = a8 * a2
    a10 = bench.piston_area * (bench.area_ratio * a9)
    a11 = a10 * slope_b
    state_matrix[0, 5] = a11
    a12 = bench.valve_gain * root_a
    a13 = bench.piston_area * state[7]
    a14 = a12 * current - a13
    a15 = a1 * a0
    a16 = a15 * bench.piston_area
    a17 = a14 * a16
    a18 = bench.valve_gain * root_b
    a19 = bench.area_ratio * a13 - a18 * current
    a20 = a8 * a7
    a21 = a20 * a6
    a22 = a19 * a21
    a23 = bench.piston_area * (a17 + bench.area_ratio * a22)
    state_matrix[0, 6] = -a23
    a24 = a1 * bench.piston_area
    a25 = a8 * a6
    a26 = bench.piston_area * (a24 + bench.area_ratio * a25)
    state_matrix[0, 7] = -a26
    a27 = 1.0 / bench.moving_mass
    state_matrix[1, 0] = -(a26 * a27)
    a28 = a1 * a14
    state_matrix[1, 4] = (a5 * a3 - state[7] * (bench.piston_area * (a16 * a2))) * slope_a + a28 * a4 * bend_a
    a29 = a8 * a19
    state_matrix[1, 5] = (
        state[7] * (bench.piston_area * (bench.area_ratio * (a21 * a2))) - a11 * a9
    ) * slope_b + a29 * a10 * bend_b
    a30 = bench.spring_stiffness * a27
    state_matrix[1, 6] = (
        a29 * (slope_b * (bench.piston_area * (bench.area_ratio * (a2 * a21))))
        + a11 * a22
        - (
            a28 * (slope_a * (bench.piston_area * (a2 * a16)))
            + a5 * a17
            + (
                state[7]
                * (
                    bench.piston_area
                    * (
                        bench.area_ratio * (a19 * (a6 * (a21 * a7 + a20 * a7 * a6)))
                        - a14 * (bench.piston_area * (a16 * a0 + a15 * a0 * bench.piston_area))
                    )
                )
                + (
                    (
                        state[0]
                        - (
                            bench.viscous_friction * state[7]
                            + bench.spring_stiffness * (state[6] - bench.spring_rest_position)
                        )
                    )
                    * a27
                    * (bench.piston_area * (bench.area_ratio * (a6 * a21) - bench.piston_area * a16))
                    - a26 * a30
                )
            )
        )
    )
    a31 = bench.viscous_friction * a27
    state_matrix[1, 7] = a11 * a25 - (
        a5 * a24
        + (state[7] * (bench.piston_area * (bench.area_ratio * (a21 * a6) - a16 * bench.piston_area)) + a23 - a26 * a31)
    )
    state_matrix[2, 3] = 1.0
    state_matrix[3, 0] = a30
    state_matrix[3, 6] = -(bench.spring_stiffness * a30)
    state_matrix[3, 7] = -(bench.spring_stiffness * a31)
    state_matrix[4, 4] = a3 * slope_a
    state_matrix[4, 6] = -a17
    state_matrix[4, 7] = -a24
    state_matrix[5, 5] = -(a9 * slope_b)
    state_matrix[5, 6] = a22
    state_matrix[5, 7] = a25
    state_matrix[6, 7] = 1.0
    state_matrix[7, 0] = a27
    state_matrix[7, 6] = -a30
    state_matrix[7, 7] = -a31
    a32 = a1 * a12
    a33 = a8 * a18
    input_vector[0] = bench.piston_area * (a32 + bench.area_ratio * a33)
    input_vector[1] = (
        a28 * (slope_a * (bench.piston_area * (a1 * bench.valve_gain)))
        + a5 * a32
        - state[7] * (bench.piston_area * (a16 * a12 - bench.area_ratio * (a21 * a18)))
        + (a29 * (slope_b * (bench.piston_area * (bench.area_ratio * (a8 * bench.valve_gain)))) - a11 * a33)
    )
    input_vector[2] = 0.0
    input_vector[3] = 0.0
    input_vector[4] = a32
    input_vector[5] = -a33
    input_vector[6] = 0.0
    input_vector[7] = 0.0


@njit
def force_rate_slopes(bench, state, current):
    """Slopes of F(x, u) = h + g u, f_h' of eq. q13: dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b."""
    root_a, root_b, slope_a, slope_b, _, _ = root_slopes(bench, state[4], state[5], current)
    a0 = bench.piston_area * state[7]
    a1 = 1.0 / (bench.dead_volume_a + bench.piston_area * state[6])
    a2 = bench.bulk_modulus * a1
    a3 = bench.area_ratio * bench.piston_area
    a4 = 1.0 / (bench.dead_volume_b + a3 * (bench.stroke - state[6]))
    a5 = bench.bulk_modulus * a4
    by_position = -(
        bench.piston_area
        * (
            (bench.valve_gain * root_a * current - a0) * (a2 * a1 * bench.piston_area)
            + bench.area_ratio * ((bench.area_ratio * a0 - bench.valve_gain * root_b * current) * (a5 * a4 * a3))
        )
    )
    by_velocity = -(bench.piston_area * (a2 * bench.piston_area + bench.area_ratio * (a5 * a3)))
    a6 = current * bench.valve_gain
    by_a = bench.piston_area * (a2 * a6) * slope_a
    by_b = bench.piston_area * (bench.area_ratio * (a5 * a6)) * slope_b
    return by_position, by_velocity, by_a, by_b
