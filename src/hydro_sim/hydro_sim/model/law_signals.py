# SPDX-License-Identifier: Apache-2.0
"""Signals that laws are made of, as arrays or symbols."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hydro_sim.model.equations import Symbol

SIGN_VELOCITY = 1e-3
"""Velocity [m/s] over which a term reverses that follows the velocity's sign, unless its law has it as a number."""


@dataclass(frozen=True)
class Signals:
    """Signals of which laws are made, SI units; those unknown to an equation are 0."""

    position: Symbol = 0.0
    velocity: Symbol = 0.0
    pressure_a: Symbol = 0.0
    pressure_b: Symbol = 0.0
    current: Symbol = 0.0
    """Position of the spool, as a current."""
    force: Symbol = 0.0
    """f_h."""
    drop: Symbol = 0.0
    """Pressure drop [Pa] across an edge of the valve."""
    both: Symbol = 0.0
    """Pressure drop [Pa] across that edge and the other that is open with it."""
    opened: Symbol = 0.0
    """Conductance [m3/s/sqrt(Pa)] of that edge."""
    feeds: Symbol = 0.0
    """1 at an edge to the supply, 0 at one to the tank."""
    memory: Symbol = 0.0
    """State `w` of the law."""
    number: Symbol = 0.0
    """First of the law's further numbers, such as its threshold."""
    second: Symbol = 0.0
    """Second of them."""
    acceleration: Symbol = 0.0
    """x''."""
    turn: Symbol = SIGN_VELOCITY
    """Velocity [m/s] over which the direction of motion reverses."""

    def but(self, **changes: Symbol) -> Signals:
        """The same signals with these changed: `dataclasses.replace`, which laws would spend their time in."""
        made = object.__new__(Signals)
        made.__dict__.update(self.__dict__, **changes)
        return made

    @property
    def direction(self) -> Symbol:
        """sign(v), -1 to 1, rounded where it reverses."""
        return np.tanh(self.velocity / self.turn)

    @property
    def pressure_difference(self) -> Symbol:
        """p_a - p_b."""
        return self.pressure_a - self.pressure_b

    @property
    def size_of_difference(self) -> Symbol:
        """|p_a - p_b|."""
        return np.abs(self.pressure_difference)

    @property
    def speed(self) -> Symbol:
        """|v|."""
        return np.abs(self.velocity)

    @property
    def jet(self) -> Symbol:
        """v |v|."""
        return self.velocity * np.abs(self.velocity)

    @property
    def opening(self) -> Symbol:
        """|u|."""
        return np.abs(self.current)

    @property
    def over_a(self) -> Symbol:
        """By how much p_a is above the law's first further number."""
        return np.fmax(self.pressure_a - self.number, 0.0)

    @property
    def over_b(self) -> Symbol:
        """By how much p_b is above it."""
        return np.fmax(self.pressure_b - self.number, 0.0)

    @property
    def heating(self) -> Symbol:
        """u^2."""
        return self.current * self.current


def sensed(channel: str, signal: Symbol, beside: Mapping[str, Symbol] | None = None) -> Signals:
    """Signals of a sensor's law: the one that it measures, and what stands beside it."""
    own = {"hydraulic_force": "force", "load_force": "force", "piston_position": "position"}.get(channel, channel)
    return Signals(**{**(beside or {}), own: signal})
