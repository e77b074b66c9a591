# SPDX-License-Identifier: Apache-2.0
"""Closures: laws and tables of `model.grammar` as effects.

A closure's class combines the equation in which its law acts, with one base for each, and the law's memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from hydro_sim.model import equations as eq
from hydro_sim.model import grammar, laws, tables
from hydro_sim.model.effects.base import Effect, FitParameter, fit, hidden, parameter
from hydro_sim.model.equations import Symbol
from hydro_sim.model.laws import BOUND_MAX, REVERSAL_VELOCITY, Law, MemoryElement, Signals
from hydro_sim.model.tables import Table

# --- where they act --------------------------------------------------------------------------------------------------


class Closure(Effect):
    """Closure: a law or table; subclasses are created from `grammar.FORMS`, with one base per equation."""

    id = "closure"
    law: ClassVar[Law | Table]
    memory_element: ClassVar[MemoryElement]
    """Memory element of the law; only classes of laws with one have it."""

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        return tuple(one.fit.resized(bench.size) for one in self.parameters if one.fit)

    def sentence(self, values: Mapping[str, float]) -> str:
        law = self.law
        if isinstance(law, Law):
            return law.sentence
        what = f"A coefficient of the {law.factor.name} that follows" if law.factor else "A smooth function of"
        return f"{what} the {law.variable.replace('_', ' ')}, for which no law was found."

    def _value(self, at: Signals) -> Symbol:
        return self.law.value(at, self.at.bench, [getattr(self, name) for name in self.law.names])

    def _memory_state(self) -> Symbol:
        """State of the memory element at this instant; 0 without one."""
        return getattr(self, "past", 0.0)

    def _final_memory_state(self, signal: Symbol) -> Symbol:
        """State of the memory element at the end of a step, at which its input is `signal`."""
        return self._memory_state()

    def _memory_input(self) -> Symbol:
        """Input of the memory element at this instant; 1 if that is time."""
        p_a, p_b = self.at.pressures
        loaded = self.law.where == "load_force"
        force = self.at.load_force if loaded else eq.hydraulic_force(self.at.bench, p_a, p_b)
        now = Signals(self.at.position, self.at.velocity, p_a, p_b, self.at.spool, force)
        return 1.0 if self.memory_element.signal == "time" else getattr(now, self.memory_element.signal)


class MotionClosure(Closure):
    """Closure as a force against the motion."""

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        pressure_a, pressure_b = self.at.pressures
        return self._value(Signals(position, velocity, pressure_a, pressure_b, memory=self._memory_state()))


class FlowClosure(Closure):
    """Closure as a leakage flow out of the chambers, parallel to the valve."""

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        at = Signals(
            self.at.position, self.at.velocity, pressure_a, pressure_b, self.at.spool, memory=self._memory_state()
        )
        out = self._value(at)
        return {"pressure": (out, -out), "pressure_a": (out, 0.0), "pressure_b": (0.0, out)}[self.law.equation]


class EdgeClosure(Closure):
    """Closure as a blocked share of the flow through the valve's edges."""

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        n, spool = self.at.bench, self.at.spool
        openings = n.valve_gain * np.fmax(spool, 0.0), n.valve_gain * np.fmax(-spool, 0.0)
        past = self._memory_state()
        return laws.edge_losses(n, openings, (pressure_a, pressure_b), lambda at: self._value(at.replace(memory=past)))


class SpoolShiftClosure(Closure):
    """Closure as a shift of the spool at the edges, by pressures, velocity, position or current."""

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        n, spool = self.at.bench, self.at.spool
        at = Signals(self.at.position, self.at.velocity, pressure_a, pressure_b, spool)
        return laws.spool_shift_losses(n, spool, self._value(at), (pressure_a, pressure_b))


class LoadMassClosure(Closure):
    """Closure as a mass that moves with the load."""

    def inertia(self, position: Symbol) -> Symbol:
        return self._value(Signals(position, self.at.velocity, acceleration=1.0))


class LoadClosure(Closure):
    """Closure as a force of the load."""

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        return force + self._value(Signals(position, self.at.velocity, memory=self._final_memory_state(position)))


class SensorClosure(Closure):
    """Closure as a sensor's error; `held`: valve current at the reading, if the error depends on it."""

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        self.next["held"] = self.at.current

    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        if channel != self.law.where:
            return signal
        pressure_a, pressure_b = self.at.pressures
        beside = {"position": self.at.position, "velocity": self.at.velocity, "pressure_a": pressure_a,
                  "pressure_b": pressure_b, "current": getattr(self, "held", 0.0),
                  "acceleration": self.at.acceleration}  # fmt: skip
        return signal + self._value(replace(laws.sensor_signals(channel, signal, beside), memory=self._memory_state()))


class ValveClosure(Closure):
    """Closure as a shift of the spool, by its position."""

    acts_at_edges = True

    def command(self, spool: Symbol) -> Symbol:
        return spool + self._value(Signals(current=spool, memory=self._final_memory_state(spool)))


# --- memory ----------------------------------------------------------------------------------------------------------


class LagClosure(Closure):
    """Law with a first-order lag of a signal, its magnitude or time."""

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        return {"past": (self._memory_input() - self.past) / self.time}


class SpoolLagClosure(Closure):
    """First-order lag of the spool's position, constant over a step."""

    def command(self, spool: Symbol) -> Symbol:
        commanded = super().command(spool)
        left = np.exp(-self.at.step / self.time)
        self.next["past"] = self._driver(spool) + (self.past - self._driver(spool)) * left
        return commanded

    def _final_memory_state(self, signal: Symbol) -> Symbol:
        """Mean over the step."""
        share = (1.0 - np.exp(-self.at.step / self.time)) * self.time / self.at.step
        return self._driver(signal) + (self.past - self._driver(signal)) * share

    def _driver(self, spool: Symbol) -> Symbol:
        return (
            1.0 if self.memory_element.signal == "time" else getattr(Signals(current=spool), self.memory_element.signal)
        )


class HysteresisClosure(Closure):
    """Law with hysteresis in the piston's position, the current or a sensor's signal."""

    def command(self, spool: Symbol) -> Symbol:
        if self.memory_element.signal == "current":
            self.next["bent"], self.next["where"] = self._final_memory_state(spool), spool
        return super().command(spool)

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        if self.memory_element.signal != "current":
            now = position if self.memory_element.signal == "position" else self._memory_input()
            self.next["bent"], self.next["where"] = self._final_memory_state(now), now

    def _memory_state(self) -> Symbol:
        return self.bent

    def _final_memory_state(self, signal: Symbol) -> Symbol:
        moved = signal - self.where
        goal = np.sign(moved)
        return goal + (self.bent - goal) * np.exp(-np.abs(moved) / self.path)


# --- one class for each law ------------------------------------------------------------------------------------------

_CLOSURE_BASES = {"motion": MotionClosure, "load": LoadClosure, "sensor": SensorClosure, "actuation": ValveClosure,
           "edges": EdgeClosure, "across": SpoolShiftClosure}  # fmt: skip
"""Bases by the equation, or by `where` at the valve; other equations are those of flows."""
_DRIVING_SIGNALS = {"position": ("m", 1e-2), "current": ("A", 1e-3), "opening": ("A", 1e-3), "force": ("N", 100.0),
             "speed": ("m/s", 0.05), "velocity": ("m/s", 0.05), "time": ("-", 1.0)}  # fmt: skip
"""Unit and typical size of the signals that drive memory elements; others are pressures."""


def closure_class(law: Law | Table) -> type[Closure]:
    """Return the effect class of a law or table."""
    size, element = law.typical, law.memory_element
    amplitude = parameter(
        law.unit,
        -BOUND_MAX * size,
        BOUND_MAX * size,
        scale=size,
        fit=fit(size, smallest_reported=1e-3 * size),
    )
    members: dict[str, Any] = dict.fromkeys(law.names, amplitude)
    if isinstance(law, Table):
        over = tables.VARIABLE_UNITS[law.variable]
        members |= {name: parameter(over, -BOUND_MAX, BOUND_MAX, scale=1.0) for name in ("low", "high")}
    else:
        # the recorded velocity is smoothed: a reversal velocity is estimated less precisely
        for one in law.shape_parameters:
            middle = one.start_values[len(one.start_values) // 2]
            low, high = 0.1 * one.start_values[0], 10.0 * one.start_values[-1]
            reach = (-BOUND_MAX, BOUND_MAX) if one.threshold_signal else (1e-3 * low, 1e3 * high)  # of any machine
            systematic = 0.6 if one.name == REVERSAL_VELOCITY.name else 0.01
            bounds = {} if one.threshold_signal else {"low": low, "high": high}
            fitted = fit(*one.start_values, systematic=systematic, **bounds)
            members[one.name] = parameter(one.unit, *reach, scale=abs(middle), neutral=middle, fit=fitted)
    acts = _CLOSURE_BASES.get(law.where) or _CLOSURE_BASES.get(law.equation, FlowClosure)
    bases: tuple[type[Closure], ...] = (acts,)
    if element is None:
        if law.depends_on_current:
            members["held"] = hidden("A", scale=1e-3)
        if "acceleration" in law.uses and law.equation == "load":
            bases = (LoadMassClosure,)
    else:
        unit, scale = _DRIVING_SIGNALS.get(element.signal, ("Pa", 1e6))
        starts = {"force": law.where, "position": "piston_position", "current": "spool"}
        start = "" if element.kind == "slow" else starts.get(element.signal, element.signal)
        if element.kind == "path":
            bases, members["bent"] = (HysteresisClosure, acts), hidden("-", scale=1.0)
            members["where"] = hidden(unit, scale=scale, initial_signal=start)
        else:
            bases = SpoolLagClosure if acts is ValveClosure else LagClosure, acts
            members["past"] = hidden(unit, scale=scale, integrated=acts is not ValveClosure, initial_signal=start)
        members["memory_element"] = element
    members |= {"law": law, "depends_on_acceleration": "acceleration" in law.uses, "__doc__": Closure.__doc__}
    members |= {"options": {"equation": (law.equation,), "form": (law.form,)}}
    return type("Closure", bases, members)


EFFECTS = tuple(closure_class(law) for law in grammar.FORMS.values())
