# SPDX-License-Identifier: Apache-2.0
"""Laws and tables of `hydro_sim.model.grammar` as effects: unnamed terms (closures).

They are fitted and simulated like named causes. Their terms are the model's; this module adds their memory over a
whole record and the inversion of sensor errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from hydro_diagnosis.effects.base import (
    ChamberInputs,
    Effect,
    FloatArray,
    Kinematics,
    Pair,
    ParameterValues,
    blocks_of,
    substep_mean,
)
from hydro_diagnosis.significance import ITERATIONS
from hydro_sim.jit import njit
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.catalogue import Kind
from hydro_sim.model.effects.closure import closure_class
from hydro_sim.model.laws import Law, MemoryElement, Signals, edge_losses, sensor_signals
from hydro_sim.model.tables import KNOTS, Table

if TYPE_CHECKING:
    from hydro_diagnosis.effects.memory import Memory

_EQUATION_CHANNELS = {"pressure": ("pressure_a", "pressure_b")}
_HOOKS = {"motion": {"opposing_force"}, "load": {"load"}, "sensor": {"read_sensor"}}
"""Hooks in which terms of an equation act; terms of flows, including the valve's, act in `leaks`."""


_INTERVAL_COUNT = KNOTS - 3
"""Number of knot intervals over a table's range."""


def evaluate_spline(variable: FloatArray, low: float, high: float, values: FloatArray) -> FloatArray:
    """Sum of cubic B-splines with coefficients `values` (KNOTS,) over a variable, constant beyond `low` and `high`."""
    found = np.empty(variable.shape)
    _evaluate_spline(
        found.reshape(-1), np.ascontiguousarray(variable).reshape(-1), low, _INTERVAL_COUNT / (high - low), values
    )
    return found


@njit
def _evaluate_spline(found, variable, low, scale, values):
    for k in range(len(variable)):
        along = (variable[k] - low) * scale
        if along != along:  # a simulation that has run away
            found[k] = np.nan
            continue
        along = min(max(along, 0.0), float(_INTERVAL_COUNT))
        at = min(int(along), _INTERVAL_COUNT - 1)
        t = along - at
        s = 1.0 - t
        found[k] = (
            s * s * s * values[at]
            + (4.0 - 3.0 * t * t * (2.0 - t)) * values[at + 1]
            + (4.0 - 3.0 * s * s * (2.0 - s)) * values[at + 2]
            + t * t * t * values[at + 3]
        ) / 6.0


@cache
def _kind(law: Law | Table) -> Kind:
    return Kind(closure_class(law), (("equation", law.equation), ("form", law.form)))


@dataclass(frozen=True)
class Closure(Effect):
    """A law or table as an additional term of one equation; `options` are the equation and the form."""

    law: Law | Table = grammar.LAWS[0]
    limits: tuple[float, float] = (0.0, 1.0)
    """Limits of a table's variable or of a law's threshold, SI unit."""
    probes: tuple[float, ...] = ()
    """Start values of a threshold, within the limits."""
    bench: Bench | None = None
    """Bench to which the term is adapted."""
    stage = 2
    named = False

    @property
    def blocks(self) -> frozenset[str]:
        return blocks_of(self.law.equation, self.law.where)

    @property
    def equations(self) -> tuple[str, ...]:
        return _EQUATION_CHANNELS.get(self.law.equation, (self.law.equation,))

    @property
    def family(self) -> str:
        """Family of the term; flows and forces differ, as a term of one cannot mimic a form error of the other."""
        flows = self.law.equation in ("actuation", "pressure", "pressure_a", "pressure_b")
        if self.law.equation == "sensor":
            flows = self.law.where.startswith("pressure")
        return "closure of flows" if flows else "closure of forces"

    @property
    def depends_on_acceleration(self) -> bool:  # type: ignore[override]
        return "acceleration" in self.law.uses

    @property
    def memory_element(self) -> MemoryElement | None:
        """Memory element of the term; None if it has none."""
        return self.law.memory_element

    def acts_in(self, *hooks: str) -> bool:
        acting = _HOOKS.get(self.law.equation, {"leaks"})
        if self.law.equation == "actuation" and not self.law.where:  # a term of the spool's position
            acting = {"command"}
        if type(self).invert_reading is not Effect.invert_reading:
            acting = {*acting, "invert_reading"}
        return not acting.isdisjoint(hooks)

    def adapted(self, bench: Bench) -> Closure:
        parameters = self.physics.fitted_parameters(bench)
        if self.probes and isinstance(self.law, Law):  # thresholds, whose range is that of the recordings
            over = {one.name for one in self.law.shape_parameters if one.threshold_signal}
            about: dict[str, Any] = {"low": self.limits[0], "high": self.limits[1], "start_values": self.probes}
            about["neutral"] = self.probes[len(self.probes) // 2]
            parameters = tuple(replace(one, **about) if one.name in over else one for one in parameters)
        return replace(self, bench=bench, parameters=parameters)

    def start_values(self) -> list[dict[str, float]]:
        """Return values with zero amplitude: one set for each combination of start values of the shape parameters."""
        still = {one.name: 0.0 for one in self.parameters}
        choices = product(*(one.start_values for one in self.shapes))
        return [{**still, **dict(zip((one.name for one in self.shapes), chosen, strict=True))} for chosen in choices]

    def to_closure(self, values: ParameterValues) -> dict[str, Any]:
        """Return the entry under `closures` in corrected.yaml."""
        bounds = {} if isinstance(self.law, Law) else dict(zip(("low", "high"), self.limits, strict=True))
        return {"equation": self.law.equation, "form": self.law.form, "parameters": {**bounds, **values}}

    def _remembering(self, at: Signals, memory: Memory, values: ParameterValues) -> Signals:
        """The signals with the output of the law's memory element."""
        element = self.memory_element
        if element is None:
            return at
        if element.signal == "time":
            signal = np.ones(np.broadcast_shapes(*(np.shape(one) for one in (at.position, at.current, at.force))))
        else:
            signal = getattr(at, element.signal)
        if element.kind == "slow":
            return at.replace(memory=memory.lag(np.asarray(signal), values["time"], 0.0))
        if element.kind == "lag":
            return at.replace(memory=memory.lag(signal, values["time"]))
        return at.replace(memory=memory.bristle(signal, 1.0 / values["path"], np.ones_like(signal)))

    def term_value(self, at: Signals, values: ParameterValues, bench: Bench | None = None) -> FloatArray:
        """Value of the term, in the unit of its equation."""
        if isinstance(self.law, Law):
            return np.asarray(self.law.value(at, bench or self.bench, [*values.values()]))
        given = evaluate_spline(np.asarray(self.law.variable_value(at)), *self.limits, np.array([*values.values()]))
        return np.asarray(given * self.law.factor.shape(at) if self.law.factor else given)

    def _bound(self, values: ParameterValues, memory: Memory | None = None, **context: Any) -> Any:
        """The model's term, with value and memory evaluated over a record or over windows."""
        bound = super()._bound(values, memory, **context)
        bench = context.get("bench")

        def value(at: Signals) -> FloatArray:
            return self.term_value(self._remembering(at, memory, values) if memory else at, values, bench)

        bound.__dict__ |= {"_value": value, "_memory_state": lambda: 0.0, "_final_memory_state": lambda signal: 0.0}
        return bound

    def command(self, spool: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        path = np.ascontiguousarray(spool).ravel()
        at = self._remembering(Signals(current=path), memory, values)
        return spool + self.term_value(at, values).reshape(spool.shape)


class EdgeClosure(Closure):
    """Relative loss of the flow through the valve's edges; its memory is driven by the spool's mean position."""

    def leaks(self, flows: Pair, oil: ChamberInputs, bench: Bench, memory: Memory, values: ParameterValues) -> Pair:
        opened, closed = (substep_mean(np.maximum(sign * oil.spool, 0.0)) for sign in (1.0, -1.0))
        past = self._remembering(Signals(current=substep_mean(oil.spool)), memory, values).memory
        openings = bench.valve_gain * opened, bench.valve_gain * closed
        lost = edge_losses(bench, openings, oil.pressures, lambda at: self.term_value(at.replace(memory=past), values))
        return flows[0] - lost[0], flows[1] - lost[1]


class LoadMassClosure(Closure):
    """Additional mass that moves with the load."""

    def load(
        self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: ParameterValues
    ) -> FloatArray:
        at = Signals(motion.position, motion.velocity, acceleration=motion.acceleration)
        return force + self.term_value(at, values, bench)


class PressureSensorClosure(Closure):
    """Error of a pressure sensor, inverted because the flows depend on the true pressure."""

    @property
    def nonlinear_channel(self) -> str:  # type: ignore[override]
        along = self.memory_element is not None and self.memory_element.kind in ("path", "lag")
        return self.law.where if self.law.where in (self.law.uses or self.law.where) and not along else ""

    def invert_reading(self, channel: str, reading: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        if channel != self.law.where:
            return reading
        if self.memory_element is None and self.nonlinear_channel and self.law.uses <= {channel}:  # a static curve
            low, high = float(np.min(reading)), float(np.max(reading))
            beyond = 0.5 * max(high - low, 1.0)  # the signal may lie outside of what its reading spans
            curve = np.linspace(low - beyond, high + beyond, 2000)
            rising = np.maximum.accumulate(curve + self.term_value(sensor_signals(channel, curve), values))
            risen = np.concatenate([[True], np.diff(rising) > 0.0])  # where the curve is flat: its smallest signal
            return np.asarray(np.interp(reading, rising[risen], curve[risen]))
        signal = reading
        recalls = (
            self.memory_element is not None and self.memory_element.signal == channel
        )  # memory of the signal itself
        for _ in range(ITERATIONS):
            at, before = sensor_signals(channel, signal, memory.other_signals), signal
            signal = reading - self.term_value(self._remembering(at, memory, values), values)
            if not (self.nonlinear_channel or recalls) or float(np.max(np.abs(signal - before))) < 1e-6:  # Pa
                break
        return signal


class PositionSensorClosure(Closure):
    """Error of the position sensor, inverted because all equations depend on the true position."""

    is_position_error = True

    def invert_reading(self, channel: str, reading: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        signal = reading
        for _ in range(ITERATIONS if channel == self.law.where else 0):
            at = sensor_signals(channel, signal, memory.other_signals)
            signal = reading - self.term_value(self._remembering(at, memory, values), values)
            if "position" not in self.law.uses:
                break
        return signal


def is_closure(effect: Effect) -> TypeGuard[Closure]:
    """Return whether an effect is an unnamed term."""
    return isinstance(effect, Closure)


def closure(
    law: Law | Table, bench: Bench, limits: tuple[float, float] = (0.0, 1.0), probes: tuple[float, ...] = ()
) -> Closure:
    """Return a law or table as an effect adapted to a bench.

    `limits`: of a table's variable or of a law's threshold, SI unit; `probes`: start values of that threshold.
    """
    return _class(law)(_kind(law), law=law, limits=limits, probes=probes).adapted(bench)


def _class(law: Law | Table) -> type[Closure]:
    if law.where.startswith("pressure"):
        return PressureSensorClosure
    dragged = LoadMassClosure if law.equation == "load" and "acceleration" in law.uses else Closure
    return {"edges": EdgeClosure, "piston_position": PositionSensorClosure}.get(law.where, dragged)


def from_mapping(entry: Mapping[str, Any], bench: Bench) -> tuple[Closure, dict[str, float]]:
    """Return effect and parameter values of an entry of `closures` in corrected.yaml, already checked by `Bench`."""
    law = grammar.FORMS[entry["equation"], entry["form"]]
    numbers = {name: float(entry["parameters"][name]) for name in law.names}
    limits = (numbers.pop("low"), numbers.pop("high")) if isinstance(law, Table) else (0.0, 1.0)
    return closure(law, bench, limits), numbers
