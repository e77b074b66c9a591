# SPDX-License-Identifier: Apache-2.0
"""Increment of x over a sample by the bench file's equations, and its gradient; `deep` learns the residual.

x is taken for the state: p_a, p_b, x_p, x_p' and, behind an amplifier, f_l and f_l' begin a sample of
`hydraulics.advance`, and what these gain is added to x. A bias of a sensor therefore stays where it is. The remaining
rates are what the box makes of the gains. f_h moves nothing; without an amplifier nor does f_l.

Nothing here or in `deep` is compiled with fastmath: numba would compile, and cache, `hydraulics` for everybody with it.
"""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.model import hydraulics
from hydro_sim.model.compiled_equations import equations

STATES = 8

SUBSTEPS = 2
"""Runge-Kutta steps per sample, 500 us: a 22nd of a period of the 90 Hz mass-on-oil mode."""

NUDGES: FloatArray = np.array([0.0, 0.0, 1e-3, 1e-1, 1e2, 1e2, 1e-8, 1e-6])
"""Steps of the finite differences that give the gradient, units of x."""


@njit
def gain(physics, x, current, moved):
    """Write into `moved`, shape (8,), what x, shape (8,), gains in a sample at a held current [A].

    `physics`: the bench's constants, shape (1,), and the box's coefficients for rates, shape (2,).
    """
    bench, memory, y = physics[0][0], physics[1][0], np.empty(hydraulics.STATES)
    copies.vector(y, x[4:8])
    y[4], y[5] = x[2], x[3]
    hydraulics.advance(bench, y, current, SAMPLE_PERIOD, SUBSTEPS)
    moved[0] = equations.hydraulic_force(bench, y[0] - x[4], y[1] - x[5])
    moved[1] = (1.0 - memory) * (moved[0] / SAMPLE_PERIOD - x[1])
    if bench.load_cell_omega > 0.0:
        moved[2], moved[3] = y[4] - x[2], y[5] - x[3]
    else:
        moved[2] = bench.spring_stiffness * (y[2] - x[6])
        moved[3] = (1.0 - memory) * (moved[2] / SAMPLE_PERIOD - x[3])
    for i in range(4):
        moved[4 + i] = y[i] - x[4 + i]


@njit
def add_gradient(physics, x, current, after, before):
    """Add to `before` what a gradient `after`, both by x and of shape (8,), is by way of `gain`."""
    moved, nudged, lagging = np.empty(STATES), np.empty(STATES), physics[0][0].load_cell_omega > 0.0
    gain(physics, x, current, moved)
    before[1] -= (1.0 - physics[1][0]) * after[1]
    if not lagging:
        before[3] -= (1.0 - physics[1][0]) * after[3]
    for j in range(2 if lagging else 4, STATES):
        kept = x[j]
        x[j] += NUDGES[j]
        gain(physics, x, current, nudged)
        x[j] = kept
        for i in range(STATES):
            before[j] += after[i] * (nudged[i] - moved[i]) / NUDGES[j]
