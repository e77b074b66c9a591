# SPDX-License-Identifier: Apache-2.0
"""Laws: terms of one equation as data, written once for arrays and symbols.

Terms are linear in their amplitudes. What one gives acts in its equation::

    motion      force [N] against the motion
    pressure    flow [m3/s] out of chamber A into chamber B
    pressure_a  flow [m3/s] out of chamber A to the tank; pressure_b likewise
    actuation   spool position [A] that the edges see more than the current says;
                of the edges: share of their flow that does not pass [-]; `across`: by the pressures across
                the valve and what moves it, at the edges alone [A]
    load        force [N] of the load
    sensor      what a sensor shows more than its signal [N, Pa or m]

None depends on time but by what settles: another would grow for ever. Beside its amplitude a law may have further
numbers: where a threshold lies, or over what a state `w` follows a signal `s`; a piston at rest or a still current
moves no path::

    lag   w' = (s - w) / T
    path  w' = (s' - |s'| w) / D       within [-1, 1]: Dahl 1968; Bouc and Wen with n = 1
    slow  w' = (s - w) / T             0 at first: a size that is followed, or time alone (s = 1)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from hydro_sim.model.equations import TRANSITION_DROP, Symbol, edge_drops, orifice

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

    def replace(self, **changes: Symbol) -> Signals:
        """Return the signals with changes; a faster `dataclasses.replace`."""
        made = object.__new__(Signals)
        made.__dict__.update(self.__dict__, **changes)
        return made

    @property
    def direction(self) -> Symbol:
        """Smoothed sign of the velocity, -1 to 1."""
        return np.tanh(self.velocity / self.turn)

    @property
    def pressure_difference(self) -> Symbol:
        """Pressure difference p_a - p_b [Pa]."""
        return self.pressure_a - self.pressure_b

    @property
    def speed(self) -> Symbol:
        """Speed |v| [m/s]."""
        return np.abs(self.velocity)

    @property
    def opening(self) -> Symbol:
        """Magnitude |u| of the valve opening [A]."""
        return np.abs(self.current)


def sensor_signals(channel: str, signal: Symbol, beside: Mapping[str, Symbol] | None = None) -> Signals:
    """Return the signals of a sensor's law: its own measurement and, from `beside`, others."""
    own = {"hydraulic_force": "force", "load_force": "force", "piston_position": "position"}.get(channel, channel)
    return Signals(**{**(beside or {}), own: signal})


BOUND_MAX = 1e9
"""SI unit, of where a table or a threshold may lie."""


@dataclass(frozen=True)
class Number:
    """A shape parameter of a law, apart from its amplitude."""

    name: str
    unit: str
    probes: tuple[float, ...]
    """Start values of a search, ascending."""
    over: str = ""
    """Signal whose recorded range a threshold lies in, its start values at quantiles; empty: they are as they stand."""


@dataclass(frozen=True)
class MemoryElement:
    """Memory element of a law: a state driven by one of `Signals`; its time or path is among the law's numbers."""

    kind: Literal["lag", "path", "slow"]
    signal: str
    """Driving signal, an attribute of `Signals`; of slow states also `time`."""


_SIGNALS = {
    "x": "at.position", "v": "at.velocity", "a": "at.acceleration", "u": "at.current", "f": "at.force",
    "w": "at.memory",
    "p_a": "at.pressure_a", "p_b": "at.pressure_b", "across": "at.pressure_difference", "sign_v": "at.direction",
    "turn": "at.turn", "drop": "at.drop", "both": "at.both", "opened": "at.opened", "feeds": "at.feeds",
    "K": "n.valve_gain", "L": "n.stroke", "x_rest": "n.spring_rest_position", "A_p": "n.piston_area",
    "alpha": "n.area_ratio", "p_s": "n.supply_pressure", "p_t": "n.tank_pressure", "laminar": repr(TRANSITION_DROP),
    "one": "(1.0 + 0.0 * (at.position + at.pressure_a + at.pressure_b + at.current + at.force))",
}  # fmt: skip
"""Signals of a formula (`Signals`) and the bench's numbers; `one`: 1 of their shape."""
_FUNCTIONS = {
    "abs": np.abs, "exp": np.exp, "sqrt": np.sqrt, "tanh": np.tanh, "max": np.fmax,
    "root": lambda pressure: pressure / np.sqrt(np.abs(pressure) + 100.0),
}  # fmt: skip
"""`root`: of a pressure drop [Pa], odd."""


@dataclass(frozen=True)
class Law:
    """Candidate term of a model equation: a coefficient times a formula of signals (not the box's force law)."""

    equation: str
    form: str
    unit: str
    """Unit of the coefficient; with that of the formula it gives that of the equation."""
    text: str
    """The formula as it is written in a report, with its memory."""
    formula: str
    """Expression of signals, bench numbers (`_SIGNALS`) and the law's further numbers, by their names."""
    typical: float
    """A coefficient at which it is noticeable."""
    sentence: str
    """Usual physical meaning of such a term."""
    memory_element: MemoryElement | None = None
    numbers: tuple[Number, ...] = ()
    """Its further numbers."""
    where: str = ""
    """Channel of a sensor; of the valve, `edges`, if it is not its spool that the law moves."""
    uses: frozenset[str] = frozenset()
    """Signals that it is made of, and `time`."""
    degree: float = 0.0
    """Total power of the signals in it; those of signs, bumps and states count nothing."""

    @property
    def depends_on_current(self) -> bool:
        """Whether it is a sensor's error that depends on the valve current."""
        return self.equation == "sensor" and self.memory_element is None and "current" in self.uses

    @property
    def has_hidden_states(self) -> bool:
        """Whether the law has hidden states."""
        return self.memory_element is not None or self.depends_on_current

    @property
    def is_step(self) -> bool:
        """Whether the formula is a step function."""
        return "where" in self.text

    @property
    def depends_on_direction(self) -> bool:
        """Whether the law depends on the sign of the velocity."""
        return re.search(r"\b(sign_v|turn)\b", self.formula) is not None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return ("coefficient", *(number.name for number in self.numbers))

    @cached_property
    def shape(self) -> Any:
        """Formula as a function of `Signals` and the bench's numbers."""
        places = zip((one.name for one in self.numbers), ("at.number", "at.second"), strict=False)
        names = {**_SIGNALS, **{name: place for name, place in places if name != "turn"}}
        python = re.sub(r"[A-Za-z_]\w*", lambda found: names.get(found[0], found[0]), self.formula)
        return eval(f"lambda at, n: {python}", _FUNCTIONS)

    def value(self, at: Signals, n: Any, numbers: Sequence[Symbol]) -> Symbol:
        """Return the value of the term, in the unit of its equation."""
        further = dict(zip(self.names, numbers, strict=True))
        if "turn" in further:
            at = at.replace(turn=further.pop("turn"))
        _, number, second = (*further.values(), 0.0, 0.0)[:3]
        return numbers[0] * self.shape(at.replace(number=number, second=second), n)


REVERSAL_VELOCITY = Number("turn", "m/s", (SIGN_VELOCITY,))
"""Velocity over which a law reverses."""
REVERSING = "reversing over turn"
"""Text of a law that has it as a number."""


def with_reversal_velocity(law: Law) -> Law:
    """Return the law with the reversal velocity [m/s] as an additional number."""
    text = f"{law.text}, {REVERSING}"
    return replace(law, form=f"{law.form}, {REVERSING}", text=text, numbers=(*law.numbers, REVERSAL_VELOCITY))


def edge_losses(
    n: Any, openings: tuple[Symbol, Symbol], pressures: tuple[Symbol, Symbol], share: Callable[[Signals], Symbol]
) -> tuple[Symbol, Symbol]:
    """Return the flows [m3/s] lost to chambers A and B if a share [-] of each edge's flow is blocked.

    `n`: the bench's numbers. `openings`: conductance [m3/s/sqrt(Pa)] of the edges that drive the piston out, and back.
    `pressures`: p_a, p_b [Pa]. `share`: of an edge's flow, by its pressure drop, its conductance and whether it feeds.
    """
    out, back = openings
    drops_out, drops_back = edge_drops(n.supply_pressure, n.tank_pressure, *pressures)
    side = Signals(pressure_a=pressures[0], pressure_b=pressures[1], current=out - back)
    over_out, over_back = drops_out[0] + drops_out[1], drops_back[0] + drops_back[1]

    def lost(opened: Symbol, drop: Symbol, both: Symbol, feeds: float) -> Symbol:
        return share(side.replace(drop=drop, both=both, opened=opened, feeds=feeds)) * orifice(opened, drop)

    lost_a = lost(out, drops_out[0], over_out, 1.0) - lost(back, drops_back[0], over_back, 0.0)
    return lost_a, lost(back, drops_back[1], over_back, 1.0) - lost(out, drops_out[1], over_out, 0.0)


def spool_shift_losses(n: Any, spool: Symbol, shift: Symbol, pressures: tuple[Symbol, Symbol]) -> tuple[Symbol, Symbol]:
    """Return the flows [m3/s] lost to chambers A and B if the spool [A] is shifted by `shift` [A]."""
    p_a, p_b = pressures
    drops_out, drops_back = edge_drops(n.supply_pressure, n.tank_pressure, p_a, p_b)
    to_a, to_b = 0.0, 0.0
    for sign, position in ((1.0, spool), (-1.0, spool + shift)):
        out, back = n.valve_gain * np.fmax(position, 0.0), n.valve_gain * np.fmax(-position, 0.0)
        to_a = to_a + sign * (orifice(out, drops_out[0]) - orifice(back, drops_back[0]))
        to_b = to_b + sign * (orifice(back, drops_back[1]) - orifice(out, drops_out[1]))
    return to_a, to_b
