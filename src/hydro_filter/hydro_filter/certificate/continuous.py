# SPDX-License-Identifier: Apache-2.0
"""Certificate of eq. cont_require_6 along the force error, as a constraint a du <= b on the correction.

    M_c = v' (M' + sym(M (A + B K)) + 2 lambda M) v          holds if M_c <= 0
    a   = 2 v' M B                                           M_c with du is a du - b
    b   = -M_c

on normalized states, with v a displacement from the reference along the load force only (eq. v)::

    v = [0, 0, -e, 0, 0, 0, 0, 0] / 300 N        e = f_r - f_l

**Erratum.** The paper prints +e. M_c does not depend on this sign, but a does: du enters the displacement x - x_r with
+B (eq. cont_require_8), and the load force's part of x - x_r is f_l - f_r = -e. With the printed sign the correction
pushes the force away from its reference; a test closes the loop with both.

Near e = 0 the half-line vanishes with v. Errors within the load cell's noise are ignored: e passes a smooth dead zone,
zero up to `noise_floor` and unchanged from twice that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter.metric.constant import Metric
from hydro_filter.model.dynamics import Dynamics
from hydro_filter.model.force_law import Controller
from hydro_filter.model.sample import Sample
from hydro_filter.model.state import LOAD_FORCE, STATES
from hydro_sim.jit import njit


class HalfLine(NamedTuple):
    """Corrections that satisfy the certificate: a du <= b. NaN if any input was not finite."""

    a: float
    """1/A/s: the certificate's slope in du."""
    b: float
    """1/s: minus the certificate without a correction."""

    def value(self, delta_u: float) -> float:
        """M_c [1/s] under a correction [A]."""
        return self.a * delta_u - self.b


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Evaluates M_c from a metric, a model and a law, each exchangeable behind its protocol."""

    metric: Metric
    dynamics: Dynamics
    controller: Controller
    scale: FloatArray
    """Scale of each state, shape (8,); `state_scale`."""
    current_max: float
    """u_max [A], above 0: the model is linearized at the valve's actual current, sat(u_nom)."""
    contraction_rate: float = 0.1
    """lambda [1/s], [0, 50]; the paper's 0.1."""
    noise_floor: float = 1.8
    """N, errors up to it are ignored, [0, 100]; three standard deviations of the load cell."""

    def displacement(self, sample: Sample) -> FloatArray:
        """Return v on normalized states, shape (8,)."""
        v = np.zeros(STATES)
        error = dead_zone(sample.reference_force - sample.state[LOAD_FORCE], self.noise_floor)
        v[LOAD_FORCE] = -error / self.scale[LOAD_FORCE]
        return v

    def evaluate(self, sample: Sample, v: FloatArray | None = None) -> HalfLine:
        """Return a and b at a sample, along `v` (normalized, shape (8,); default: `displacement`)."""
        v = self.displacement(sample) if v is None else v
        current = min(max(sample.nominal_current, -self.current_max), self.current_max)
        linear = self.dynamics.linearize(sample.state, current)
        gradient = self.controller.gradient(sample)
        matrix = self.metric.matrix(sample.state)
        rate = self.metric.rate(sample.state, linear.state_rate)
        a, b = half_line(
            matrix, rate, linear.state_matrix, linear.input_vector, gradient, self.scale, v, self.contraction_rate
        )
        return HalfLine(a, b)


@njit
def dead_zone(error, floor):
    """Return the error [N], zero up to `floor` and unchanged from twice the floor, with a continuous slope between."""
    size = abs(error)
    if size >= 2.0 * floor or not size > 0.0:  # NaN stays NaN
        return error
    if size <= floor:
        return 0.0
    share = size / floor - 1.0
    return error * share * share * (3.0 - 2.0 * share)


@njit
def half_line(metric, metric_rate, state_matrix, input_vector, gradient, scale, v, contraction_rate):
    """Return a and b; M, M' on normalized states, A, B, K in SI units, v normalized."""
    moved = scale * v  # v in SI units
    feedback = 0.0
    for i in range(STATES):
        feedback += gradient[i] * moved[i]
    drift, push, size, turn = 0.0, 0.0, 0.0, 0.0
    for i in range(STATES):
        weight, turned, flow = 0.0, 0.0, input_vector[i] * feedback
        for j in range(STATES):
            weight += metric[i, j] * v[j]
            turned += metric_rate[i, j] * v[j]
            flow += state_matrix[i, j] * moved[j]
        drift += weight * flow / scale[i]
        push += weight * input_vector[i] / scale[i]
        size += weight * v[i]
        turn += turned * v[i]
    return 2.0 * push, -(turn + 2.0 * drift + 2.0 * contraction_rate * size)
