# SPDX-License-Identifier: Apache-2.0
"""Free-form hidden inputs: in which equation an unnamed quantity would have to act, as a function of which variable.

For each equation and variable a piecewise linear function with many knots is pushed through that equation's way to the
residuals and fitted by linear least squares. It competes with the named causes at the same price per parameter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.estimation.fit import Fit, deviance, spreads
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.responses import UNIT_SIZE, Responses
from hydro_diagnosis.model.segment_model import SegmentModel

KNOTS = 24
"""Knots of each function; of time: per recording."""


@dataclass(frozen=True)
class FreeForm:
    """An unnamed hidden input."""

    equation: str
    sensor: str
    """The channel, if the equation is `sensor`."""
    variable: str
    gain: float
    """Evidence in units of BIC beyond the price of its knots."""
    knots: FloatArray
    values: FloatArray
    """The input at the knots: m3/s for the chambers, N for motion and load, A for actuation, the sensor's unit else."""


_INPUTS = (
    ("pressure_a", ""),
    ("pressure_b", ""),
    ("actuation", ""),
    ("motion", ""),
    ("load", ""),
    ("sensor", "hydraulic_force"),
    ("sensor", "load_force"),
    ("sensor", "pressure_a"),
    ("sensor", "pressure_b"),
)


def free_forms(problem: Problem, found: Fit) -> list[FreeForm]:
    """Every free-form input beside the named causes, the most informative first."""
    weight = np.sqrt(1.0 / spreads(problem, found.residual))[problem.layout.channel]
    named = found.jacobian * weight[:, None]
    left = found.residual * weight
    base = deviance(problem, left / weight)
    forms = []
    inputs = [Responses(problem, found.claims, equation, sensor) for equation, sensor in _INPUTS]
    for variable in variables(problem):
        knots = _knots(problem, variable)
        hats = list(_hats(problem, variable, knots))
        for responses in inputs:
            if not responses.visible:
                continue
            equation, sensor = responses.equation, responses.sensor
            columns = np.column_stack([responses.of(basis) for basis in hats])
            columns = np.column_stack([columns * weight[:, None], named])
            amounts = _least_squares(columns, -left)
            reached = deviance(problem, (left + columns @ amounts) / weight)
            rank = len(knots) if variable != "time" else len(knots) * len(problem.models)
            values = amounts[: len(knots)] * UNIT_SIZE.get(equation, 1.0)
            gain = base - reached - rank * float(np.log(len(left)))
            forms.append(FreeForm(equation, sensor, variable, gain, knots, values))
    return sorted(forms, key=lambda form: -form.gain)


def _least_squares(columns: FloatArray, goal: FloatArray) -> FloatArray:
    """Least squares by normal equations of columns scaled to length 1: they are many rows by few columns."""
    lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scaled = columns / lengths
    amounts: FloatArray = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True) @ (scaled.T @ goal) / lengths
    return amounts


def variables(problem: Problem) -> list[str]:
    """Names of what a hidden input may depend on, for `variable_of`."""
    have = set.intersection(*(set(model.channels) for model in problem.models))
    names = ["time", "position", "velocity"]
    names += ["current"] if "valve_current" in have else []
    names += ["pressure_a", "pressure_b", "pressure_difference"] if {"pressure_a", "pressure_b"} <= have else []
    return names


def variable_of(model: SegmentModel, name: str) -> FloatArray:
    """A variable that a hidden input may depend on, shape (n,), SI units."""
    if name == "time":
        return model.time
    if name == "position":
        return model.x
    if name == "velocity":
        return model.v
    if name == "current":
        return model.channels["valve_current"]
    if name == "pressure_difference":
        return model.smooth(model.channels["pressure_a"] - model.channels["pressure_b"])
    return model.smooth(model.channels[name])


def _knots(problem: Problem, variable: str) -> FloatArray:
    values = np.concatenate([variable_of(model, variable)[model.settle :] for model in problem.models])
    if variable in ("velocity", "current"):  # denser around zero, where friction and valve change their ways
        shares = np.linspace(0.0, 1.0, KNOTS)
        return np.unique(np.quantile(values, shares))
    return np.linspace(values.min(), values.max(), KNOTS)


def _hats(problem: Problem, variable: str, knots: FloatArray) -> Iterator[list[FloatArray]]:
    """Basis functions over all segments; of time they act in one segment each."""
    groups = [[model] for model in problem.models] if variable == "time" else [problem.models]
    for group in groups:
        for j in range(len(knots)):
            yield [_hat(variable_of(one, variable), knots, j) * (one in group) for one in problem.models]


def _hat(values: FloatArray, knots: FloatArray, index: int) -> FloatArray:
    peak = np.zeros(len(knots))
    peak[index] = 1.0
    return np.interp(values, knots, peak)
