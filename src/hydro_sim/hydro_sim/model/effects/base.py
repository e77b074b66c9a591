# SPDX-License-Identifier: Apache-2.0
"""Base class of effects: parameters, hidden states, and terms in the bench's equations.

::

    class CoulombFriction(Effect):
        id = "friction_coulomb"
        equations = ("motion",)
        sentence_template = "Dry friction of {force:.3g} N works against the motion."
        force = parameter("N", 0.0, 1e8, scale=10.0, fit=fit(10.0, smallest_reported=0.3, high=5e3))

        def dry_level(self, level, velocity):
            return level + self.force

Everything else follows from these lines: simulation, C source, exact derivatives by state and parameters, and the cause
that the diagnosis looks for. While a model is assembled, a term is called once, and parameters and states are CasADi's
symbols; the diagnosis and the filter call it with numbers and arrays. A term modifies its argument and returns it,
so that effects of one kind add up in the order of the bench file. Hidden states are of two kinds: integrated ones have
a rate (`rates`); discrete ones are updated at the end of an integration step, by `self.next[...]`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from hydro_core.bench_scales import BenchScales, unit_ratio
from hydro_sim.model.equations import Symbol

DECLARED_SIZE = BenchScales(force=300.0, pressure=16e6, length=0.08, current=0.05)
"""Size of the machine for which the effects' fits are declared: the nominal bench's."""

DRIFT_MIN, DRIFT_MAX = 0.2, 5.0
"""Bounds of a factor that drifts with time: a simulation may run for hours."""


@dataclass(frozen=True, kw_only=True)
class FitParameter:
    """Specification of a fitted parameter: bounds, start values, and the smallest size that is reported.

    Declared for a machine of `DECLARED_SIZE`, and taken to the size of the diagnosed one by `resized`.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float = 0.0
    """Value at which the effect vanishes (for shape parameters: the usual value)."""
    start_values: tuple[float, ...]
    """Start values, within the bounds."""
    smallest_reported: float = 0.0
    """Distance from `neutral` below which a difference is not reported; 0 for shape parameters."""
    systematic: float = 0.003
    """For a shape parameter: relative error that the residuals' own discretisation may cause."""
    reported: bool = True
    """Whether it is reported; False for shape parameters that are only fitted."""

    def resized(self, size: BenchScales) -> FitParameter:
        """Return the specification for a machine of another size: each value by its unit."""
        ratio = unit_ratio(self.unit, DECLARED_SIZE, size)
        return replace(
            self, low=ratio * self.low, high=ratio * self.high, neutral=ratio * self.neutral,
            start_values=tuple(ratio * one for one in self.start_values),
            smallest_reported=ratio * self.smallest_reported,
        )  # fmt: skip

    @property
    def span(self) -> float:
        """Typical step of the parameter: largest distance of a start value from `neutral`."""
        return max(abs(value - self.neutral) for value in self.start_values) or abs(self.neutral)


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
    """Typical size: the standard deviation of the prior."""
    fit: FitParameter | None = None
    """Specification of the diagnosis' fit; None: the effect is not one of its causes."""


@dataclass(frozen=True, kw_only=True)
class HiddenState:
    """A hidden state of an effect."""

    name: str
    unit: str
    scale: float
    """Typical size."""
    integrated: bool
    """Whether it has a rate; else it is updated at the end of a step."""
    initial_signal: str = ""
    """Signal whose value it has on a bench at rest (a true reading, or `spool` [A]); empty: 0."""


def parameter(
    unit: str, low: float, high: float, *, scale: float, neutral: float = 0.0, fit: Mapping[str, Any] | None = None
) -> Any:
    """Declare a parameter, named by its attribute. `fit`: of `fit`, if the effect is one of the diagnosis' causes."""
    about: dict[str, Any] = {"name": "", "unit": unit, "low": low, "high": high, "neutral": neutral}
    return Parameter(**about, scale=scale, fit=FitParameter(**{**about, **fit}) if fit else None)


def fit(*start_values: float, smallest_reported: float = 0.0, **more: Any) -> dict[str, Any]:
    """Declare how a parameter is fitted (`FitParameter`); bounds and neutral value are the parameter's by default."""
    return {"start_values": start_values, "smallest_reported": smallest_reported, **more}


def hidden(unit: str, *, scale: float, integrated: bool = False, initial_signal: str = "") -> Any:
    """Declare a hidden state, named by its attribute."""
    return HiddenState(name="", unit=unit, scale=scale, integrated=integrated, initial_signal=initial_signal)


_DISPLAY_UNITS = {
    "A": ("mA", 1e3), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "s": ("ms", 1e3), "Pa": ("kPa", 1e-3),
    "m3/s/Pa": ("ml/s per MPa", 1e12), "m3/s/sqrt(Pa)": ("ml/s at 1 MPa", 1e9), "-": ("", 1.0),
}  # fmt: skip
_SENTENCE_FACTORS = {"1/s": 100.0, "Pa s/m3": 1e-12}
"""Factors from SI to % per second and to MPa per ml/s."""


def plain(text: str) -> str:
    """Return a text with numbers of up to seven digits written without an exponent."""
    return re.sub(r"\d(\.\d+)?e\+0[3-6]", lambda number: f"{float(number[0]):.0f}", text)


def display_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which sentences state values, and the factor from SI."""
    return _DISPLAY_UNITS.get(unit, (unit, 1.0))


@dataclass
class EffectContext:
    """Quantities of the model that an effect's terms may use."""

    bench: Any
    """Parameters of the bench, by their names in bench.yaml, and `valve_gain` (K_v)."""
    step: float
    """Length of an integration step [s]."""
    hoist: Callable[[Symbol], Symbol]
    """Marks an expression of parameters alone: it is evaluated when they change, not in every step."""
    dry_level: Callable[[Symbol], Symbol]
    """Dry friction [N] of all effects, at a velocity [m/s]."""
    initial_position: Symbol = 0.0
    """m, piston position at the begin of the present step."""
    position: Symbol = 0.0
    """m, of the piston at the instant whose rates are evaluated."""
    velocity: Symbol = 0.0
    """m/s, at that instant."""
    pressures: tuple[Symbol, Symbol] = (0.0, 0.0)
    """p_a, p_b [Pa] at that instant."""
    load_force: Symbol = 0.0
    """N, output of the load cell's amplifier at that instant."""
    acceleration: Symbol = 0.0
    """x'' [m/s2] where sensors are read."""
    returned: Symbol = 0.0
    """Flow [m3/s] through the valve's tank edges at that instant."""
    spool: Symbol = 0.0
    """Mean position of the spool [A] over the step."""
    current: Symbol = 0.0
    """Valve current [A] that is held over the sample."""


class Effect:
    """A physical effect beyond the textbook equations. Subclasses override the terms in which they act."""

    id: ClassVar[str]
    equations: tuple[str, ...] = ()
    """Equations in which it acts, the main one first: pressure_a, pressure_b, motion, load, actuation, sensor."""
    balances: ClassVar[frozenset[str]] = frozenset()
    """Balances whose residuals it changes (pressure, motion, load, hydraulic), if not those of its equations."""
    family: ClassVar[str] = ""
    """Effects of one family can mimic errors in each other's form."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Ids of effects that this one requires: without them it has no influence."""
    equivalent_parameter: ClassVar[str] = ""
    """Parameter of the bench file to whose scaling its `ratio` is equivalent; empty if none."""
    sentence_template: str = ""
    """Template of `sentence`, with the parameters by name in the units of `display_unit`, and the `effect`; `size` of
    the first parameter, and whether that is `more` or less than 0."""
    display_factors: ClassVar[Mapping[str, float]] = {}
    """Factors of parameters in the sentence, if not those of `display_unit`."""
    options: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Keys of an entry besides its parameters (chamber, cell, sensor, form), and their possible values."""
    single: ClassVar[bool] = False
    """Whether a bench can have only one."""
    acts_at_edges: ClassVar[bool] = False
    """Whether its `command` is applied after all others, in any order of the file: it acts at the edges."""
    depends_on_acceleration: ClassVar[bool] = False
    """Whether its term depends on the piston's acceleration."""
    all_edges: ClassVar[bool] = False
    """Whether both edges of a chamber may be open at the same time."""
    edge: str = ""
    """The edge on which its `land` is, one of `equations.EDGES`; empty if on none."""
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    states: ClassVar[tuple[HiddenState, ...]] = ()

    def __init_subclass__(cls) -> None:
        parameters, states = {one.name: one for one in cls.parameters}, list(cls.states)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, Parameter | HiddenState)}
        for name, one in own.items():
            delattr(cls, name)
            if isinstance(one, HiddenState):
                states.append(replace(one, name=name))
            else:  # declared again: in the place of the first
                parameters[name] = replace(one, name=name, fit=one.fit and replace(one.fit, name=name))
        cls.parameters, cls.states = tuple(parameters.values()), tuple(states)

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

    # --- interface of the diagnosis' causes --------------------------------------------------------------------------

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        """Return the parameters as they are fitted relative to a bench file; empty: it is no cause of the diagnosis."""
        fitted = [one.fit.resized(bench.size) for one in self.parameters if one.fit]
        return tuple(fitted) if len(fitted) == len(self.parameters) else ()

    def sentence(self, values: Mapping[str, float]) -> str:
        """Return a description of the effect for a person at the bench."""
        factors = {one.name: _SENTENCE_FACTORS.get(one.unit, display_unit(one.unit)[1]) for one in self.parameters}
        shown = {name: factor * values[name] for name, factor in (factors | dict(self.display_factors)).items()}
        first = next(iter(shown.values()))
        said = self.sentence_template.format(
            effect=self, size=abs(first), more="more" if first > 0.0 else "less", **shown
        )
        return plain(said[0].upper() + said[1:])

    # --- terms, on the way from the bench file to the reading -------------------------------------------------------

    def correct(self, n: Any) -> None:
        """Correct parameters of the bench file in place."""

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        """Return the hidden states at rest by name, 0 if absent; `signals`: true readings, and `spool` [A]."""
        return {one.name: signals[one.initial_signal] for one in self.states if one.initial_signal}

    def command(self, spool: Symbol) -> Symbol:
        """Return the mean position of the spool [A] over a step."""
        return spool

    def underlap(self, width: Symbol) -> Symbol:
        """Return the width [A] by which all four edges are open at null."""
        return width

    def land(self, width: Symbol) -> tuple[Symbol, Symbol]:
        """Return the width [A] by which its `edge` is open at null, from that of all, and its share of the flow [-]."""
        return width, 1.0

    def openings(self, out: Symbol, back: Symbol, spool: Symbol) -> tuple[Symbol, Symbol]:
        """Return the conductances [m3/s/sqrt(Pa)] of the edges that extend the piston, and that retract it."""
        return out, back

    def supply(self, pressure: Symbol) -> Symbol:
        """Return the supply pressure [Pa] at the valve."""
        return pressure

    def tank(self, pressure: Symbol) -> Symbol:
        """Return the pressure [Pa] behind the valve's tank edges."""
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

    def continuous_rates(self, signal: Symbol) -> tuple[Symbol, dict[str, Symbol]]:
        """Return output and state rates in continuous time for a command or sensor signal, for external solvers."""
        raise NotImplementedError

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        """Write the hidden states after a step into `self.next`; arguments: final position [m] and velocity [m/s]."""

    def filter_signal(self, channel: str, early: Symbol, late: Symbol) -> tuple[Symbol, Symbol]:
        """Return a sensor's signal at begin and end of a step, after the effect's amplifier."""
        return early, late

    def read_sensor(self, channel: str, signal: Symbol) -> Symbol:
        """Return a sensor's reading for its signal, with gain and bias errors."""
        return signal
