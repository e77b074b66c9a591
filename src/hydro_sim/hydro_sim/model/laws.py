# SPDX-License-Identifier: Apache-2.0
"""Laws: terms of one equation as data, for arrays and symbols alike.

Terms are linear in their amplitudes. A term's value acts in its equation::

    motion      force [N] against the motion
    pressure    flow [m3/s] out of chamber A into chamber B
    pressure_a  flow [m3/s] out of chamber A to the tank; pressure_b likewise
    actuation   spool position [A] at the edges in addition to the current's;
                of the edges: share of their flow that is blocked [-]; `across`: shift by the pressures across
                the valve and by its drive, at the edges alone [A]
    load        force [N] of the load
    sensor      error of a sensor's output [N, Pa or m]

No term depends on time except by a state that settles: any other would grow without bound. Besides its amplitude a law
may have shape parameters: a threshold, or the time or path over which a state `w` follows a signal `s`; a path's state
stays while its signal is constant::

    lag   w' = (s - w) / T
    path  w' = (s' - |s'| w) / D       within [-1, 1]: Dahl 1968; Bouc and Wen with n = 1
    slow  w' = (s - w) / T             0 at first: of a signal's magnitude, or of time alone (s = 1)
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
"""Velocity [m/s] over which terms with the velocity's sign reverse, unless their law has it as a parameter."""


@dataclass(frozen=True)
class Signals:
    """Signals in the formulas of laws, SI units; those unknown to an equation are 0."""

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
    total_drop: Symbol = 0.0
    """Pressure drop [Pa] across that edge and the other one that is open at the same time."""
    conductance: Symbol = 0.0
    """Conductance [m3/s/sqrt(Pa)] of that edge."""
    is_supply_edge: Symbol = 0.0
    """1 at an edge to the supply, 0 at one to the tank."""
    memory: Symbol = 0.0
    """State `w` of the law."""
    shape_1: Symbol = 0.0
    """First of the law's shape parameters, such as its threshold."""
    shape_2: Symbol = 0.0
    """Second of the law's shape parameters."""
    acceleration: Symbol = 0.0
    """x''."""
    reversal_velocity: Symbol = SIGN_VELOCITY
    """Velocity [m/s] over which the direction of motion reverses."""

    def replace(self, **changes: Symbol) -> Signals:
        """Return the signals with changes; a faster `dataclasses.replace`."""
        made = object.__new__(Signals)
        made.__dict__.update(self.__dict__, **changes)
        return made

    @property
    def direction(self) -> Symbol:
        """Smoothed sign of the velocity, -1 to 1."""
        return np.tanh(self.velocity / self.reversal_velocity)

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
    """Return the signals of a sensor's law: its own measurement and, from `beside`, those of others."""
    own = {"hydraulic_force": "force", "load_force": "force", "piston_position": "position"}.get(channel, channel)
    return Signals(**{**(beside or {}), own: signal})


BOUND_MAX = 1e9
"""Largest magnitude of a table's bounds and a law's threshold, in SI units, and of a coefficient in typical sizes."""


@dataclass(frozen=True)
class ShapeParameter:
    """A shape parameter of a law, apart from its amplitude."""

    name: str
    unit: str
    start_values: tuple[float, ...]
    """Start values of a search, ascending."""
    threshold_signal: str = ""
    """Signal in whose recorded range a threshold lies, with start values at its quantiles; empty: start at
    `start_values`."""


@dataclass(frozen=True)
class MemoryElement:
    """Memory element of a law: a state driven by one of `Signals`; its time or path is a shape parameter of the law."""

    kind: Literal["lag", "path", "slow"]
    signal: str
    """Driving signal, an attribute of `Signals`; of slow states also `time`."""


_SIGNALS = {
    "x": "at.position", "v": "at.velocity", "a": "at.acceleration", "u": "at.current", "f": "at.force",
    "w": "at.memory",
    "p_a": "at.pressure_a", "p_b": "at.pressure_b", "across": "at.pressure_difference", "sign_v": "at.direction",
    "turn": "at.reversal_velocity", "drop": "at.drop", "total_drop": "at.total_drop", "conductance": "at.conductance",
    "is_supply_edge": "at.is_supply_edge",
    "K": "n.valve_gain", "L": "n.stroke", "x_rest": "n.spring_rest_position", "A_p": "n.piston_area",
    "alpha": "n.area_ratio", "p_s": "n.supply_pressure", "p_t": "n.tank_pressure", "laminar": repr(TRANSITION_DROP),
    "one": "(1.0 + 0.0 * (at.position + at.pressure_a + at.pressure_b + at.current + at.force))",
}  # fmt: skip
"""Signals of a formula (`Signals`) and the bench's parameters; `one`: 1 of their shape."""
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
    """Expression of signals, bench parameters (`_SIGNALS`) and the law's shape parameters, by their names."""
    typical: float
    """Coefficient at which the term is noticeable."""
    sentence: str
    """Usual physical meaning of such a term."""
    memory_element: MemoryElement | None = None
    shape_parameters: tuple[ShapeParameter, ...] = ()
    """Shape parameters."""
    where: str = ""
    """Channel of a sensor; for the valve `edges`, `across`, or empty for a shift of the spool."""
    uses: frozenset[str] = frozenset()
    """Signals that the term depends on, and `time`."""
    degree: float = 0.0
    """Total power of the signals in the formula; signs, bumps and states count 0."""

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
        return ("coefficient", *(one.name for one in self.shape_parameters))

    @cached_property
    def shape(self) -> Any:
        """Formula as a function of `Signals` and the bench's parameters."""
        places = zip((one.name for one in self.shape_parameters), ("at.shape_1", "at.shape_2"), strict=False)
        names = {**_SIGNALS, **{name: place for name, place in places if name != "turn"}}
        python = re.sub(r"[A-Za-z_]\w*", lambda found: names.get(found[0], found[0]), self.formula)
        return eval(f"lambda at, n: {python}", _FUNCTIONS)

    def value(self, at: Signals, n: Any, parameters: Sequence[Symbol]) -> Symbol:
        """Return the value of the term, in the unit of its equation."""
        further = dict(zip(self.names, parameters, strict=True))
        if "turn" in further:
            at = at.replace(reversal_velocity=further.pop("turn"))
        _, shape_1, shape_2 = (*further.values(), 0.0, 0.0)[:3]
        return parameters[0] * self.shape(at.replace(shape_1=shape_1, shape_2=shape_2), n)


REVERSAL_VELOCITY = ShapeParameter("turn", "m/s", (SIGN_VELOCITY,))
"""Shape parameter of laws that reverse: the velocity over which they do."""
REVERSING_TEXT = "reversing over turn"
"""Text of laws with that parameter."""


def with_reversal_velocity(law: Law) -> Law:
    """Return the law with the reversal velocity [m/s] as an additional shape parameter."""
    text = f"{law.text}, {REVERSING_TEXT}"
    return replace(
        law,
        form=f"{law.form}, {REVERSING_TEXT}",
        text=text,
        shape_parameters=(*law.shape_parameters, REVERSAL_VELOCITY),
    )


def edge_losses(
    n: Any, openings: tuple[Symbol, Symbol], pressures: tuple[Symbol, Symbol], share: Callable[[Signals], Symbol]
) -> tuple[Symbol, Symbol]:
    """Return the flows [m3/s] lost to chambers A and B if a share [-] of each edge's flow is blocked.

    `n`: the bench's parameters. `openings`: conductance [m3/s/sqrt(Pa)] of the edges that drive the piston out, and
    back. `pressures`: p_a, p_b [Pa]. `share`: of an edge's flow, by `Signals` of the edge.
    """
    out, back = openings
    drops_out, drops_back = edge_drops(n.supply_pressure, n.tank_pressure, *pressures)
    side = Signals(pressure_a=pressures[0], pressure_b=pressures[1], current=out - back)
    over_out, over_back = drops_out[0] + drops_out[1], drops_back[0] + drops_back[1]

    def lost(conductance: Symbol, drop: Symbol, total_drop: Symbol, is_supply_edge: float) -> Symbol:
        at = side.replace(drop=drop, total_drop=total_drop, conductance=conductance, is_supply_edge=is_supply_edge)
        return share(at) * orifice(conductance, drop)

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
