# SPDX-License-Identifier: Apache-2.0
"""Where unnamed terms act: a law or table of `model.grammar` in each of the bench's equations."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from hydro_sim.model.edge_laws import edge_losses, shifted
from hydro_sim.model.effects.base import Effect
from hydro_sim.model.equations import Symbol
from hydro_sim.model.law_signals import Signals, sensed
from hydro_sim.model.laws import Element, Law
from hydro_sim.model.tables import Table


class Closure(Effect):
    """One law or table; subclasses are made from `grammar.ALL`, one base for each equation."""

    id = "closure"
    law: ClassVar[Law | Table]
    element: ClassVar[Element]
    """What it remembers, if it does."""

    def _value(self, at: Signals) -> Symbol:
        return self.law.value(at, self.at.numbers, [getattr(self, name) for name in self.law.names])

    def _past(self) -> Symbol:
        """State of the law at this instant."""
        return 0.0

    def _remembered(self, signal: Symbol) -> Symbol:
        """State of the law at the end of a step in which its signal has come to this."""
        return self._past()

    def _held(self) -> Symbol:
        """Current [A] under which a sensor is read."""
        return 0.0


class MotionClosure(Closure):
    """A force against the motion."""

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        pressure_a, pressure_b = self.at.pressures
        return self._value(Signals(position, velocity, pressure_a, pressure_b, memory=self._past()))


class FlowClosure(Closure):
    """A flow out of the chambers beside the valve."""

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        at = Signals(self.at.position, self.at.velocity, pressure_a, pressure_b, self.at.spool, memory=self._past())
        out = self._value(at)
        return {"pressure": (out, -out), "pressure_a": (out, 0.0), "pressure_b": (0.0, out)}[self.law.equation]


class EdgeClosure(Closure):
    """A share of the flow through the valve's edges that does not pass."""

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        n, spool = self.at.numbers, self.at.spool
        openings = n.valve_gain * np.fmax(spool, 0.0), n.valve_gain * np.fmax(-spool, 0.0)
        past = self._past()
        return edge_losses(n, openings, (pressure_a, pressure_b), lambda at: self._value(at.but(memory=past)))


class AcrossClosure(Closure):
    """A shift of the spool at the edges, by the pressures across the valve and what moves it."""

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        n, spool = self.at.numbers, self.at.spool
        at = Signals(self.at.position, self.at.velocity, pressure_a, pressure_b, spool)
        return shifted(n, spool, self._value(at), (pressure_a, pressure_b))


class DraggedClosure(Closure):
    """A mass that the load drags along."""

    shaken = True

    def inertia(self, position: Symbol) -> Symbol:
        return self._value(Signals(position, self.at.velocity, acceleration=1.0))


class LoadClosure(Closure):
    """A force of the load."""

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        return force + self._value(Signals(position, self.at.velocity, memory=self._remembered(position)))


class SensorClosure(Closure):
    """What a sensor shows more than its signal."""

    def show(self, channel: str, signal: Symbol) -> Symbol:
        if channel != self.law.where:
            return signal
        pressure_a, pressure_b = self.at.pressures
        beside = {"position": self.at.position, "velocity": self.at.velocity, "pressure_a": pressure_a,
                  "pressure_b": pressure_b, "current": self._held(), "acceleration": self.at.acceleration}  # fmt: skip
        return signal + self._value(replace(sensed(channel, signal, beside), memory=self._past()))


class ValveClosure(Closure):
    """A law of the spool's position."""

    late = True

    def command(self, spool: Symbol) -> Symbol:
        return spool + self._value(Signals(current=spool, memory=self._remembered(spool)))


class Shaken(SensorClosure):
    """A reading that follows the acceleration."""

    shaken = True


class PickingUp(SensorClosure):
    """A reading that follows the valve's current: that which was held until the sample."""

    def remember(self, position: Symbol, velocity: Symbol) -> None:
        self.next["held"] = self.at.current

    def _held(self) -> Symbol:
        return self.held
