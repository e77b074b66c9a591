# SPDX-License-Identifier: Apache-2.0
"""Laws and tables of `hydro_sim.model.laws` as effects: fitted and simulated like named causes, never called one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import (
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
from hydro_sim.model import laws
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import Law, Signals, Table

_TOUCHES = {"motion": frozenset({MOTION}), "load": frozenset({MOTION, LOAD})}
_EQUATIONS = {"pressure": ("pressure_a", "pressure_b")}
_REACH = 1e4
"""Times the typical size of a coefficient: how far it may go."""


@dataclass(frozen=True)
class Closure(Effect):
    """A term of one equation; `options` say which."""

    law: Law | Table = laws.LAWS[0]
    limits: tuple[float, float] = (0.0, 1.0)
    """Of a table's variable, SI unit."""
    numbers: Bench | None = None
    """The bench, once it is adapted."""

    id = "closure"
    named = False
    family = "closure"

    @property
    def touches(self) -> frozenset[str]:  # type: ignore[override]
        return _TOUCHES.get(self.law.equation, frozenset({PRESSURE}))

    @property
    def equations(self) -> tuple[str, ...]:  # type: ignore[override]
        return _EQUATIONS.get(self.law.equation, (self.law.equation,))

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        law, size = self.law, self.law.typical
        unit = law.unit if isinstance(law, Law) else laws.UNITS[law.equation]
        names = law.names if isinstance(law, Law) else law.names[2:]
        reach = _REACH * size
        return tuple(
            FitParameter(
                name=name, unit=unit, low=-reach, high=reach, neutral=0.0, probes=(size,), smallest=1e-3 * size
            )
            for name in names
        )

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, numbers=bench)

    def to_closure(self, values: Values) -> dict[str, Any]:
        """As it stands under `closures` in corrected.yaml."""
        bounds = {} if isinstance(self.law, Law) else dict(zip(("low", "high"), self.limits, strict=True))
        return {"equation": self.law.equation, "form": self.law.form, "parameters": {**bounds, **values}}

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        if self.law.equation != "motion":
            return force
        nothing = np.zeros_like(motion.position)
        pressures = motion.pressures or (nothing, nothing)
        return force + self._given(Signals(motion.position, motion.velocity, *pressures), values)

    def inflows(self, flows: tuple[FloatArray, FloatArray], oil: Oil, values: Values) -> tuple[FloatArray, FloatArray]:
        if not self.law.equation.startswith("pressure"):
            return flows
        p_a, p_b = oil.pressures
        out = self._given(Signals(oil.position, pressure_a=p_a, pressure_b=p_b), values)
        by_a, by_b = {"pressure": (-1.0, 1.0), "pressure_a": (-1.0, 0.0), "pressure_b": (0.0, -1.0)}[self.law.equation]
        return flows[0] + by_a * out, flows[1] + by_b * out

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        if self.law.equation != "load":
            return force
        return force + self._given(Signals(motion.position), values, bench)

    def sentence(self, values: Values) -> str:
        if isinstance(self.law, Law):
            return self.law.sentence
        return f"A smooth function of the {self.law.variable.replace('_', ' ')}, for which no law was found."

    def _given(self, at: Signals, values: Values, bench: Bench | None = None) -> FloatArray:
        bounds = self.limits if isinstance(self.law, Table) else ()
        return np.asarray(self.law.value(at, bench or self.numbers, [*bounds, *values.values()]))


class ValveClosure(Closure):
    """A term of the spool's position."""

    stage = 2

    def command(self, spool: FloatArray, substep: float, values: Values) -> FloatArray:
        return spool + self._given(Signals(current=spool), values)


def closure(law: Law | Table, bench: Bench, limits: tuple[float, float] = (0.0, 1.0)) -> Closure:
    """A law or table as an effect on a bench."""
    kind = ValveClosure if law.equation == "actuation" else Closure
    return kind({"equation": law.equation, "form": law.form}, law=law, limits=limits, numbers=bench)


def from_mapping(entry: Mapping[str, Any], bench: Bench) -> tuple[Closure, dict[str, float]]:
    """An entry of `closures` in corrected.yaml, checked by `Bench`, as an effect with values."""
    law = laws.ALL[entry["equation"], entry["form"]]
    numbers = {name: float(entry["parameters"][name]) for name in law.names}
    limits = (numbers.pop("low"), numbers.pop("high")) if isinstance(law, Table) else (0.0, 1.0)
    return closure(law, bench, limits), numbers
