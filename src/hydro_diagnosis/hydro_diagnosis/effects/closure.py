# SPDX-License-Identifier: Apache-2.0
"""Laws and tables of `hydro_sim.model.grammar` as effects, each of the class that acts in its equation.

They are fitted and simulated like named causes, but never named. Those of sensors say what a reading shows more than
its signal, and how that is undone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from hydro_diagnosis.effects import kernels
from hydro_diagnosis.effects.base import (
    LOAD,
    MOTION,
    PRESSURE,
    Effect,
    FitParameter,
    FloatArray,
    Kinematics,
    Oil,
    Pair,
    Values,
)
from hydro_diagnosis.effects.kernels import splined
from hydro_diagnosis.effects.memory import Memory
from hydro_diagnosis.effects.sensors import TOUCHES
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import (
    REVERSAL_VELOCITY,
    Element,
    Law,
    Number,
    Signals,
    edge_losses,
    sensor_signals,
    spool_shift_losses,
)
from hydro_sim.model.tables import Table

_TOUCHES = {"motion": frozenset({MOTION}), "load": frozenset({MOTION, LOAD})}
_EQUATIONS = {"pressure": ("pressure_a", "pressure_b")}
_REACH = 1e4
"""Bound of a coefficient, as a multiple of its typical size."""


@dataclass(frozen=True)
class Closure(Effect):
    """A term of one equation; `options` say which."""

    law: Law | Table = grammar.LAWS[0]
    limits: tuple[float, float] = (0.0, 1.0)
    """Limits of a table's variable or of a law's threshold, SI unit."""
    probes: tuple[float, ...] = ()
    """Start values of a threshold, within the limits."""
    numbers: Bench | None = None
    """The bench, once it is adapted."""

    id = "closure"
    named = False

    @property
    def blocks(self) -> frozenset[str]:  # type: ignore[override]
        if self.law.equation == "sensor":
            return TOUCHES[self.law.where]
        return _TOUCHES.get(self.law.equation, frozenset({PRESSURE}))

    @property
    def equations(self) -> tuple[str, ...]:  # type: ignore[override]
        return _EQUATIONS.get(self.law.equation, (self.law.equation,))

    @property
    def family(self) -> str:  # type: ignore[override]
        """Laws of flows cannot pass for an error in the form of a law of forces."""
        flows = self.law.equation in ("actuation", "pressure", "pressure_a", "pressure_b")
        if self.law.equation == "sensor":
            flows = self.law.where.startswith("pressure")
        return "closure of flows" if flows else "closure of forces"

    @property
    def memoryless(self) -> bool:  # type: ignore[override]
        return self.element is None or self.element.kind in ("path", "slow")

    @property
    def uses_acceleration(self) -> bool:  # type: ignore[override]
        return "acceleration" in self.law.uses

    @property
    def element(self) -> Element | None:
        """Memory element of the term."""
        return self.law.element

    @cached_property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        law, size = self.law, self.law.typical
        names = ("coefficient",) if isinstance(law, Law) else law.names[2:]
        reach = _REACH * size
        amplitudes = tuple(
            FitParameter(name=name, unit=law.unit, low=-reach, high=reach, probes=(size,), smallest=1e-3 * size)
            for name in names
        )
        return (*amplitudes, *(self._number(one) for one in self._numbers))

    @property
    def _numbers(self) -> tuple[Number, ...]:
        """The law's further numbers."""
        return self.law.numbers if isinstance(self.law, Law) else ()

    def _number(self, number: Number) -> FitParameter:
        probes = self.probes if number.over and self.probes else number.probes
        low, high = self.limits if number.over and self.probes else number.bounds
        return FitParameter(
            name=number.name, unit=number.unit, low=low, high=high, neutral=probes[len(probes) // 2], probes=probes,
            systematic=0.6 if number.name == REVERSAL_VELOCITY.name else 0.01,  # the recorded velocity is smoothed
        )  # fmt: skip

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, numbers=bench)

    def nothing(self) -> list[dict[str, float]]:
        """Values at which the term vanishes: one set for each choice of start values of its further numbers."""
        still = {one.name: 0.0 for one in self.parameters}
        choices = product(*(one.probes for one in self.shapes))
        return [{**still, **dict(zip((one.name for one in self.shapes), chosen, strict=True))} for chosen in choices]

    def to_closure(self, values: Values) -> dict[str, Any]:
        """Return the entry under `closures` in corrected.yaml."""
        bounds = {} if isinstance(self.law, Law) else dict(zip(("low", "high"), self.limits, strict=True))
        return {"equation": self.law.equation, "form": self.law.form, "parameters": {**bounds, **values}}

    def sentence(self, values: Values) -> str:
        if isinstance(self.law, Law):
            return self.law.sentence
        over, factor = self.law.variable.replace("_", " "), self.law.factor
        what = f"A coefficient of the {factor.name} that follows" if factor else "A smooth function of"
        return f"{what} the {over}, for which no law was found."

    def _remembering(self, at: Signals, memory: Memory, values: Values) -> Signals:
        """The signals with what the law remembers of them."""
        element = self.element
        if element is None:
            return at
        if element.kind == "slow":
            return at.replace(memory=memory.lag(self.label, self._driver(at), values["time"], 0.0))
        signal = getattr(at, element.signal)
        if element.kind == "lag":
            return at.replace(memory=memory.lag(self.label, signal, values["time"]))
        return at.replace(memory=memory.bristle(self.label, signal, 1.0 / values["path"], np.ones_like(signal)))

    def _driver(self, at: Signals) -> FloatArray:
        """Return the input of a slow state."""
        signal = self.element.signal if self.element else ""
        if signal != "time":
            return np.asarray(getattr(at, signal))
        return np.ones(np.broadcast_shapes(*(np.shape(one) for one in (at.position, at.current, at.force))))

    def given(self, at: Signals, values: Values, bench: Bench | None = None) -> FloatArray:
        """Value of the term, in the unit of its equation."""
        if isinstance(self.law, Law):
            return np.asarray(self.law.value(at, bench or self.numbers, [*values.values()]))
        given = splined(np.asarray(self.law.variable_value(at)), *self.limits, np.array([*values.values()]))
        return np.asarray(given * self.law.factor.shape(at) if self.law.factor else given)


class MotionClosure(Closure):
    """A force against the motion."""

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        nothing = np.zeros_like(motion.position)
        at = Signals(motion.position, motion.velocity, *(motion.pressures or (nothing, nothing)))
        return force + self.given(self._remembering(at, memory, values), values)


class FlowClosure(Closure):
    """A flow out of the chambers beside the valve."""

    def trace(self, motion: Kinematics, memory: Memory, values: Values) -> None:
        """Flows are computed in the middle of each sample."""
        if self.element is not None and self.element.kind == "path":
            self._remembering(Signals(motion.position, motion.velocity), memory, values)

    def inflows(self, flows: Pair, oil: Oil, memory: Memory, values: Values) -> Pair:
        at = Signals(oil.position, oil.velocity, *oil.pressures, kernels.substep_mean(oil.spool))
        out = self.given(self._remembering(at, memory, values), values, self.numbers)
        by_a, by_b = {"pressure": (-1.0, 1.0), "pressure_a": (-1.0, 0.0), "pressure_b": (0.0, -1.0)}[self.law.equation]
        return flows[0] + by_a * out, flows[1] + by_b * out


class EdgeClosure(Closure):
    """A share of the flow through the valve's edges that does not pass."""

    def inflows(self, flows: Pair, oil: Oil, memory: Memory, values: Values) -> Pair:
        bench = self.numbers
        assert bench is not None
        opened, closed = (kernels.substep_mean(np.maximum(sign * oil.spool, 0.0)) for sign in (1.0, -1.0))
        openings = bench.valve_gain * opened, bench.valve_gain * closed
        past = self._remembering(Signals(current=kernels.substep_mean(oil.spool)), memory, values).memory
        lost = edge_losses(bench, openings, oil.pressures, lambda at: self.given(at.replace(memory=past), values))
        return flows[0] - lost[0], flows[1] - lost[1]


class AcrossClosure(Closure):
    """A shift of the spool at the edges, by the pressures across the valve and what moves it."""

    def inflows(self, flows: Pair, oil: Oil, memory: Memory, values: Values) -> Pair:
        spool = kernels.substep_mean(oil.spool)
        at = Signals(oil.position, oil.velocity, *oil.pressures, spool)
        lost = spool_shift_losses(self.numbers, spool, self.given(at, values), oil.pressures)
        return flows[0] - lost[0], flows[1] - lost[1]


class LoadClosure(Closure):
    """A force of the load."""

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        at = Signals(motion.position, motion.velocity)
        return force + self.given(self._remembering(at, memory, values), values, bench)


class DraggedClosure(LoadClosure):
    """A mass that the load drags along."""

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        if motion.acceleration is None:  # it is being computed: see `inertia`
            return force
        return force + motion.acceleration * self.inertia(motion, bench, values)

    def inertia(self, motion: Kinematics, bench: Bench, values: Values) -> FloatArray:
        return self.given(Signals(motion.position, motion.velocity, acceleration=1.0), values, bench)


class ValveClosure(Closure):
    """A term of the spool's position."""

    stage = 2

    def command(self, spool: FloatArray, substep: float, values: Values) -> FloatArray:
        path = np.ascontiguousarray(spool).ravel()
        at = Signals(current=path)
        at = self._remembering(at, Memory(substep), values)
        return spool + self.given(at, values).reshape(spool.shape)


_INVERSIONS = 6
"""Iterations that find a signal from its reading: each leaves the part of the error that is not a straight line."""
_FOUND = 1e-6
"""Pa: what is left of an error that is as good as nothing."""
_CURVE = 2000
"""Places over the range of a reading at which a curve is inverted."""
_BEYOND = 0.5
"""Share of its range by which a signal may lie outside what its curved reading spans."""


class SensorClosure(Closure):
    """Error of a sensor's reading."""

    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel != self.law.where:
            return signal
        at = sensor_signals(channel, signal, memory.beside)
        return signal + self.given(self._remembering(at, memory, values), values)


class GaugeClosure(SensorClosure):
    """Error of a pressure sensor, whose pressure the flows follow."""

    @property
    def nonlinear_channel(self) -> str:  # type: ignore[override]
        along = self.element is not None and self.element.kind in ("path", "lag")
        return self.law.where if self.law.where in (self.law.uses or self.law.where) and not along else ""

    @property
    def _recalls(self) -> bool:
        """Whether its own signal's past counts."""
        return self.element is not None and self.element.signal == self.law.where

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel == self.law.where and self.element is None and self.nonlinear_channel and self.law.uses <= {channel}:
            return self._straightened(reading, values)
        signal = reading
        for _ in range(_INVERSIONS if channel == self.law.where else 0):
            at, before = sensor_signals(channel, signal, memory.beside), signal
            signal = reading - self.given(self._remembering(at, memory, values), values)
            if not (self.nonlinear_channel or self._recalls) or float(np.max(np.abs(signal - before))) < _FOUND:
                break
        return signal

    def _straightened(self, reading: FloatArray, values: Values) -> FloatArray:
        """The signal under a curve of it alone; where a reading stays, the least that shows it."""
        low, high = float(np.min(reading)), float(np.max(reading))
        beyond = _BEYOND * max(high - low, 1.0)
        signal = np.linspace(low - beyond, high + beyond, _CURVE)
        shown = signal + self.given(sensor_signals(self.law.where, signal), values)
        rising = np.maximum.accumulate(shown)
        risen = np.concatenate([[True], np.diff(rising) > 0.0])
        return np.asarray(np.interp(reading, rising[risen], signal[risen]))


class PlaceClosure(SensorClosure):
    """Error of the position sensor, on whose position all equations depend."""

    places = True

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        signal = reading
        for _ in range(_INVERSIONS if channel == self.law.where else 0):
            at = sensor_signals(channel, signal, memory.beside)
            signal = reading - self.given(self._remembering(at, memory, values), values)
            if "position" not in self.law.uses:
                break
        return signal


def closure(
    law: Law | Table, bench: Bench, limits: tuple[float, float] = (0.0, 1.0), probes: tuple[float, ...] = ()
) -> Closure:
    """A law or table as an effect on a bench.

    `limits`: of a table's variable or of a law's threshold, SI unit; `probes`: start values of that threshold.
    """
    acting = {"motion": MotionClosure, "load": LoadClosure, "actuation": ValveClosure, "sensor": SensorClosure}
    placed = {"edges": EdgeClosure, "across": AcrossClosure, "piston_position": PlaceClosure}
    kind = placed.get(law.where) or acting.get(law.equation, FlowClosure)
    kind = GaugeClosure if law.where.startswith("pressure") else kind
    kind = DraggedClosure if kind is LoadClosure and "acceleration" in law.uses else kind
    options = {"equation": law.equation, "form": law.form}
    return kind(options, law=law, limits=limits, probes=probes, numbers=bench)


def from_mapping(entry: Mapping[str, Any], bench: Bench) -> tuple[Closure, dict[str, float]]:
    """An entry of `closures` in corrected.yaml, checked by `Bench`, as an effect with values."""
    law = grammar.FORMS[entry["equation"], entry["form"]]
    numbers = {name: float(entry["parameters"][name]) for name in law.names}
    limits = (numbers.pop("low"), numbers.pop("high")) if isinstance(law, Table) else (0.0, 1.0)
    return closure(law, bench, limits), numbers
