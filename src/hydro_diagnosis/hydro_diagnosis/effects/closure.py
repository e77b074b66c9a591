# SPDX-License-Identifier: Apache-2.0
"""Laws and tables of `hydro_sim.model.grammar` as effects: fitted and simulated like named causes, but never named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from hydro_diagnosis.effects.base import (
    HYDRAULIC,
    LOAD,
    MOTION,
    PRESSURE,
    Effect,
    FitParameter,
    FloatArray,
    Kinematics,
    Memory,
    Oil,
    Values,
)
from hydro_diagnosis.effects.path_memory import along
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import KNOTS, Element, Law, Signals, Table

_TOUCHES = {
    "motion": frozenset({MOTION}),
    "load": frozenset({MOTION, LOAD}),
    "sensor": frozenset({MOTION, HYDRAULIC}),
}
_EQUATIONS = {"pressure": ("pressure_a", "pressure_b")}
_SPLINES = np.arange(-2.0, KNOTS + 2.0)
"""Knots of a table's cubic B-splines, which peak at 0 to `KNOTS` - 1."""
_REACH = 1e4
"""Bound of a coefficient, as a multiple of its typical size."""


@dataclass(frozen=True)
class Closure(Effect):
    """A term of one equation; `options` say which."""

    law: Law | Table = grammar.LAWS[0]
    limits: tuple[float, float] = (0.0, 1.0)
    """Limits of a table's variable, SI unit."""
    numbers: Bench | None = None
    """The bench, once it is adapted."""

    id = "closure"
    named = False

    @property
    def touches(self) -> frozenset[str]:  # type: ignore[override]
        return _TOUCHES.get(self.law.equation, frozenset({PRESSURE}))

    @property
    def equations(self) -> tuple[str, ...]:  # type: ignore[override]
        return _EQUATIONS.get(self.law.equation, (self.law.equation,))

    @property
    def family(self) -> str:  # type: ignore[override]
        """Laws of flows cannot pass for an error in the form of a law of forces."""
        return "closure of flows" if PRESSURE in self.touches else "closure of forces"

    @property
    def element(self) -> Element | None:
        """Memory element of the term."""
        return self.law.element if isinstance(self.law, Law) else None

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        law, size = self.law, self.law.typical
        names = ("coefficient",) if isinstance(law, Law) else law.names[2:]
        reach = _REACH * size
        amplitudes = tuple(
            FitParameter(
                name=name, unit=law.unit, low=-reach, high=reach, neutral=0.0, probes=(size,), smallest=1e-3 * size
            )
            for name in names
        )
        return amplitudes if self.element is None else (*amplitudes, _follows(self.element))

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, numbers=bench)

    def nothing(self) -> list[dict[str, float]]:
        """Values at which the term vanishes: one set for each probe of its memory's length."""
        still = {one.name: 0.0 for one in self.parameters}
        if self.element is None:
            return [still]
        return [{**still, self.element.number: probe} for probe in self.element.probes]

    def to_closure(self, values: Values) -> dict[str, Any]:
        """Return the entry under `closures` in corrected.yaml."""
        bounds = {} if isinstance(self.law, Law) else dict(zip(("low", "high"), self.limits, strict=True))
        return {"equation": self.law.equation, "form": self.law.form, "parameters": {**bounds, **values}}

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        if self.law.equation != "motion":
            return force
        nothing = np.zeros_like(motion.position)
        pressures = motion.pressures or (nothing, nothing)
        return force + self.given(Signals(motion.position, motion.velocity, *pressures), values)

    def inflows(self, flows: tuple[FloatArray, FloatArray], oil: Oil, memory: Memory,
                values: Values) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        if not self.law.equation.startswith("pressure"):
            return flows
        p_a, p_b = oil.pressures
        at = Signals(oil.position, pressure_a=p_a, pressure_b=p_b)
        out = self.given(self._remembering(at, memory, values), values)
        by_a, by_b = {"pressure": (-1.0, 1.0), "pressure_a": (-1.0, 0.0), "pressure_b": (0.0, -1.0)}[self.law.equation]
        return flows[0] + by_a * out, flows[1] + by_b * out

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        if self.law.equation != "load":
            return force
        return force + self.given(self._remembering(Signals(motion.position), memory, values), values, bench)

    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if self.law.equation != "sensor" or channel != "hydraulic_force":
            return signal
        return signal + self.given(self._remembering(Signals(force=signal), memory, values), values)

    def sentence(self, values: Values) -> str:
        if isinstance(self.law, Law):
            return self.law.sentence
        over, factor = self.law.variable.replace("_", " "), self.law.factor
        what = f"A coefficient of the {factor.name} that follows" if factor else "A smooth function of"
        return f"{what} the {over}, for which no law was found."

    def _remembering(self, at: Signals, memory: Memory, values: Values) -> Signals:
        element = self.element
        if element is None:
            return at
        signal = getattr(at, element.signal)
        over = values[element.number]
        if element.kind == "lag":
            return replace(at, memory=memory.lag(self.label, signal, over))
        return replace(at, memory=memory.bristle(self.label, signal, 1.0 / over, np.ones_like(signal)))

    def given(self, at: Signals, values: Values, bench: Bench | None = None) -> FloatArray:
        """Value of the term, in the unit of its equation."""
        if isinstance(self.law, Law):
            return np.asarray(self.law.value(at, bench or self.numbers, [*values.values()]))
        spline = BSpline.construct_fast(_SPLINES, np.array([*values.values()]), 3)  # `Table.value`, many times faster
        given = spline(self.law.along(at, *self.limits))
        return np.asarray(given * self.law.factor.shape(at) if self.law.factor else given)


class ValveClosure(Closure):
    """A term of the spool's position."""

    stage = 2

    def command(self, spool: FloatArray, substep: float, values: Values) -> FloatArray:
        at = Signals(current=spool)
        if self.element is not None:
            path = np.ascontiguousarray(spool).ravel()
            bent = along(path, 1.0 / values[self.element.number], np.ones_like(path))
            at = replace(at, memory=bent.reshape(spool.shape))
        return spool + self.given(at, values)


def _follows(element: Element) -> FitParameter:
    low, high = element.bounds
    middle = element.probes[len(element.probes) // 2]
    return FitParameter(
        name=element.number, unit=element.unit, low=low, high=high, neutral=middle, probes=element.probes,
        systematic=0.01,
    )  # fmt: skip


def closure(law: Law | Table, bench: Bench, limits: tuple[float, float] = (0.0, 1.0)) -> Closure:
    """A law or table as an effect on a bench."""
    kind = ValveClosure if law.equation == "actuation" else Closure
    return kind({"equation": law.equation, "form": law.form}, law=law, limits=limits, numbers=bench)


def from_mapping(entry: Mapping[str, Any], bench: Bench) -> tuple[Closure, dict[str, float]]:
    """An entry of `closures` in corrected.yaml, checked by `Bench`, as an effect with values."""
    law = grammar.ALL[entry["equation"], entry["form"]]
    numbers = {name: float(entry["parameters"][name]) for name in law.names}
    limits = (numbers.pop("low"), numbers.pop("high")) if isinstance(law, Table) else (0.0, 1.0)
    return closure(law, bench, limits), numbers
