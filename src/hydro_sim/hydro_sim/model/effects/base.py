# SPDX-License-Identifier: Apache-2.0
"""Base class of effects: parameters, hidden states, and terms in the bench's equations.

::

    class CoulombFriction(Effect):
        id = "friction_coulomb"
        force = parameter("N", 0.0, 1e8, scale=10.0)

        def dry_level(self, level, velocity):
            return level + self.force

Everything else follows from these lines: simulation, C source, exact derivatives by state and parameters. A method is
called once, while a model is assembled; parameters and states are CasADi's symbols then. A term changes what it is
given and returns it, so that effects of one kind add up in the order of the bench file. Hidden states are of two kinds:
integrated ones have a rate (`rates`); the others are moved on where an integration step ends, by `self.next[...]`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, ClassVar

from hydro_sim.model.equations import Symbol


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of an effect."""

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    """Value at which the effect vanishes."""
    scale: float
    """A typical size: the standard deviation of the prior."""

    def read(self, effect: str, parameters: Mapping[str, Any]) -> float:
        """Return its value in an entry's parameters. Raises ValueError if it is missing or not a number in range."""
        if self.name not in parameters:
            raise ValueError(f"effect {effect} lacks its parameter {self.name} [{self.unit}]")
        try:
            value = float(parameters[self.name])  # PyYAML reads 1e9 as a text
        except (TypeError, ValueError):
            value = float("nan")
        if not (isfinite(value) and self.low <= value <= self.high):
            wanted = f"a number in [{self.low:g}, {self.high:g}] {self.unit}"
            raise ValueError(f"effect {effect}: {self.name} = {parameters[self.name]!r} is not {wanted}")
        return value


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """A hidden state of an effect."""

    name: str
    unit: str
    scale: float
    """A typical size."""
    integrated: bool
    """Whether it has a rate; else it is moved on at the end of a step."""


def parameter(unit: str, low: float, high: float, *, scale: float, neutral: float = 0.0) -> Any:
    """Declare a parameter; its name is the attribute's."""
    return {"unit": unit, "low": low, "high": high, "scale": scale, "neutral": neutral}


def hidden(unit: str, *, scale: float, integrated: bool = False) -> Any:
    """Declare a hidden state; its name is the attribute's."""
    return {"unit": unit, "scale": scale, "integrated": integrated}


@dataclass
class EffectContext:
    """Quantities of the model that an effect's terms may use."""

    numbers: Any
    """The bench's numbers, by their names in bench.yaml, and `valve_gain` (K_v)."""
    step: float
    """s, an integration step."""
    once: Callable[[Symbol], Symbol]
    """Mark what depends on parameters alone: it is computed when these change, not in every step."""
    dry_level: Callable[[Symbol], Symbol]
    """Dry friction [N] of all effects, at a velocity [m/s]."""
    began: Symbol = 0.0
    """m, piston position where the present step began."""
    position: Symbol = 0.0
    """m, of the piston at the instant whose rates are written."""
    velocity: Symbol = 0.0
    """m/s, at that instant."""
    pressures: tuple[Symbol, Symbol] = (0.0, 0.0)
    """p_a, p_b [Pa] at that instant."""
    load_force: Symbol = 0.0
    """N, that the load cell's amplifier shows at that instant."""
    acceleration: Symbol = 0.0
    """x'' [m/s2] where sensors are read."""
    spool: Symbol = 0.0
    """Mean position of the spool [A] over the step."""
    current: Symbol = 0.0
    """A, that the box holds over the sample."""


class Effect:
    """A physical effect beyond the textbook equations. Subclasses override the terms in which they act."""

    id: ClassVar[str]
    options: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Keys of an entry beside its parameters (chamber, cell, sensor, form), and their possible values."""
    single: ClassVar[bool] = False
    """Whether a bench can have only one."""
    late: ClassVar[bool] = False
    """Whether its `command` comes after all others: edges open where the spool is, whatever the order of the file."""
    shaken: ClassVar[bool] = False
    """Whether it shows or drags the acceleration."""
    all_edges: ClassVar[bool] = False
    """Whether both edges of a chamber may be open at a time."""
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    states: ClassVar[tuple[Hidden, ...]] = ()

    def __init_subclass__(cls) -> None:
        own = {name: value for name, value in vars(cls).items() if isinstance(value, dict) and "scale" in value}
        for name in own:
            if hasattr(Effect, name):
                raise TypeError(f"{cls.__name__}: {name} is the name of a term, not of a parameter or a state")
            delattr(cls, name)
        numbers = [Parameter(name=name, **value) for name, value in own.items() if "neutral" in value]
        hiddens = [Hidden(name=name, **value) for name, value in own.items() if "integrated" in value]
        cls.parameters, cls.states = cls.parameters + tuple(numbers), cls.states + tuple(hiddens)

    def __init__(self, **chosen: str) -> None:
        self.at: Any = None
        """`EffectContext`, once the effect is part of a model."""
        self.next: dict[str, Symbol] = {}
        """Hidden states after the present step."""
        self.chosen = chosen
        for name, value in chosen.items():
            setattr(self, name, value)

    def __getattr__(self, name: str) -> Any:  # parameters and states, which a model sets
        raise AttributeError(f"{type(self).__name__} has no {name!r} until it is part of a model")

    @classmethod
    def acts_in(cls, term: str) -> bool:
        """Return whether the class overrides a term."""
        return getattr(cls, term) is not getattr(Effect, term)

    # --- terms, on the way from the bench file to the reading -------------------------------------------------------

    def correct(self, n: Any) -> None:
        """Correct numbers of the bench file in place."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        """Return the hidden states at rest by name, 0 if absent; `signals`: true readings, and `spool` [A]."""
        return {}

    def command(self, spool: Symbol) -> Symbol:
        """Return the mean position of the spool [A] over a step."""
        return spool

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        """Return the conductances [m3/s/sqrt(Pa)] of the edges that extend the piston, and that retract it."""
        return out, back

    def supply(self, pressure: Symbol) -> Symbol:
        """Return the supply pressure [Pa] at the valve."""
        return pressure

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        """Return the leakage flows [m3/s] out of chambers A and B."""
        return 0.0, 0.0

    def modulus(self, modulus: Symbol, pressure: Symbol) -> Symbol:
        """Return the bulk modulus [Pa] of a chamber at its pressure [Pa]."""
        return modulus

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        """Return the dry friction [N] while sliding at a velocity [m/s]."""
        return level

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        """Return the force [N] against the motion besides viscous and dry friction."""
        return 0.0

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        """Return the load's force [N] on the piston."""
        return force

    def inertia(self, position: Symbol) -> Symbol:
        """Return the mass [kg] moved with the load, whose force the load cell measures."""
        return 0.0

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        """Return the rates of the integrated hidden states, 1/s; `drawn`: flow [m3/s] from the supply."""
        return {}

    def flow(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        """Return output and state rates in continuous time for a command or sensor signal, for other solvers."""
        raise NotImplementedError

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        """Write the hidden states after a step into `self.next`; arguments: final position [m] and velocity [m/s]."""

    def filter_signal(self, channel: str, early: Symbol, late: Symbol) -> tuple[Symbol, Symbol]:
        """Return a sensor's signal at begin and end of a step, after the effect's amplifier."""
        return early, late

    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        """Return a sensor's reading for its signal, with gain and bias errors."""
        return signal
