# SPDX-License-Identifier: Apache-2.0
"""Jacobians A = df/dx and B = df/du of a bench on the paper's eight states, as the certificate along f_l asks for them.

The spring's force on the mass is taken from the position, not from the load cell: then f_l enters the motion by the
feedback alone, as it does on a bench whose load cell lags, and a displacement along f_l asks what the feedback does to
it. A's column of f_l is therefore zero, and of B the constant metric's row of f_l (`metric.constant`) has f_h's entry
g(x_p, p_a, p_b) alone (eq. q13).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter.model.analytic_kernels import force_rate_slopes
from hydro_filter.model.state import HYDRAULIC_FORCE, STATES
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
    """The nominal bench, as far as a constant metric along f_l sees it (module docstring); all else is zero."""

    def __init__(self, bench: Bench) -> None:
        self.constants = bench.constants()

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """See `Dynamics.linearize`. The arrays are new ones."""
        linear = Linearization(np.zeros((STATES, STATES)), np.zeros(STATES), np.zeros(STATES))
        linear.input_vector[HYDRAULIC_FORCE] = force_rate_slopes(self.constants[0], state, current)[-1]
        return linear
