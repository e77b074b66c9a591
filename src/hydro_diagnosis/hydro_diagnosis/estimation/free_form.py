# SPDX-License-Identifier: Apache-2.0
"""Free-form hidden inputs: in which equation an unnamed quantity would have to act, as a function of which variable.

For each equation and variable a piecewise linear function with many knots is pushed through that equation's way to the
residuals (observer, test function, sensors) and fitted by linear least squares. It competes with the named causes at
the same price per parameter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from hydro_diagnosis.effects import kernels
from hydro_diagnosis.effects.base import Claim, FloatArray
from hydro_diagnosis.estimation.fit import Fit, deviance, residual_variances
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.chambers import fading_sums
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.segment_record import OBSERVER_MEMORY
from hydro_sim.model import equations as eq

UNIT_SIZE = {"pressure_a": 1e-7, "pressure_b": 1e-7, "actuation": 1e-4, "motion": 1.0, "load": 1.0}
"""Scale of the basis functions, so that columns are of similar length."""


class HiddenInput:
    """A hidden input of one equation, and what it does to the residual vector."""

    def __init__(self, problem: Problem, claims: Sequence[Claim], equation: str, sensor: str) -> None:
        self.problem = problem
        self.equation, self.sensor = equation, sensor
        everything = (*problem.baseline, *claims)
        self._benches = [model.bench(everything) for model in problem.models]
        self._stiff: list[tuple[FloatArray, FloatArray]] = []
        self._roots: list[tuple[FloatArray, FloatArray]] = []
        if "pressure" in problem.blocks and equation in ("pressure_a", "pressure_b", "actuation"):
            for model, bench in zip(problem.models, self._benches, strict=True):
                oil = model.observer.oil(everything)
                self._stiff.append(chambers.compliances(bench, oil, everything))
                opened = kernels.substep_mean(oil.spool) >= 0
                drops = zip(*eq.edge_drops(bench.supply_pressure, bench.tank_pressure, *oil.pressures), strict=True)
                root_a, root_b = (eq.signed_root(np.where(opened, out, back)) for out, back in drops)
                self._roots.append((root_a, root_b))

    @property
    def visible(self) -> bool:
        """Whether the recordings hold the channels in which this input shows."""
        blocks = self.problem.blocks
        if self.equation in ("pressure_a", "pressure_b", "actuation"):
            return "pressure" in blocks
        if self.equation in ("motion", "load"):
            return self.equation in blocks
        return self.sensor in self.problem.sensor_noise and any(block != "motion" for block in blocks)

    def response(self, inputs: Sequence[FloatArray]) -> FloatArray:
        """Residual vector's change for an input given per segment."""
        problem = self.problem
        shown = [self._channels(k, model, inputs[k]) for k, model in enumerate(problem.models)]
        layout = problem.layout
        vector = np.zeros(len(layout.channel))
        for index, name in enumerate(CHANNELS):
            for k in range(len(problem.models)):
                if name in shown[k]:
                    at = (layout.channel == index) & (layout.segment == k)
                    vector[at] = shown[k][name] / problem.deviation(name, k)
        return vector

    def _channels(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        if not np.any(hidden):
            return {}
        if self.equation in ("pressure_a", "pressure_b", "actuation"):
            return self._chambers(k, model, hidden)
        if self.equation == "motion":
            return {"motion": -model.kept_finish(hidden)}
        if self.equation == "load":
            return self._load(k, model, hidden)
        return self._sensor(k, model, hidden)

    def _chambers(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        scale = UNIT_SIZE[self.equation] * model.step
        shown = {}
        for index, name in enumerate(("pressure_a", "pressure_b")):
            if self.equation not in (name, "actuation"):
                continue
            flow = hidden * scale
            if self.equation == "actuation":
                flow = flow * self._benches[k].valve_gain * self._roots[k][index] * (1.0 if index == 0 else -1.0)
            built = fading_sums((self._stiff[k][index] * flow)[None], 1.0 - model.step / OBSERVER_MEMORY)[0]
            shown[name] = -model.kept_smooth(built)
        return shown

    def _load(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        shown = {"load": -model.kept_smooth(model.behind_cell(hidden, self._benches[k]))}
        if "motion" in self.problem.blocks:
            shown["motion"] = -model.kept_finish(hidden)
        return shown

    def _sensor(self, k: int, model: SegmentModel, hidden: FloatArray) -> dict[str, FloatArray]:
        shown: dict[str, FloatArray] = {}
        means = model.means(hidden)
        area = self._benches[k].piston_area
        if self.sensor == "load_force":
            return {"load": model.kept_smooth(hidden)}
        if self.sensor == "hydraulic_force":
            shown["motion"] = model.kept_smooth(hidden)
            shown["hydraulic"] = means
        else:
            shown[self.sensor] = model.kept_smooth(high_pass(hidden, model.step)) * 1e4
            share = 1.0 if self.sensor == "pressure_a" else -self._benches[k].area_ratio
            shown["hydraulic"] = -area * share * means * 1e4
        present = {CHANNELS[index] for index in np.unique(self.problem.layout.channel)}
        return {name: signal for name, signal in shown.items() if name in present}


def high_pass(signal: FloatArray, step: float) -> FloatArray:
    """High-pass effect of a slow observer on a signal."""
    gain = step / OBSERVER_MEMORY
    followed, _ = lfilter([0.0, gain], [1.0, gain - 1.0], signal, zi=[signal[0]])
    return signal - np.asarray(followed)


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
    weight = np.sqrt(1.0 / residual_variances(problem, found.residual))[problem.layout.channel]
    named = found.jacobian * weight[:, None]
    left = found.residual * weight
    base = deviance(problem, left / weight)
    forms = []
    inputs = [HiddenInput(problem, found.claims, equation, sensor) for equation, sensor in _INPUTS]
    for variable in variables(problem):
        knots = _knots(problem, variable)
        hats = list(_hats(problem, variable, knots))
        for hidden in inputs:
            if not hidden.visible:
                continue
            equation, sensor = hidden.equation, hidden.sensor
            columns = np.column_stack([hidden.response(basis) for basis in hats])
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


def _hats(problem: Problem, variable: str, knots: FloatArray) -> Iterator[list[FloatArray]]:
    """Basis functions over all segments; of time they act in one segment each."""
    groups = [[model] for model in problem.models] if variable == "time" else [problem.models]
    for group in groups:
        for peak in np.eye(len(knots)):
            yield [np.interp(one.variable(variable), knots, peak) * (one in group) for one in problem.models]
