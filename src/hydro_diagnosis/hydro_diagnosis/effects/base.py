# SPDX-License-Identifier: Apache-2.0
"""Effects as causes: an effect of the bench model (`hydro_sim.model.effects`) with the bounds and starts of its fit.

The equations are the model's own: a hook binds an effect to values and to what was recorded, and calls the term of the
same name on arrays. Every hook returns what it was given if the effect does not act there. The same hooks serve the
regression (arrays run over time) and the forward simulation (arrays run over windows): what has memory goes through
`Memory`, which either filters a whole record or advances one step (`effects.dynamics`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.memory import Memory
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import base as physics
from hydro_sim.model.effects.base import FitParameter as FitParameter
from hydro_sim.model.effects.base import display_unit as display_unit
from hydro_sim.model.effects.catalogue import Kind
from hydro_sim.model.effects.sensing import Sensor, SensorLag

FloatArray = npt.NDArray[np.float64]
Pair = tuple[FloatArray, FloatArray]
"""Of chamber A and of chamber B."""
Values = Mapping[str, float]
Result = TypeVar("Result")
PRESSURE, MOTION, LOAD, HYDRAULIC = "pressure", "motion", "load", "hydraulic"
"""The blocks of residuals that an effect can touch; only those are recomputed when its parameters change."""
_BLOCKS = {"motion": {MOTION}, "load": {MOTION, LOAD}}
_SENSED = {
    "hydraulic_force": {MOTION, HYDRAULIC}, "load_force": {LOAD}, "pressure_a": {PRESSURE, HYDRAULIC},
    "pressure_b": {PRESSURE, HYDRAULIC}, "piston_position": {PRESSURE, MOTION, LOAD},
}  # fmt: skip
"""Blocks of residuals in which a sensor shows, by its channel."""


def substep_mean(signal: FloatArray) -> FloatArray:
    """Mean over the last axis, which is short: from shape (..., substeps) to (...)."""
    first, *others = np.moveaxis(signal, -1, 0)
    return np.asarray(sum(others, first) / signal.shape[-1])


def blocks_of(equation: str, channel: str = "") -> frozenset[str]:
    """Return the blocks of residuals in which an equation shows, or the error of a channel's sensor."""
    return frozenset(_SENSED[channel] if equation == "sensor" else _BLOCKS.get(equation, {PRESSURE}))


def with_values(bench: Bench, **values: float | None) -> Bench:
    """Return a bench with values replaced, within the ranges of `Bench` and with the tank below the supply."""
    limits = bench.quantities()
    inside: dict[str, Any] = {
        name: value if value is None else min(max(value, limits[name].low), limits[name].high)
        for name, value in values.items()
    }
    supply = inside.get("supply_pressure", bench.supply_pressure)
    tank = min(inside.get("tank_pressure", bench.tank_pressure), 0.99 * supply)
    return replace(bench, **{**inside, "tank_pressure": tank})


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


class _Corrected:
    """The numbers of a bench, which a correction sets."""

    def __init__(self, bench: Bench) -> None:
        self.__dict__["bench"] = bench

    def __getattr__(self, name: str) -> Any:
        return getattr(self.bench, name)


@dataclass(frozen=True)
class Effect:
    """A cause that the baseline leaves out. What has memory overrides the hook in which it acts."""

    kind: Kind
    """Effect of the model, with its options."""
    parameters: tuple[FitParameter, ...] = ()
    """As they are fitted, relative to the bench to which it is adapted."""
    estimated: bool = False
    """Whether it stands for a number that is estimated (`estimation.unknown_numbers`): in every fit, never a claim."""

    named: ClassVar[bool] = True
    """Whether it is in the table; other effects are tried, but never claimed."""
    stage: ClassVar[int] = 1
    """Order in the command's path: 0 before the spool, 1 the spool's motion, 2 what the edges make of its position."""
    other_forms: ClassVar[tuple[Effect, ...]] = ()
    """The same cause and parameters in forms that are not claimed: intervals hold for them too where they fit as well.
    """
    bristles: ClassVar[bool] = False
    """Whether it carries the dry friction elastically: the model then adds none of its own, and nothing sticks."""
    memoryless: ClassVar[bool] = False
    """Whether a reading depends on the present signal, on a path or on slow states alone."""
    depends_on_acceleration: ClassVar[bool] = False
    """Whether its term depends on the piston's acceleration."""
    is_position_error: ClassVar[bool] = False
    """Whether it is an error of the position sensor: the recorded position differs from the piston's."""
    nonlinear_channel: ClassVar[str] = ""
    """Channel whose reading is a nonlinear function of its signal by this effect; empty if none."""

    @cached_property
    def physics(self) -> physics.Effect:
        """The effect of the model; its values are bound in each hook."""
        return self.kind.make()

    @property
    def id(self) -> str:
        """Of the table."""
        return self.kind.effect.id

    @cached_property
    def options(self) -> dict[str, str]:
        """Chamber, sensor or form; part of the report, except `form`."""
        return dict(self.kind.chosen)

    @property
    def equations(self) -> tuple[str, ...]:
        """Equations in which it acts, the main one first."""
        return self.physics.equations

    @property
    def family(self) -> str:
        """Effects of one family can mimic errors in each other's form."""
        return self.physics.family

    @property
    def needs(self) -> tuple[str, ...]:
        """Ids of effects without which this one does nothing."""
        return self.physics.needs

    @cached_property
    def blocks(self) -> frozenset[str]:
        """Blocks of residuals in which it shows."""
        channel = self.physics.channel if isinstance(self.physics, Sensor) else ""
        return self.physics.balances or frozenset().union(*(blocks_of(one, channel) for one in self.equations))

    @property
    def lagged_channel(self) -> str:
        """Channel whose readings it low-passes; empty if none."""
        return self.physics.channel if isinstance(self.physics, SensorLag) else ""

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
        return self.physics.sentence(values)

    def adapted(self, bench: Bench) -> Effect:
        """The effect relative to this bench."""
        return replace(self, parameters=self.physics.fitted_parameters(bench))

    def acts_in(self, *hooks: str) -> bool:
        """Return whether the effect acts in any of these hooks."""
        own: Any = type(self)
        physical: Any = self.kind.effect
        return any(_acts_in(own, physical, hook) for hook in hooks)

    def _bound(self, values: Values, memory: Memory | None = None, **context: Any) -> Any:
        """The effect of the model at these values; `context`: fields of `EffectContext` that its terms read."""
        return self.kind.bound(values, **context)

    # -- hooks, in the order in which the model calls them ------------------------------------------------------------

    def correct(self, bench: Bench, values: Values) -> Bench:
        """The bench with a number corrected."""
        numbers = _Corrected(bench)
        self._bound(values).correct(numbers)
        return with_values(bench, **{name: one for name, one in vars(numbers).items() if name != "bench"})

    def write_into_bench(self, bench: Bench, values: Values) -> Bench:
        """Return the bench with this effect written into its numbers; exact if no earlier effect has its hooks."""
        if number := self.physics.scales:
            return with_values(bench, **{number: getattr(bench, number) * values["ratio"]})
        return self.correct(bench, values)

    def command(self, spool: FloatArray, substep: float, values: Values) -> FloatArray:
        """Spool position [A] from the command, shape (n, substeps); `substep` in s. The record starts at rest."""
        path = np.ascontiguousarray(spool).ravel()
        return np.asarray(self._bound(values, Memory(substep)).command(path)).reshape(spool.shape)

    def openings(self, edges: Pair, spool: FloatArray, time: FloatArray, values: Values) -> Pair:
        """Conductances [m3/s/sqrt(Pa)] of the edges that drive the piston out, and back.

        `spool` [A] and conductances have shape (..., substeps); `time` [s], since the recording began, shape (...).
        """
        bound = self._bound(values, step=0.0)
        bound.time = time[..., None] if np.ndim(time) else time
        out, back = bound.openings(*edges, spool)
        return np.asarray(out), np.asarray(back)

    def supply(self, supply: FloatArray, demand: FloatArray, memory: Memory, values: Values) -> FloatArray:
        """Supply pressure [Pa] under the `demand` [m3/s]."""
        return supply

    def leaks(self, flows: Pair, oil: Oil, bench: Bench, memory: Memory, values: Values) -> Pair:
        """Flow [m3/s] into chamber A and into chamber B."""
        bound = self._bound(
            values, memory, numbers=bench, position=oil.position, velocity=oil.velocity, pressures=oil.pressures,
            spool=substep_mean(oil.spool),
        )  # fmt: skip
        from_a, from_b = bound.leaks(*oil.pressures)
        return flows[0] - from_a, flows[1] - from_b

    def modulus(self, modulus: FloatArray, pressure: FloatArray, values: Values) -> FloatArray:
        """Bulk modulus [Pa] of a chamber at its pressure [Pa]."""
        return np.asarray(self._bound(values).modulus(modulus, pressure))

    def dry_level(self, level: FloatArray, motion: Kinematics, values: Values) -> FloatArray:
        """Level [N, >= 0] of dry friction while sliding; the model gives it the sign of the velocity."""
        return np.asarray(self._bound(values).dry_level(level, motion.velocity))

    def opposing_force(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                       values: Values) -> FloatArray:  # fmt: skip
        """Force [N] against the motion beyond viscous friction; `level` is the dry friction's level while sliding."""
        bound = self._bound(values, memory, pressures=motion.pressures or (0.0, 0.0))
        return np.asarray(force + bound.opposing_force(motion.position, motion.velocity))

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        """Force [N] of the load."""
        return np.asarray(
            self._bound(values, memory, numbers=bench, velocity=motion.velocity).load(force, motion.position)
        )

    def trace(self, motion: Kinematics, memory: Memory, values: Values) -> None:
        """Leave in a record's memory the states in which simulations begin at its samples, where hooks pass others."""

    def inertia(self, motion: Kinematics, bench: Bench, values: Values) -> FloatArray:
        """Return the mass [kg] moved with the load, for an acceleration not known yet; `load` adds its force."""
        return np.zeros_like(motion.position)

    def read_sensor(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        """Reading of a sensor for its true signal."""
        beside = {
            name: memory.other_signals.get(name, 0.0) for name in ("position", "velocity", "acceleration", "current")
        }
        pressures = tuple(memory.other_signals.get(f"pressure_{chamber}", 0.0) for chamber in "ab")
        bound = self._bound(values, memory, pressures=pressures, **beside)
        bound.held = beside["current"]
        return np.asarray(bound.read_sensor(channel, signal))

    def invert_reading(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        """True signal from a reading, as far as the sensor can be inverted."""
        return reading


@cache
def _acts_in(kind: Any, effect: Any, hook: str) -> bool:
    own = getattr(kind, hook) is not getattr(Effect, hook)
    return own or (hasattr(physics.Effect, hook) and effect.acts_in(hook))


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Size of the recorded machine, which bounds the parameters of its claims."""

    force: float
    """Largest recorded force [N]."""
    speed: float
    """Top speed [m/s]."""
    stroke: float
    """Distance [m]."""


def scale_bounds(effect: Effect, machine: Machine) -> Effect:
    """Return the effect with bounds wide enough for the machine, and never narrower than its own."""
    slow = 0.02 * machine.speed
    fading = 3.0**-0.5 * machine.speed  # of a rise towards standstill exp(-3), 5 %, are left at the top speed
    largest = {
        "N": 3.0 * machine.force, "N s/m": machine.force / slow * 3.0, "m/s": fading,
        "N/m": machine.force / (1e-3 * machine.stroke) * 3.0, "kg": machine.force * machine.stroke / slow**2 * 3.0,
    }  # fmt: skip
    parameters = []
    for one in effect.parameters:
        reach, low = largest.get(one.unit, 0.0), one.low  # 0 where the machine does not tell
        if one.unit in ("m/s", "N/m") and one.smallest == 0.0:
            low = min(low, 1e-3 * reach)
        elif low < 0.0 and one.neutral == 0.0 and low == -one.high:
            low = min(low, -reach)
        parameters.append(replace(one, low=low, high=max(one.high, reach)))
    return replace(effect, parameters=tuple(parameters))


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
    """Cache of at most `room` results, each for some claims; the least recently used is dropped."""

    def __init__(self, room: int) -> None:
        self._room, self._found = room, dict[tuple[object, ...], Any]()

    def get_or_compute(
        self, what: str, claims: Sequence[Claim], compute: Callable[[Sequence[Claim]], Result]
    ) -> Result:
        """Return a result for these claims, computed once as long as only others change."""
        key = (what, *claims_key(claims))
        found: Result = self._found.pop(key) if key in self._found else compute(claims)
        self._found[key] = found
        if len(self._found) > self._room:
            self._found.pop(next(iter(self._found)))
        return found


def claims_key(claims: Sequence[Claim]) -> tuple[tuple[Any, ...], ...]:
    """Return a key of claims and their values, for caches."""
    return tuple((claim.effect.label, *claim.values.values()) for claim in claims)


def acting(claims: Iterable[Claim], *hooks: str) -> list[Claim]:
    """The claims whose effects act in any of these hooks of `Effect`, in their order."""
    return [claim for claim in claims if claim.effect.acts_in(*hooks)]
