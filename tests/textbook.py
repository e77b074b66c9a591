# SPDX-License-Identifier: Apache-2.0
"""The box's equations integrated step by step: a second writing of the analytic plant to check it against."""

from __future__ import annotations

import numpy as np

from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq
from hydro_sim.model.hydraulics import pressure_rates

STATES = 6
SUBSTEPS = 20
"""Of a sample, as the plant takes them."""


@njit
def rates(bench, y, current, out):
    """Write y' at a valve current [A] into `out`, shape (6,)."""
    out[0], out[1] = pressure_rates(bench, y[0], y[1], y[2], y[3], current)
    force = eq.spring_force(bench, y[2])
    driven = eq.hydraulic_force(bench, y[0], y[1]) - eq.stop_force(bench, y[2], y[3])
    out[2] = y[3]
    out[3] = (driven - bench.viscous_friction * y[3] - force) / bench.moving_mass
    out[4] = y[5]
    out[5] = eq.amplifier(bench.load_cell_omega, force, y[4], y[5])


@njit
def advance(bench, y, current, duration, steps):
    """Integrate y, shape (6,), in place over `duration` [s] at a held current [A] by `steps` steps of classic RK4.

    Pressures are kept from falling below zero: the oil cavitates there, and the volume it then lacks is not accounted
    for. An ideal load cell (omega 0) shows the spring's force as it is.
    """
    step = duration / steps
    slopes = np.empty((4, STATES))
    probe = np.empty(STATES)
    for _ in range(steps):
        rates(bench, y, current, slopes[0])
        for stage in range(1, 4):
            reach = step if stage == 3 else 0.5 * step
            for i in range(STATES):
                probe[i] = y[i] + reach * slopes[stage - 1, i]
            rates(bench, probe, current, slopes[stage])
        for i in range(STATES):
            y[i] += step / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
        y[0] = max(y[0], 0.0)
        y[1] = max(y[1], 0.0)
    if bench.load_cell_omega == 0.0:
        y[4] = eq.spring_force(bench, y[2])
