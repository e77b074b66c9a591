# SPDX-License-Identifier: Apache-2.0
"""The whole filter in one compiled call, by the closed form of its QP: for many benches at once and for compiled loops.

::

    parts = filter_parts(contraction_filter.certificate)       once
    decide(parts, x, hidden, u_nom, f_r, K_p)                   in a compiled loop: delta_u, before, after, status
    bank = FilterBank(contraction_filter.certificate, count=64)
    decisions = bank.correct(records)                           records of STATE_DTYPE, one per bench

The numbers are those of `ContractionFilter.correct`, which holds its OSQP against the same closed form.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from hydro_bridge.signals import PLANT_FIELDS, FloatArray, StateArray
from hydro_filter import certificate, controller, dynamics, model_kernels, qp
from hydro_filter.certificate import Certificate
from hydro_filter.compiled_metric import MetricParts, constant_parts, matrix_and_rate
from hydro_filter.controller import ForceLaw
from hydro_filter.dynamics import AnalyticDynamics
from hydro_filter.metric import ConstantMetric
from hydro_filter.model_dynamics import StructuredDynamics
from hydro_filter.model_kernels import BRISTLE_STATE, HIDDEN
from hydro_filter.state import LOAD_FORCE, STATES, VELOCITY
from hydro_sim.learned.model import Learned


class FilterParts(NamedTuple):
    """A `Certificate` as the kernels take it."""

    metric: MetricParts
    bench: npt.NDArray[np.void]
    """What the box believes, shape (1,)."""
    gain_floor: float
    """N/s/A, the force law's."""
    structured: bool
    """Whether the model is the learned one; else it is `bench`."""
    model: tuple[Any, ...]
    """Of the structured model."""
    ages: FloatArray
    """s, of the box's force rates, shape (1,)."""
    scale: FloatArray
    """Shape (8,)."""
    current_max: float
    contraction_rate: float
    noise_floor: float


def filter_parts(source: Certificate) -> FilterParts:
    """The parts of a certificate.

    Raises
    ------
    TypeError
        If its metric, model or law has no compiled form.
    """
    law, model = source.controller, source.dynamics
    if not isinstance(law, ForceLaw) or not isinstance(model, AnalyticDynamics | StructuredDynamics):
        raise TypeError(f"no compiled form of {type(law).__name__} on {type(model).__name__}")
    learned = model if isinstance(model, StructuredDynamics) else _any_structured()
    return FilterParts(
        metric=_metric_parts(source.metric),
        bench=law.constants,
        gain_floor=law.gain_floor,
        structured=isinstance(model, StructuredDynamics),
        model=learned.compiled,
        ages=learned.ages,
        scale=source.scale,
        current_max=source.current_max,
        contraction_rate=source.contraction_rate,
        noise_floor=source.noise_floor,
    )


def _metric_parts(metric: object) -> MetricParts:
    if isinstance(metric, ConstantMetric):
        return constant_parts(metric)
    raise TypeError(f"no compiled form of {type(metric).__name__}")


def _any_structured() -> StructuredDynamics:
    """Fills the model's place where another is used: compiled code has one type for all."""
    model = Learned.load().model
    return StructuredDynamics(model)  # type: ignore[arg-type]


@njit(cache=True)
def half_line(parts, x, hidden, nominal, reference, gain):
    """a and b of `Certificate.evaluate`, at x (8,), hidden states (3,), u_nom [A], f_r [N], K_p [1/s]."""
    state_matrix, metric, turn = np.empty((STATES, STATES)), np.empty((STATES, STATES)), np.empty((STATES, STATES))
    input_vector, rate, law, v = np.empty(STATES), np.empty(STATES), np.empty(STATES), np.zeros(STATES)
    current = min(max(nominal, -parts.current_max), parts.current_max)
    if parts.structured:
        bristle = hidden[BRISTLE_STATE]
        model_kernels.flow(parts.model, parts.ages, x, bristle, current, state_matrix, input_vector, rate)
    else:
        dynamics.linearize(parts.bench, x, current, state_matrix, input_vector)
        dynamics.state_rate(parts.bench, x, current, rate)
    controller.gradient(parts.bench, x, nominal, gain, parts.gain_floor, law)
    matrix_and_rate(parts.metric, x, rate, metric, turn)
    error = certificate.dead_zone(reference - x[LOAD_FORCE], parts.noise_floor)
    v[LOAD_FORCE] = -error / parts.scale[LOAD_FORCE]
    return certificate.half_line(metric, turn, state_matrix, input_vector, law, parts.scale, v, parts.contraction_rate)


@njit(cache=True)
def decide(parts, x, hidden, nominal, reference, gain):
    """delta_u [A], M_c before and after [1/s], status: `ContractionFilter.correct` of one sample."""
    finite = math.isfinite(nominal)
    for i in range(STATES):
        finite = finite and math.isfinite(x[i])
    if not finite:
        return 0.0, math.nan, math.nan, qp.NAN
    a, b = half_line(parts, x, hidden, nominal, reference, gain)
    limit = parts.current_max
    applied = min(max(nominal, -limit), limit)
    change, status = qp.closed_form_kernel(a, b, -limit - applied, limit - applied)
    if status == qp.NAN:
        return 0.0, -b, -b, status
    delta_u = change + (applied - nominal) if change != 0.0 else 0.0
    return delta_u, -b, a * change - b, status


@njit(cache=True)
def decide_many(parts, x, hidden, nominal, reference, gain, delta_u, before, after, status):
    """`decide` for N benches: x (N, 8), hidden (N, 3), all others (N,)."""
    for k in range(len(x)):
        delta_u[k], before[k], after[k], status[k] = decide(parts, x[k], hidden[k], nominal[k], reference[k], gain[k])


@njit(cache=True)
def settle_many(c, x, current, hidden):
    """Put hidden states that are NaN where current [A] and velocity, held, would lead them."""
    for k in range(len(x)):
        if math.isnan(hidden[k, 0]):
            model_kernels.steady(c, x[k, VELOCITY], current[k], hidden[k])


@njit(cache=True)
def follow_many(c, x, current, hidden):
    """`model_kernels.follow` for N benches, in place; a sample that is not finite is forgotten."""
    for k in range(len(x)):
        if math.isfinite(x[k, VELOCITY]) and math.isfinite(current[k]):
            model_kernels.follow(c, x[k, VELOCITY], current[k], hidden[k])
        else:
            hidden[k] = math.nan


class Decisions(NamedTuple):
    """Of N benches, each shape (N,)."""

    delta_u: FloatArray
    """A."""
    before: FloatArray
    """M_c [1/s] without the correction."""
    after: FloatArray
    """M_c [1/s] with it."""
    status: npt.NDArray[np.uint8]
    """`hydro_bridge.signals.CorrectionStatus`."""


class FilterBank:
    """The filter for N benches at once, without a solver: see the module.

    Parameters
    ----------
    source
        Of a `ContractionFilter`.
    count
        N, 1 or more.

    Raises
    ------
    TypeError
        If the certificate has no compiled form.
    """

    def __init__(self, source: Certificate, count: int) -> None:
        self.parts = filter_parts(source)
        self.hidden = np.full((count, HIDDEN), np.nan)
        """Of the learned model, by bench, shape (N, 3); NaN: not known yet."""
        numbers = np.zeros((3, count))
        self._decisions = Decisions(numbers[0], numbers[1], numbers[2], np.zeros(count, np.uint8))

    def forget(self, benches: npt.NDArray[np.bool_] | slice = slice(None)) -> None:
        """Begin anew, all or some benches: their samples no longer follow on the last ones."""
        self.hidden[benches] = np.nan

    def correct(self, records: StateArray) -> Decisions:
        """Decide about one sample of each bench, records of `STATE_DTYPE`, shape (N,)."""
        x = np.stack([records[name] for name in PLANT_FIELDS], axis=1)
        names = ("nominal_valve_current", "reference_force", "proportional_gain", "valve_current")
        nominal, reference, gain, current = (np.ascontiguousarray(records[name]) for name in names)
        return self.correct_arrays(x, nominal, reference, gain, current)

    def correct_arrays(
        self, x: FloatArray, nominal: FloatArray, reference: FloatArray, gain: FloatArray, current: FloatArray
    ) -> Decisions:
        """Decide about x (N, 8), u_nom [A], f_r [N], K_p [1/s] and what the valve got [A], all others (N,).

        The arrays that come back are overwritten by the next call.
        """
        if self.parts.structured:
            settle_many(self.parts.model[0], x, current, self.hidden)
        decide_many(self.parts, x, self.hidden, nominal, reference, gain, *self._decisions)
        if self.parts.structured:
            follow_many(self.parts.model[0], x, current, self.hidden)
        return self._decisions
