# SPDX-License-Identifier: Apache-2.0
"""Closures: unnamed terms found by a diagnosis, as laws and tables of `model.grammar`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from hydro_sim.model import equations as eq
from hydro_sim.model import grammar, laws
from hydro_sim.model.effects.base import Effect, hidden, parameter
from hydro_sim.model.equations import Symbol
from hydro_sim.model.laws import Element, Law, Signals, Table

_WIDEST = 1e9
"""SI unit, of where a table begins or ends."""
_REACH = 1e4
"""Bound of a coefficient, as a multiple of its typical size."""
_SCALES = {"m": 1e-2, "A": 1e-3, "Pa": 1e6, "N": 100.0}


class Closure(Effect):
    """One law or table; subclasses are made from `grammar.ALL`."""

    id = "closure"
    law: ClassVar[Law | Table]
    element: ClassVar[Element | None] = None

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        if self.law.equation != "motion":
            return 0.0
        pressure_a, pressure_b = self.at.pressures
        return self._value(Signals(position, velocity, pressure_a=pressure_a, pressure_b=pressure_b))

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        if not self.law.equation.startswith("pressure"):
            return 0.0, 0.0
        at = Signals(self.at.position, pressure_a=pressure_a, pressure_b=pressure_b, memory=self._past())
        out = self._value(at)
        return {"pressure": (out, -out), "pressure_a": (out, 0.0), "pressure_b": (0.0, out)}[self.law.equation]

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        if self.law.equation != "load":
            return force
        return force + self._value(Signals(position, memory=self._remembered(position)))

    def show(self, channel: str, signal: Symbol) -> Symbol:
        if self.law.equation != "sensor" or channel != "hydraulic_force":
            return signal
        return signal + self._value(Signals(force=signal, memory=self._past()))

    def _value(self, at: Signals) -> Symbol:
        return self.law.value(at, self.at.numbers, [getattr(self, name) for name in self.law.names])

    def _past(self) -> Symbol:
        return 0.0

    def _remembered(self, signal: Symbol) -> Symbol:
        """State of the element in equilibrium with this signal."""
        return self._past()


class Lagging(Closure):
    """A law that lags behind a signal."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        assert self.element is not None
        channel = {"position": "piston_position", "force": "hydraulic_force"}.get(
            self.element.signal, self.element.signal
        )
        return {"past": signals[channel]}

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        assert self.element is not None
        p_a, p_b = self.at.pressures
        force = eq.hydraulic_force(self.at.numbers, p_a, p_b)
        now = getattr(Signals(self.at.position, pressure_a=p_a, pressure_b=p_b, force=force), self.element.signal)
        return {"past": (now - self.past) / getattr(self, self.element.number)}

    def _past(self) -> Symbol:
        return self.past


class Bending(Closure):
    """A law of the load that follows the piston's path."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"where": signals["piston_position"]}

    def remember(self, position: Symbol, velocity: Symbol) -> None:
        self.next["bent"], self.next["where"] = self._remembered(position), position

    def _remembered(self, signal: Symbol) -> Symbol:
        assert self.element is not None
        moved = signal - self.where
        goal = np.sign(moved)
        return goal + (self.bent - goal) * np.exp(-np.abs(moved) / getattr(self, self.element.number))


class ValveClosure(Closure):
    """A law of the spool's position."""

    late = True

    def command(self, spool: Symbol) -> Symbol:
        return spool + self._value(Signals(current=spool, memory=self._remembered(spool)))


class BendingValve(Bending, ValveClosure):
    """A law of the spool's position that follows the current's path."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"where": signals["spool"]}

    def command(self, spool: Symbol) -> Symbol:
        self.next["bent"], self.next["where"] = self._remembered(spool), spool
        return super().command(spool)

    def remember(self, position: Symbol, velocity: Symbol) -> None:
        """The command has been remembered already."""


def _made(law: Law | Table) -> type[Closure]:
    reach = _REACH * law.typical
    members: dict[str, Any] = {name: parameter(law.unit, -reach, reach, scale=law.typical) for name in law.names}
    element = law.element if isinstance(law, Law) else None
    if isinstance(law, Table):
        over = laws.VARIABLES[law.variable]
        members |= {name: parameter(over, -_WIDEST, _WIDEST, scale=1.0) for name in ("low", "high")}
    if element is not None:
        members |= _states(element)
    about = {"law": law, "options": {"equation": (law.equation,), "form": (law.form,)}, "__doc__": Closure.__doc__}
    return type("Closure", (_base(law, element),), {**about, "element": element, **members})


def _states(element: Element) -> dict[str, Any]:
    """An element's number and its hidden states."""
    middle = element.probes[len(element.probes) // 2]
    number = {element.number: parameter(element.unit, *element.bounds, scale=middle, neutral=middle)}
    scale = _SCALES[element.signal_unit]
    if element.kind == "lag":
        return {**number, "past": hidden(element.signal_unit, scale=scale, integrated=True)}
    return {**number, "bent": hidden("-", scale=1.0), "where": hidden(element.signal_unit, scale=scale)}


def _base(law: Law | Table, element: Element | None) -> type[Closure]:
    valve = law.equation == "actuation"
    if element is None:
        return ValveClosure if valve else Closure
    if element.kind == "lag":
        return Lagging
    return BendingValve if valve else Bending


EFFECTS = tuple(_made(law) for law in grammar.ALL.values())
