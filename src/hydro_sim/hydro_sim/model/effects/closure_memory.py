# SPDX-License-Identifier: Apache-2.0
"""What unnamed terms remember: hidden states of a law or table of `model.grammar`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_sim.model import equations as eq
from hydro_sim.model.effects.closure_terms import Closure
from hydro_sim.model.equations import Symbol
from hydro_sim.model.law_signals import Signals


class Measured(Closure):
    """A law with a memory of one signal of the bench."""

    def _began(self, signals: Mapping[str, Symbol]) -> Symbol:
        """Its signal on a still bench."""
        if self.element.signal == "force":
            return signals[self.law.where]
        if self.element.signal == "velocity":
            return 0.0
        return signals[
            {"position": "piston_position", "current": "spool"}.get(self.element.signal, self.element.signal)
        ]

    def _now(self) -> Symbol:
        """Its signal at this instant."""
        p_a, p_b = self.at.pressures
        loaded = self.law.where == "load_force"
        force = self.at.load_force if loaded else eq.hydraulic_force(self.at.numbers, p_a, p_b)
        now = Signals(self.at.position, self.at.velocity, p_a, p_b, force=force)
        return getattr(now, self.element.signal)


class Lagging(Measured):
    """A law that lags behind a signal."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"past": self._began(signals)}

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        return {"past": (self._now() - self.past) / self.time}

    def _past(self) -> Symbol:
        return self.past


class Turning(Lagging):
    """A law that lags behind a signal, its rises by another time than its falls."""

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        off = self._now() - self.past
        return {"past": eq.choose(off > 0.0, off / self.rising, off / self.falling)}


class Warming(Closure):
    """A law that motion warms and time cools; a still bench is cold."""

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        return {"past": np.abs(self.at.velocity) / self.path - self.past / self.time}

    def _past(self) -> Symbol:
        return self.past


class Following(Closure):
    """A law that follows a size over a time, or time alone; it begins at nothing."""

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        signal = self.element.signal
        pressure_a, pressure_b = self.at.pressures
        first = getattr(self, self.law.names[1])
        now = Signals(self.at.position, self.at.velocity, pressure_a, pressure_b, self.at.spool, number=first)
        return {"past": ((1.0 if signal == "time" else getattr(now, signal)) - self.past) / self.time}

    def _past(self) -> Symbol:
        return self.past


class Settling(Closure):
    """The same of the spool's position, which is held over a step."""

    def command(self, spool: Symbol) -> Symbol:
        commanded = super().command(spool)
        left = np.exp(-self.at.step / self.time)
        self.next["past"] = self._driver(spool) + (self.past - self._driver(spool)) * left
        return commanded

    def _remembered(self, signal: Symbol) -> Symbol:
        """Mean over the step."""
        share = (1.0 - np.exp(-self.at.step / self.time)) * self.time / self.at.step
        return self._driver(signal) + (self.past - self._driver(signal)) * share

    def _driver(self, spool: Symbol) -> Symbol:
        return 1.0 if self.element.signal == "time" else getattr(Signals(current=spool), self.element.signal)


class Bending(Measured):
    """A law that follows a path: the piston's, the current's, or that of a sensor's signal."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"where": self._began(signals)}

    def command(self, spool: Symbol) -> Symbol:
        if self.element.signal == "current":
            self.next["bent"], self.next["where"] = self._remembered(spool), spool
        return super().command(spool)

    def remember(self, position: Symbol, velocity: Symbol) -> None:
        if self.element.signal != "current":
            now = position if self.element.signal == "position" else self._now()
            self.next["bent"], self.next["where"] = self._remembered(now), now

    def _past(self) -> Symbol:
        return self.bent

    def _remembered(self, signal: Symbol) -> Symbol:
        moved = signal - self.where
        goal = np.sign(moved)
        return goal + (self.bent - goal) * np.exp(-np.abs(moved) / self.path)


class Limited(Closure):
    """A law of a spool that lags, and moves no faster than a rate."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"where": signals["spool"]}

    def command(self, spool: Symbol) -> Symbol:
        off, near, left = self._course(spool)
        self.next["where"] = spool - np.sign(off) * near * left
        return super().command(spool)

    def _remembered(self, signal: Symbol) -> Symbol:
        """Mean over the step, exact for a signal that is held."""
        off, near, left = self._course(signal)
        fast = (np.abs(off) - near) / self.rate
        area = 0.5 * (np.abs(off) + near) * fast + near * self.time * (1.0 - left)
        return signal - np.sign(off) * area / self.at.step

    def _course(self, signal: Symbol) -> tuple[Symbol, Symbol, Symbol]:
        """How far off the signal is, how far after what it goes at full rate, and what an exponential leaves of it."""
        off = signal - self.where
        fast = eq.clip(np.abs(off) / self.rate - self.time, 0.0, self.at.step)
        return off, np.abs(off) - self.rate * fast, np.exp((fast - self.at.step) / self.time)


class TurningSpool(Closure):
    """A law of a spool that follows rises by another time than falls."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"where": signals["spool"]}

    def command(self, spool: Symbol) -> Symbol:
        off, _, left = self._course(spool)
        self.next["where"] = spool - off * left
        return super().command(spool)

    def _remembered(self, signal: Symbol) -> Symbol:
        """Mean over the step, exact for a signal that is held."""
        off, time, left = self._course(signal)
        return signal - off * time * (1.0 - left) / self.at.step

    def _course(self, signal: Symbol) -> tuple[Symbol, Symbol, Symbol]:
        """How far off the signal is, the time over which that fades, and what a step leaves of it."""
        off = signal - self.where
        time = self._time(off)
        return off, time, np.exp(-self.at.step / time)

    def _time(self, off: Symbol) -> Symbol:
        return eq.choose(off > 0.0, self.rising, self.falling)


class LaggingSpool(TurningSpool):
    """A law of a spool that follows late."""

    def _time(self, off: Symbol) -> Symbol:
        return self.time
