# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis modelled and could not name: laws and tables of `model.laws` as terms of the bench's equations."""

from __future__ import annotations

from typing import Any, ClassVar

from hydro_sim.model import laws
from hydro_sim.model.effects.base import Effect, hidden, parameter
from hydro_sim.model.equations import Symbol
from hydro_sim.model.laws import Law, Signals, Table

_WIDEST = 1e15


class Closure(Effect):
    """One law or table; subclasses are made from `laws.ALL`."""

    id = "closure"
    law: ClassVar[Law | Table]

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        if self.law.equation != "motion":
            return 0.0
        pressure_a, pressure_b = self.at.pressures
        return self._value(Signals(position, velocity, pressure_a=pressure_a, pressure_b=pressure_b, time=self._time()))

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        if not self.law.equation.startswith("pressure"):
            return 0.0, 0.0
        out = self._value(Signals(self.at.position, pressure_a=pressure_a, pressure_b=pressure_b, time=self._time()))
        return {"pressure": (out, -out), "pressure_a": (out, 0.0), "pressure_b": (0.0, out)}[self.law.equation]

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        return force + self._value(Signals(position)) if self.law.equation == "load" else force

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        return {"clock": 1.0} if self.law.timed else {}

    def _time(self) -> Symbol:
        return self.clock if self.law.timed else 0.0

    def _value(self, at: Signals) -> Symbol:
        return self.law.value(at, self.at.numbers, [getattr(self, name) for name in self.law.names])


class ValveClosure(Closure):
    """A law of the spool's position."""

    late = True

    def command(self, spool: Symbol) -> Symbol:
        return spool + self._value(Signals(current=spool))


def _made(law: Law | Table) -> type[Closure]:
    units = {"low": laws.VARIABLES.get(getattr(law, "variable", ""), ""), "high": ""}
    units["high"] = units["low"]
    unit = law.unit if isinstance(law, Law) else laws.UNITS[law.equation]
    members: dict[str, Any] = {
        name: parameter(units.get(name, unit), -_WIDEST, _WIDEST, scale=law.typical, neutral=0.0) for name in law.names
    }
    if law.timed:
        members["clock"] = hidden("s", scale=10.0, integrated=True)
    about = {"law": law, "options": {"equation": (law.equation,), "form": (law.form,)}, "__doc__": Closure.__doc__}
    return type("Closure", (ValveClosure if law.equation == "actuation" else Closure,), {**about, **members})


EFFECTS = tuple(_made(law) for law in laws.ALL.values())
