# SPDX-License-Identifier: Apache-2.0
"""Base class of effects: named causes with parameters that act on command, flows, forces or measurements.

Every hook works on arrays of any shape and returns what it was given if the effect does not act there. The same hooks
serve the regression (arrays run over time) and the forward simulation (arrays run over windows): what has memory goes
through `Memory`, which either filters a whole record or advances one step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from math import nan
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.memory import Memory
from hydro_sim.model.bench import Bench

FloatArray = npt.NDArray[np.float64]
Pair = tuple[FloatArray, FloatArray]
"""Of chamber A and of chamber B."""
Values = Mapping[str, float]
Kept = TypeVar("Kept")
_DISPLAY_UNITS = {
    "A": ("mA", 1e3), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "s": ("ms", 1e3), "Pa": ("kPa", 1e-3),
    "m3/s/Pa": ("ml/s per MPa", 1e12), "m3/s/sqrt(Pa)": ("ml/s at 1 MPa", 1e9), "-": ("", 1.0),
}  # fmt: skip
"""Units in which sentences tell numbers, and the factor from SI."""
_IN_SENTENCES = {"1/s": 100.0, "Pa s/m3": 1e-12}
"""Factors from SI to % per second and to MPa per ml/s."""


def display_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which sentences tell numbers, and the factor from SI."""
    return _DISPLAY_UNITS.get(unit, (unit, 1.0))


PRESSURE, MOTION, LOAD, HYDRAULIC = "pressure", "motion", "load", "hydraulic"
"""The blocks of residuals that an effect can touch; only those are recomputed when its parameters change."""
TANK_MAX = 0.99
"""Largest pressure of the tank over that of the supply."""


def changed(bench: Bench, **values: float | None) -> Bench:
    """A bench with values replaced, kept within the ranges that `Bench` allows, and the tank below the supply."""
    limits = bench.quantities()
    inside: dict[str, Any] = {
        name: value if value is None else min(max(value, limits[name].low), limits[name].high)
        for name, value in values.items()
    }
    supply = inside.get("supply_pressure", bench.supply_pressure)
    tank = min(inside.get("tank_pressure", bench.tank_pressure), TANK_MAX * supply)
    return replace(bench, **{**inside, "tank_pressure": tank})


@dataclass(frozen=True, kw_only=True)
class FitParameter:
    """Parameter of an effect: bounds, neutral value, and smallest size worth claiming."""

    name: str
    unit: str
    low: float
    high: float
    neutral: float = 0.0
    """Value at which the effect vanishes (for shape parameters: the usual value)."""
    probes: tuple[float, ...]
    """Start values of the search, within the bounds."""
    smallest: float = 0.0
    """Distance from `neutral` below which a difference is not worth claiming; 0 for shape parameters."""
    systematic: float = 0.003
    """For a shape parameter: relative error that the residuals' own discretisation may cause."""
    reported: bool = True
    """False for shape parameters that are fitted but not part of the contract."""

    @property
    def span(self) -> float:
        """The natural step of this parameter."""
        return max(abs(probe - self.neutral) for probe in self.probes) or abs(self.neutral)


@dataclass
class Openings:
    """Valve edges as conductances, mean over the interval [m3/s/sqrt(Pa)]."""

    supply_a: FloatArray
    a_tank: FloatArray
    supply_b: FloatArray
    b_tank: FloatArray


@dataclass(frozen=True)
class Oil:
    """Inputs of the chambers' pressures at one instant or over one sample."""

    time: FloatArray
    position: FloatArray
    pressures: Pair
    spool: FloatArray
    """A, shape (..., substeps)."""
    velocity: FloatArray
    """m/s."""


@dataclass
class Kinematics:
    """Motion and pressures that forces depend on."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    pressures: Pair | None = None
    """Pa, of chambers A and B; None where they are not known."""
    acceleration: FloatArray | None = None
    """m/s2; None where it is not known."""


@dataclass(frozen=True)
class Effect:
    """A cause that the baseline leaves out.

    Subclasses set `id`, `equation`, `parameters`, `blocks` and override the hooks in which they act.
    """

    options: Mapping[str, str] = field(default_factory=dict)
    """Chamber, sensor or form; part of the report, except `form`."""
    reference: float = nan
    """The bench file's value of `refers`."""
    estimated: bool = False
    """Whether it stands for a number that is estimated (`estimation.unknown_numbers`): in every fit, never a claim."""

    id: ClassVar[str] = ""
    named: ClassVar[bool] = True
    """Whether it is in the table; other effects are tried, but never claimed."""
    equations: ClassVar[tuple[str, ...]] = ()
    """Equations in which it acts, the main one first: pressure_a, pressure_b, motion, load, actuation, sensor."""
    blocks: ClassVar[frozenset[str]] = frozenset()
    parameters: ClassVar[tuple[FitParameter, ...]] = ()
    refers: ClassVar[str] = ""
    """Number of the bench file on which the parameters depend; empty if none."""
    says: ClassVar[str] = ""
    """`sentence`: with its parameters by name, in the units of `display_unit`, and the `effect`; `size` of the first
    parameter, and whether that is `more` or less than nothing.
    """
    stage: ClassVar[int] = 1
    """Order in the command's path: 0 before the spool, 1 the spool's motion, 2 what the edges make of its position."""
    family: ClassVar[str] = ""
    """Effects of one family can mimic errors in each other's form."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Ids of effects without which this one does nothing."""
    other_forms: ClassVar[tuple[Effect, ...]] = ()
    """The same cause and parameters in forms that are not claimed: intervals hold for them too where they fit as well.
    """
    bristles: ClassVar[bool] = False
    """Whether it carries the dry friction elastically: the model then adds none of its own, and nothing sticks."""
    lagged: ClassVar[str] = ""
    """Channel whose readings it low-passes; empty if none."""
    memoryless: ClassVar[bool] = False
    """Whether a reading depends on the present signal, on a path or on slow states alone."""
    uses_acceleration: ClassVar[bool] = False
    """Whether it depends on the acceleration."""
    places: ClassVar[bool] = False
    """Whether the recorded position differs from the piston's by this effect."""
    nonlinear_channel: ClassVar[str] = ""
    """Channel whose reading is a nonlinear function of its signal by this effect; empty if none."""

    @property
    def label(self) -> str:
        """Id and options: unique among the candidates."""
        return ":".join([self.id, *self.options.values()])

    @property
    def amplitudes(self) -> tuple[FitParameter, ...]:
        """Parameters that have a size worth claiming; the others are `shapes`."""
        return tuple(one for one in self.parameters if one.smallest > 0.0)

    @property
    def shapes(self) -> tuple[FitParameter, ...]:
        """Shape parameters."""
        return tuple(one for one in self.parameters if one.smallest == 0.0)

    def sentence(self, values: Values) -> str:
        """Description of the effect for a person at the bench."""
        units = {one.name: one.unit for one in self.parameters}
        shown = {name: values[name] * _IN_SENTENCES.get(unit, display_unit(unit)[1]) for name, unit in units.items()}
        first = next(iter(shown.values()))
        said = self.says.format(effect=self, size=abs(first), more="more" if first > 0.0 else "less", **shown)
        return said[0].upper() + said[1:]

    def adapted(self, bench: Bench) -> Effect:
        """The effect relative to this bench."""
        return replace(self, reference=getattr(bench, self.refers)) if self.refers else self

    # -- hooks, in the order in which the model calls them ------------------------------------------------------------

    def bench(self, bench: Bench, values: Values) -> Bench:
        """The bench with a value replaced."""
        return bench

    def settled(self, bench: Bench, values: Values) -> Bench:
        """The bench file with this effect written into its numbers, exact where no earlier effect meets its hooks."""
        return self.bench(bench, values)

    def command(self, current: FloatArray, substep: float, values: Values) -> FloatArray:
        """Spool position [A] from the valve current, shape (n, substeps); `substep` in s. The record starts at rest."""
        return current

    def openings(self, edges: Openings, spool: FloatArray, time: FloatArray, values: Values) -> Openings:
        """Conductance of the valve's edges; `spool` [A] has shape (..., substeps), the edges (...)."""
        return edges

    def supply(self, supply: FloatArray, demand: FloatArray, memory: Memory, values: Values) -> FloatArray:
        """Supply pressure [Pa] under the `demand` [m3/s]."""
        return supply

    def flows(self, flows: Pair, pressures: Pair, tank: float, values: Values) -> Pair:
        """Net flows [m3/s] into chamber A and into chamber B."""
        return flows

    def stiffness(self, modulus: FloatArray, pressure: FloatArray, values: Values) -> FloatArray:
        """Bulk modulus [Pa] at an absolute pressure [Pa]."""
        return modulus

    def inflows(self, flows: Pair, oil: Oil, memory: Memory, values: Values) -> Pair:
        """Flow [m3/s] into chamber A and into chamber B, where it depends on more than the pressures."""
        return flows

    def drag(self, level: FloatArray, motion: Kinematics, values: Values) -> FloatArray:
        """Level [N, >= 0] of dry friction while sliding; the model gives it the sign of the velocity."""
        return level

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        """Force [N] against the motion beyond viscous friction; `level` is the dry friction's level while sliding."""
        return force

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        """Force [N] of the load."""
        return force

    def trace(self, motion: Kinematics, memory: Memory, values: Values) -> None:
        """Leave in a record's memory the states in which simulations begin at its samples, where hooks pass others."""

    def inertia(self, motion: Kinematics, bench: Bench, values: Values) -> FloatArray:
        """Mass [kg] that the load drags along, where the acceleration is not known yet; `load` has its force, too."""
        return np.zeros_like(motion.position)

    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        """Reading of a sensor for its true signal."""
        return signal

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        """True signal from a reading, as far as the sensor can be inverted."""
        return reading


FADED = 3.0**-0.5
"""Speed over which a rise towards standstill fades, over the top speed, at which 5 % of it are left there: exp(-3)."""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """How large the machine is that was recorded: numbers of its claims are of that order."""

    force: float
    """Largest recorded force [N]."""
    speed: float
    """Top speed [m/s]."""
    stroke: float
    """Distance [m]."""

    def reach(self, unit: str) -> float:
        """Largest size that a claim in a unit may have; 0 where the machine does not tell."""
        slow = 0.02 * self.speed
        sizes = {
            "N": self.force, "N s/m": self.force / slow, "m/s": FADED * self.speed,
            "N/m": self.force / (1e-3 * self.stroke), "kg": self.force * self.stroke / slow**2,
        }  # fmt: skip
        return sizes.get(unit, 0.0) * (1.0 if unit == "m/s" else 3.0)


def sized(effect: Effect, machine: Machine) -> Effect:
    """The effect with bounds that hold what the machine may show; never narrower than its own."""
    changed_ = [_sized(one, machine) for one in effect.parameters]
    if all(one is two for one, two in zip(changed_, effect.parameters, strict=True)):
        return effect
    kind = type(effect)
    made = type(kind.__name__, (kind,), {"parameters": tuple(changed_), "__module__": kind.__module__})
    found: Effect = made(**{one.name: getattr(effect, one.name) for one in fields(effect)})
    return found


def _sized(one: FitParameter, machine: Machine) -> FitParameter:
    reach = machine.reach(one.unit)
    low, high = one.low, one.high
    if one.unit in ("m/s", "N/m") and one.smallest == 0.0:
        low = min(low, 1e-3 * reach)
    elif low < 0.0 and one.neutral == 0.0 and low == -high:
        low = min(low, -reach)
    high = max(high, reach)
    return one if (low, high) == (one.low, one.high) else replace(one, low=low, high=high)


@dataclass(frozen=True)
class Claim:
    """An effect with values."""

    effect: Effect
    values: Values

    @property
    def acts(self) -> bool:
        """Whether it acts: a term without a name and without amplitude does not."""
        sizes = [self.values[one.name] for one in self.effect.amplitudes]
        return self.effect.named or any(sizes) or not sizes

    def to_mapping(self) -> dict[str, Any]:
        """Return the entry of corrected.yaml."""
        return {"id": self.effect.id, **self.effect.options, "parameters": dict(self.values)}


class BoundedCache:
    """So many results at most, each for some claims; the least recently used go first."""

    def __init__(self, room: int) -> None:
        self._room, self._found = room, dict[tuple[object, ...], Any]()

    def under(self, what: str, claims: Sequence[Claim], compute: Callable[[Sequence[Claim]], Kept]) -> Kept:
        """Return a result for these claims, computed once as long as only others change."""
        key = (what, *values_key(claims))
        found: Kept = self._found.pop(key) if key in self._found else compute(claims)
        self._found[key] = found
        if len(self._found) > self._room:
            self._found.pop(next(iter(self._found)))
        return found


def values_key(claims: Sequence[Claim]) -> tuple[tuple[Any, ...], ...]:
    """Key of claims with their values, for caches."""
    return tuple((claim.effect.label, *claim.values.values()) for claim in claims)


def changes(claim: Claim, *hooks: str) -> bool:
    """Whether a claim's effect acts in any of these hooks of `Effect`."""
    return any(getattr(type(claim.effect), hook) is not getattr(Effect, hook) for hook in hooks)


def acting(claims: Iterable[Claim], *hooks: str) -> list[Claim]:
    """The claims whose effects act in any of these hooks of `Effect`, in their order."""
    return [claim for claim in claims if changes(claim, *hooks)]
