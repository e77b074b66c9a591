# SPDX-License-Identifier: Apache-2.0
"""F(x, u) = h + g u, f_h' of eq. q13, in terms of `hydro_sim.model.equations`; `analytic_kernels` has its slopes.

Their derivatives go by way of the roots of the pressure drops, whose slopes are `root_slopes`: next to zero pressure
drop no steeper than at `SMALLEST_DROP`. Source: paper eq. q13-q15 with physics.md's erratum.
"""

from __future__ import annotations

import numpy as np
from numba.extending import register_jitable

from hydro_filter.model.state import POSITION, VELOCITY
from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq

SMALLEST_DROP = 1e3
"""Pa; the slope of a square root is taken no nearer to zero pressure drop than this: it is infinite there."""


@njit
def root_slopes(bench, pressure_a, pressure_b, opening):
    """Roots of the pressure drops at A and at B under an opening, and their slopes by the pressures."""
    out, back = eq.edge_drops(bench.supply_pressure, bench.tank_pressure, pressure_a, pressure_b)
    (drop_a, drop_b), sign = (out, 1.0) if opening >= 0.0 else (back, -1.0)
    root_a, root_b = eq.signed_root(drop_a), eq.signed_root(drop_b)
    size_a, size_b = np.sqrt(max(abs(drop_a), SMALLEST_DROP)), np.sqrt(max(abs(drop_b), SMALLEST_DROP))
    return root_a, root_b, -0.5 * sign / size_a, 0.5 * sign / size_b


@register_jitable
def pressure_rates(n, state, current, roots):
    """p_a', p_b' [Pa/s] at a valve current [A], given the roots of both pressure drops."""
    stiff = eq.stiffnesses(n, (n.bulk_modulus, n.bulk_modulus), state[POSITION])
    flows = n.valve_gain * roots[0] * current, -(n.valve_gain * roots[1] * current)
    return eq.pressure_rates(n, stiff, flows, state[VELOCITY])


@register_jitable
def force_rate(n, state, current, roots):
    """F(x, u) = h + g u [N/s], f_h' of eq. q13."""
    rate_a, rate_b = pressure_rates(n, state, current, roots)
    return eq.hydraulic_force(n, rate_a, rate_b)
