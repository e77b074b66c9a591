# SPDX-License-Identifier: Apache-2.0
"""Interface of contraction metrics, and a constant metric solved from a Lyapunov inequality.

The force loop moves three combinations of the eight states::

    z = T x = [ f_l ,  f_h - k_s (x_p - x_rest) ,  f_l' ]      T reads the net force from f_h and the position
                       net force on the mass

With the force law of eq. fl_rl in the loop, its current late by `loop_delay` (to first order, u(t) = K x(t - tau)), and
R(x_p) = -(dh/dx_p') / k_s, w = k_s / m::

         [   0         0                  1             ]
    A_c =[ -K_p    -tau R w    tau R b/m + K_p tau - 1  ]      z' = A_c z
         [   0         w                -b/m            ]

Without the delay (tau = 0) this loop is unstable from K_p = b/m = 50 on: cancelling h removes the oil's own damping,
and the delay restores some of it. P solves the Lyapunov equation (A_c + lambda I)' P + P (A_c + lambda I) = -Q at
mid-stroke, and M = T' P T + eps I. A_c is affine in (K_p, R), so that a property at the corners of a range of gains
and positions holds inside; `contraction_rate` gives this range and the tests check it. Source: safety.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import eigh, solve_continuous_lyapunov

from hydro_bridge.signals import FloatArray
from hydro_filter.model.state import (
    FORCE_RATE_SCALE,
    FORCE_SCALE,
    HYDRAULIC_FORCE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    POSITION,
    STATES,
)
from hydro_sim.model.bench import Bench
from hydro_sim.model.hydraulics import velocity_term

READOUT = np.zeros((3, STATES))
"""T in normalized states, where f_h, f_l and k_s (x_p - x_rest) share one scale."""
READOUT[0, LOAD_FORCE] = 1.0
READOUT[1, HYDRAULIC_FORCE], READOUT[1, POSITION] = 1.0, -1.0
READOUT[2, LOAD_FORCE_RATE] = 1.0

LOOP_SCALE = np.array([FORCE_SCALE, FORCE_SCALE, FORCE_RATE_SCALE])
"""Scale of z."""


class Metric(Protocol):
    """M(x) on normalized states (`state_scale`): symmetric, positive definite, shape (8, 8)."""

    def matrix(self, state: FloatArray) -> FloatArray:
        """Return M(x) at a state in SI units, shape (8,)."""

    def rate(self, state: FloatArray, state_rate: FloatArray) -> FloatArray:
        """Return dM/dt [1/s], shape (8, 8), at x along x', both in SI units."""


class ConstantMetric:
    """M(x) = M everywhere.

    Raises
    ------
    ValueError
        If M is not finite, symmetric and positive definite.
    """

    def __init__(self, matrix: FloatArray) -> None:
        self._matrix = np.ascontiguousarray(matrix, dtype=np.float64)
        if self._matrix.shape != (STATES, STATES) or not np.allclose(self._matrix, self._matrix.T):
            raise ValueError(f"a metric is a symmetric {STATES} by {STATES} matrix")
        if not np.linalg.eigvalsh(self._matrix)[0] > 0.0:
            raise ValueError("the metric is not positive definite")
        self._rate = np.zeros((STATES, STATES))

    def matrix(self, state: FloatArray) -> FloatArray:
        """Return M."""
        return self._matrix

    def rate(self, state: FloatArray, state_rate: FloatArray) -> FloatArray:
        """Return zero."""
        return self._rate


@dataclass(frozen=True, kw_only=True)
class MetricDesign:
    """Loops for which the constant metric is solved. The defaults cover K_p from 45 to 90 over the whole stroke."""

    proportional_gain: float = 60.0
    """1/s, the loop at which the equation is solved, (0, 200]."""
    loop_delay: float = 1.5e-3
    """s, age of the law's current: half a sample of hold, one of velocity filtering, (0, 0.01]."""
    decay: float = 0.1
    """1/s, lambda in the equation, [0, 10]."""
    weights: tuple[float, float, float] = (1.0, 10.0, 0.1)
    """Diagonal of Q for normalized z, each above 0. Searched for the widest range of gains that one P covers."""
    regularization: float = 1e-2
    """eps relative to P_11, [1e-6, 1]: makes M definite on the five directions that the loop does not move."""


def loop_matrix(bench: Bench, *, position: float, proportional_gain: float, loop_delay: float) -> FloatArray:
    """Return A_c (module docstring) on normalized z [1/s], shape (3, 3), at a position [m], gain [1/s], delay [s]."""
    ratio = -float(velocity_term(bench.constants()[0], position, 1.0)) / bench.spring_stiffness
    stiff, damp = bench.spring_stiffness / bench.moving_mass, bench.viscous_friction / bench.moving_mass
    late = loop_delay * ratio
    matrix = np.array(
        [
            [0.0, 0.0, 1.0],
            [-proportional_gain, -late * stiff, late * damp + proportional_gain * loop_delay - 1.0],
            [0.0, stiff, -damp],
        ]
    )
    return matrix * LOOP_SCALE / LOOP_SCALE[:, np.newaxis]


def contraction_rate(weight: FloatArray, matrix: FloatArray) -> float:
    """Return the largest lambda [1/s] with A'P + PA + 2 lambda P <= 0; negative if z'Pz can grow. Shapes (3, 3)."""
    return float(-0.5 * eigh(matrix.T @ weight + weight @ matrix, weight, eigvals_only=True)[-1])


def loop_weight(bench: Bench, design: MetricDesign) -> FloatArray:
    """Solve for P on normalized z, shape (3, 3), with P_11 = 1.

    Raises
    ------
    ValueError
        If the loop of `design` does not decay on this bench, or decays without feedback.
    """
    gain, delay = design.proportional_gain, design.loop_delay
    matrix = loop_matrix(bench, position=0.5 * bench.stroke, proportional_gain=gain, loop_delay=delay)
    shifted = matrix + design.decay * np.eye(3)
    if np.linalg.eigvals(shifted).real.max() >= 0.0:
        raise ValueError(f"K_p = {gain:g} 1/s does not decay at {design.decay:g} 1/s on this bench: no metric for it")
    weight = solve_continuous_lyapunov(shifted.T, -np.diag(design.weights))
    if weight[0, 1] <= 0.0:
        raise ValueError("this metric does not couple load force and net force: it says nothing about the feedback")
    return weight / weight[0, 0]


def constant_metric(bench: Bench, design: MetricDesign | None = None) -> ConstantMetric:
    """Return M = T' P T + eps I (raises as `loop_weight`)."""
    design = design or MetricDesign()
    weight = loop_weight(bench, design)
    return ConstantMetric(READOUT.T @ weight @ READOUT + design.regularization * np.eye(STATES))


def gain_floor(matrix: FloatArray, contraction_rate: float) -> float:
    """Return the gain K_p [1/s] below which the certificate of a constant M = T'PT + eps I is violated.

    kappa = lambda M_33 / M_31: with v along f_l alone, eq. cont_require_6 reads K_p >= kappa (derivation:
    safety.md).
    """
    return float(contraction_rate * matrix[LOAD_FORCE, LOAD_FORCE] / matrix[LOAD_FORCE, HYDRAULIC_FORCE])
