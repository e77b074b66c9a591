# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis modelled and could not name: laws and tables of `model.laws` as terms of the bench's equations."""

from __future__ import annotations

from typing import Any, ClassVar

from hydro_sim.model import laws
from hydro_sim.model.effects.base import Effect, parameter
from hydro_sim.model.equations import Symbol
from hydro_sim.model.laws import Law, Signals, Table

_WIDEST = 1e9
"""SI unit, of where a table begins or ends."""
_REACH = 1e4
"""Times the typical size of a coefficient: how far it may go."""


class Closure(Effect):
    """One law or table; subclasses are made from `laws.ALL`."""

    id = "closure"
    law: ClassVar[Law | Table]

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        if self.law.equation != "motion":
            return 0.0
        pressure_a, pressure_b = self.at.pressures
        return self._value(Signals(position, velocity, pressure_a=pressure_a, pressure_b=pressure_b))

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        if not self.law.equation.startswith("pressure"):
            return 0.0, 0.0
        out = self._value(Signals(self.at.position, pressure_a=pressure_a, pressure_b=pressure_b))
        return {"pressure": (out, -out), "pressure_a": (out, 0.0), "pressure_b": (0.0, out)}[self.law.equation]

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        return force + self._value(Signals(position)) if self.law.equation == "load" else force

    def _value(self, at: Signals) -> Symbol:
        return self.law.value(at, self.at.numbers, [getattr(self, name) for name in self.law.names])


class ValveClosure(Closure):
    """A law of the spool's position."""

    late = True

    def command(self, spool: Symbol) -> Symbol:
        return spool + self._value(Signals(current=spool))


def _made(law: Law | Table) -> type[Closure]:
    unit = law.unit if isinstance(law, Law) else laws.UNITS[law.equation]
    reach = _REACH * law.typical
    members: dict[str, Any] = {name: parameter(unit, -reach, reach, scale=law.typical) for name in law.names}
    if isinstance(law, Table):
        over = laws.VARIABLES[law.variable]
        members |= {name: parameter(over, -_WIDEST, _WIDEST, scale=1.0) for name in ("low", "high")}
    about = {"law": law, "options": {"equation": (law.equation,), "form": (law.form,)}, "__doc__": Closure.__doc__}
    return type("Closure", (ValveClosure if law.equation == "actuation" else Closure,), {**about, **members})


EFFECTS = tuple(_made(law) for law in laws.ALL.values())
