# SPDX-License-Identifier: Apache-2.0
"""Dynamics x' = f(x, u) on the paper's eight states, with exact Jacobians A = df/dx and B = df/du.

The eight states describe a plant of four (f_h follows from the pressures, f_l and f_l' from the piston), so f is not
unique off the consistent states. The choice here, row by row::

    f_h'   = h(x_p, x_p') + g(x_p, p_a, p_b) u         eq. q13, not the state f_h' itself
    f_h''  = d/dt (h + g u) at held u                  by the chain rule along x_p', x_p'', p_a', p_b'
    f_l'   = the state f_l'
    f_l''  = k_s x_p''                                 x_p'' = (f_h - b x_p' - k_s (x_p - x_rest)) / m
    p_a', p_b', x_p' as in hydro_sim.model.hydraulics        x_p'' as above

The spring's force on the mass is taken from the position, not from the load cell: then f_l enters the motion by the
feedback alone, as it does on a bench whose load cell lags, and a displacement along f_l asks what the feedback does to
it. Source: paper eq. q13-q15 with physics.md's erratum; the derivation is checked against `hydraulics` in the
tests.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter.model import analytic_kernels
from hydro_filter.model.state import STATES
from hydro_sim.model.bench import Bench


class Linearization(NamedTuple):
    """f and its Jacobians at one state and current, SI units."""

    state_matrix: FloatArray
    """A = df/dx, shape (8, 8)."""
    input_vector: FloatArray
    """B = df/du, shape (8,)."""
    state_rate: FloatArray
    """x' = f(x, u), shape (8,)."""


class Dynamics(Protocol):
    """A differentiable model of the bench."""

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """Return A, B and x' at state x, shape (8,), and valve current [A]."""


class AnalyticDynamics:
    """The nominal bench (`f` in this module's docstring)."""

    def __init__(self, bench: Bench) -> None:
        self.constants = bench.constants()

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """See `Dynamics.linearize`. The arrays are new ones."""
        linear = Linearization(np.empty((STATES, STATES)), np.empty(STATES), np.empty(STATES))
        analytic_kernels.linearize(self.constants, state, current, linear.state_matrix, linear.input_vector)
        analytic_kernels.state_rate(self.constants, state, current, linear.state_rate)
        return linear
