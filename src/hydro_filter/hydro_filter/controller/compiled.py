# SPDX-License-Identifier: Apache-2.0
"""Filter with the constant metric as one compiled call, for vectorised environments.

::

    parts = filter_parts(contraction_filter.certificate)
    decide(parts, x, u_nom, f_r, K_p)                           delta_u, before, after, status

The QP is solved by its closed form; the results equal those of `ContractionFilter.correct`, which checks OSQP against
the same form. `loop_decision.decide` is the counterpart with the learned metric.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_filter.certificate import continuous, qp
from hydro_filter.certificate.continuous import Certificate
from hydro_filter.metric.constant import ConstantMetric
from hydro_filter.model import analytic_kernels, force_law
from hydro_filter.model.dynamics import AnalyticDynamics
from hydro_filter.model.force_law import ForceLaw
from hydro_filter.model.state import LOAD_FORCE, STATES
from hydro_sim.jit import njit


class FilterParts(NamedTuple):
    """A `Certificate` as arrays for the kernels."""

    metric: FloatArray
    """M, shape (8, 8)."""
    metric_rate: FloatArray
    """Zero, shape (8, 8)."""
    model: npt.NDArray[np.void]
    """Constants of the linearized model, shape (1,)."""
    bench: npt.NDArray[np.void]
    """Constants assumed by the box, shape (1,)."""
    gain_floor: float
    """N/s/A, the force law's."""
    scale: FloatArray
    """Shape (8,)."""
    current_max: float
    contraction_rate: float
    noise_floor: float


def filter_parts(source: Certificate) -> FilterParts:
    """Return the parts of a certificate.

    Raises
    ------
    TypeError
        If its metric, model or law has no compiled form.
    """
    metric, law, model = source.metric, source.controller, source.dynamics
    known = isinstance(metric, ConstantMetric) and isinstance(law, ForceLaw) and isinstance(model, AnalyticDynamics)
    if not known:
        names = (type(part).__name__ for part in (metric, model, law))
        raise TypeError(f"no compiled form of {', '.join(names)} together")
    assert isinstance(law, ForceLaw) and isinstance(model, AnalyticDynamics)
    at = np.zeros(STATES)
    return FilterParts(
        metric=metric.matrix(at),
        metric_rate=metric.rate(at, at),
        model=model.constants,
        bench=law.constants,
        gain_floor=law.gain_floor,
        scale=source.scale,
        current_max=source.current_max,
        contraction_rate=source.contraction_rate,
        noise_floor=source.noise_floor,
    )


@njit
def half_line(parts, x, nominal, reference, gain):
    """Return a and b of `Certificate.evaluate`, at x (8,), u_nom [A], f_r [N], K_p [1/s]."""
    state_matrix, input_vector = np.empty((STATES, STATES)), np.empty(STATES)
    law, v = np.empty(STATES), np.zeros(STATES)
    current = min(max(nominal, -parts.current_max), parts.current_max)
    analytic_kernels.linearize(parts.model, x, current, state_matrix, input_vector)
    force_law.gradient(parts.bench, x, nominal, gain, parts.gain_floor, law)
    v[LOAD_FORCE] = -continuous.dead_zone(reference - x[LOAD_FORCE], parts.noise_floor) / parts.scale[LOAD_FORCE]
    return continuous.half_line(
        parts.metric, parts.metric_rate, state_matrix, input_vector, law, parts.scale, v, parts.contraction_rate
    )


@njit
def decide(parts, x, nominal, reference, gain):
    """Return delta_u [A], M_c before and after [1/s] and status, as `ContractionFilter.correct` of one sample."""
    finite = math.isfinite(nominal)
    for i in range(STATES):
        finite = finite and math.isfinite(x[i])
    if not finite:
        return 0.0, math.nan, math.nan, qp.NAN
    a, b = half_line(parts, x, nominal, reference, gain)
    limit = parts.current_max
    applied = min(max(nominal, -limit), limit)
    change, status = qp.closed_form_kernel(a, b, -limit - applied, limit - applied)
    if status == qp.NAN:
        return 0.0, -b, -b, status
    delta_u = change + (applied - nominal) if change != 0.0 else 0.0
    return delta_u, -b, a * change - b, status
