# SPDX-License-Identifier: Apache-2.0
"""Free-form hidden inputs: in which equation an unnamed quantity would have to act, as a function of which variable.

For each equation and variable a piecewise linear function with many knots is pushed through that equation's way to the
residuals (observer, test function, sensors) and fitted by linear least squares. It competes with the named causes at
the same price per parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.estimation.fit import Fit, deviance, residual_variances
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model.responses import Responses, Shown

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


def gains_by_equation(forms: Sequence[FreeForm]) -> dict[str, float]:
    """Evidence of the best form in each equation; `forms`: the most informative first."""
    return {form.equation: form.gain for form in reversed(forms)}


_INPUTS = (
    ("pressure_a", "", 1e-7),
    ("pressure_b", "", 1e-7),
    ("actuation", "", 1e-4),
    ("motion", "", 1.0),
    ("load", "", 1.0),
    ("sensor", "hydraulic_force", 1.0),
    ("sensor", "load_force", 1.0),
    ("sensor", "pressure_a", 1e4),
    ("sensor", "pressure_b", 1e4),
)
"""Equation, sensor, and scale of the basis functions, so that columns are of similar length."""


def free_forms(problem: Problem, found: Fit) -> list[FreeForm]:
    """Every free-form input beside the named causes, the most informative first."""
    weight = np.sqrt(1.0 / residual_variances(problem, found.residual))[problem.layout.channel]
    named = found.jacobian * weight[:, None]
    left = found.residual * weight
    base = deviance(problem, left / weight)
    forms = []
    ways = [Responses(model, problem.blocks, (*problem.baseline, *found.claims)) for model in problem.models]
    inputs = [one for one in _INPUTS if _visible(problem, *one[:2])]
    for variable in variables(problem):
        knots = _knots(problem, variable)
        hats = _hats(problem, variable, knots)
        for equation, sensor, size in inputs:
            shown = [_response(way, equation, sensor, size * own) for way, own in zip(ways, hats, strict=True)]
            columns = np.zeros((len(left), len(hats[0])))
            for channel, responses in problem.joined(shown, len(hats[0])).items():
                columns[problem.layout.channel == channel] = responses.T
            columns = np.column_stack([columns * weight[:, None], named])
            amounts = _least_squares(columns, -left)
            reached = deviance(problem, (left + columns @ amounts) / weight)
            gain = base - reached - len(hats[0]) * float(np.log(len(left)))
            forms.append(FreeForm(equation, sensor, variable, gain, knots, amounts[: len(knots)] * size))
    return sorted(forms, key=lambda form: -form.gain)


def _visible(problem: Problem, equation: str, sensor: str) -> bool:
    """Whether the recordings hold the channels in which an input shows."""
    if equation == "sensor":
        return sensor in problem.sensor_noise and any(block != "motion" for block in problem.blocks)
    return (equation if equation in ("motion", "load") else "pressure") in problem.blocks


def _response(way: Responses, equation: str, sensor: str, hidden: FloatArray) -> Shown:
    """Responses to inputs, shape (functions, n): N, A, m3/s into a chamber, or what a sensor reads too much."""
    model, nothing = way.model, np.zeros_like(hidden)
    if equation == "motion":
        return way.to_force(hidden)
    if equation == "load":
        return way.to_load(hidden, hidden)
    if equation == "actuation":
        return way.to_spool(hidden)
    if equation != "sensor":
        return way.to_flows(*((hidden, nothing) if equation == "pressure_a" else (nothing, hidden)))
    if sensor == "load_force":
        return way.present({"load": way.smooth(hidden)})
    means = np.stack([model.means(one) for one in hidden])
    if sensor == "hydraulic_force":
        return way.present({"motion": way.smooth(hidden), "hydraulic": means})
    passed = np.stack([way.seen_by_observer(one, nothing[0]) for one in hidden])
    area = -way.bench.piston_area * (1.0 if sensor == "pressure_a" else -way.bench.area_ratio)
    return way.present({sensor: way.smooth(passed), "hydraulic": area * means})


def _least_squares(columns: FloatArray, goal: FloatArray) -> FloatArray:
    """Least squares by normal equations of columns scaled to length 1: they are many rows by few columns."""
    lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scaled = columns / lengths
    amounts: FloatArray = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True) @ (scaled.T @ goal) / lengths
    return amounts


def variables(problem: Problem) -> list[str]:
    """Names of what a hidden input may depend on, for `SegmentModel.variable`."""
    have = set.intersection(*(set(model.channels) for model in problem.models))
    names = ["time", "position", "velocity"]
    names += ["current"] if "valve_current" in have else []
    names += ["pressure_a", "pressure_b", "pressure_difference"] if {"pressure_a", "pressure_b"} <= have else []
    return names


def _knots(problem: Problem, variable: str) -> FloatArray:
    values = np.concatenate([model.variable(variable)[model.settle :] for model in problem.models])
    if variable in ("velocity", "current"):  # denser around zero, where friction and valve change their ways
        shares = np.linspace(0.0, 1.0, KNOTS)
        return np.unique(np.quantile(values, shares))
    return np.linspace(values.min(), values.max(), KNOTS)


def _hats(problem: Problem, variable: str, knots: FloatArray) -> list[FloatArray]:
    """Basis functions along each segment, shape (functions, n); of time they act in one segment each."""
    found = []
    for k, model in enumerate(problem.models):
        own = np.stack([np.interp(model.variable(variable), knots, peak) for peak in np.eye(len(knots))])
        if variable == "time":
            own = np.concatenate([own * (at == k) for at in range(len(problem.models))])
        found.append(own)
    return found
