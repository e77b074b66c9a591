# SPDX-License-Identifier: Apache-2.0
"""Compiled slopes of f_h' of the analytic bench.

Written by `python -m hydro_filter.model.generate` from `analytic_equations`: edit that, not this.
"""

from __future__ import annotations

from hydro_filter.model.analytic_equations import root_slopes
from hydro_sim.jit import njit


@njit
def force_rate_slopes(bench, state, current):
    """Slopes of F(x, u) = h + g u, f_h' of eq. q13: dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b, and g = dF/du."""
    root_a, root_b, slope_a, slope_b = root_slopes(bench, state[4], state[5], current)
    a0 = bench.valve_gain * root_a
    a1 = bench.piston_area * state[7]
    a2 = 1.0 / (bench.dead_volume_a + bench.piston_area * state[6])
    a3 = bench.bulk_modulus * a2
    a4 = bench.valve_gain * root_b
    a5 = bench.area_ratio * bench.piston_area
    a6 = 1.0 / (bench.dead_volume_b + a5 * (bench.stroke - state[6]))
    a7 = bench.bulk_modulus * a6
    by_position = -(
        bench.piston_area
        * (
            (a0 * current - a1) * (a3 * a2 * bench.piston_area)
            + bench.area_ratio * ((bench.area_ratio * a1 - a4 * current) * (a7 * a6 * a5))
        )
    )
    by_velocity = -(bench.piston_area * (a3 * bench.piston_area + bench.area_ratio * (a7 * a5)))
    a8 = current * bench.valve_gain
    by_a = bench.piston_area * (a3 * a8) * slope_a
    by_b = bench.piston_area * (bench.area_ratio * (a7 * a8)) * slope_b
    by_current = bench.piston_area * (a3 * a0 + bench.area_ratio * (a7 * a4))
    return by_position, by_velocity, by_a, by_b, by_current
