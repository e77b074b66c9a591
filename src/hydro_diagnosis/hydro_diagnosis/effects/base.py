# SPDX-License-Identifier: Apache-2.0
"""Candidate causes: effects of the bench model (`hydro_sim.model.effects`) with bounds and start values of their fit.

The equations are the model's own: a hook binds an effect to parameter values and recorded signals, and calls the term
of the same name on arrays over time. Where the effect does not act, a hook returns its input unchanged. Elements with
memory use `Memory`, which filters a whole record (`effects.dynamics`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import base as physics
from hydro_sim.model.effects.base import FitParameter as FitParameter
from hydro_sim.model.effects.base import display_unit as display_unit
from hydro_sim.model.effects.catalogue import Kind
from hydro_sim.model.effects.sensing import Sensor, SensorLag

if TYPE_CHECKING:
    from hydro_diagnosis.effects.memory import Memory

FloatArray = npt.NDArray[np.float64]
Pair = tuple[FloatArray, FloatArray]
"""Values of chambers A and B."""
EdgesOfLine = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Edges at a line's end: conductance [m3/s/sqrt(Pa)] of one and pressure [Pa] behind it, then of the other."""
ParameterValues = Mapping[str, float]
Result = TypeVar("Result")
PRESSURE, MOTION, LOAD, HYDRAULIC = "pressure", "motion", "load", "hydraulic"
"""Blocks of residuals; a change of an effect's parameters recomputes only the blocks in which it acts."""
BLOCKS = {PRESSURE: ("pressure_a", "pressure_b"), MOTION: ("motion",), LOAD: ("load",), HYDRAULIC: ("hydraulic",)}
"""Channels of residuals in each block."""
CHANNELS = tuple(channel for channels in BLOCKS.values() for channel in channels)
"""Channels of residuals, in the order of a problem's residual vector."""
SLOPE_STEP = 6e-5
"""Step of the finite differences by a pressure, over the supply's."""
_EQUATION_BLOCKS = {"motion": {MOTION}, "load": {MOTION, LOAD}}
_CHANNEL_BLOCKS = {
    "hydraulic_force": {MOTION, HYDRAULIC}, "load_force": {LOAD}, "pressure_a": {PRESSURE, HYDRAULIC},
    "pressure_b": {PRESSURE, HYDRAULIC}, "piston_position": {PRESSURE, MOTION, LOAD},
}  # fmt: skip
"""Blocks of residuals that depend on a sensor, by its channel."""


def substep_mean(signal: FloatArray) -> FloatArray:
    """Return the mean of a signal over the substeps of each sample: from shape (..., substeps) to (...)."""
    first, *others = np.moveaxis(signal, -1, 0)
    return np.asarray(sum(others, first) / signal.shape[-1])


def blocks_of(equation: str, channel: str = "") -> frozenset[str]:
    """Return the blocks of residuals that depend on a term of an equation, or on an error of a channel's sensor."""
    return frozenset(_CHANNEL_BLOCKS[channel] if equation == "sensor" else _EQUATION_BLOCKS.get(equation, {PRESSURE}))


def with_values(bench: Bench, **values: float | None) -> Bench:
    """Return a bench with values replaced, clipped to the ranges of `Bench`, the tank pressure below the supply's."""
    limits = bench.quantities()
    inside: dict[str, Any] = {
        name: value if value is None else min(max(value, limits[name].low), limits[name].high)
        for name, value in values.items()
    }
    supply = inside.get("supply_pressure", bench.supply_pressure)
    tank = min(inside.get("tank_pressure", bench.tank_pressure), 0.99 * supply)
    return replace(bench, **{**inside, "tank_pressure": tank})


@dataclass(frozen=True)
class ChamberInputs:
    """Inputs of the chamber equations at one instant or over one sample."""

    time: FloatArray
    position: FloatArray
    pressures: Pair
    spool: FloatArray
    """Spool position as a current [A], shape (..., substeps)."""
    velocity: FloatArray
    """Piston velocity [m/s]."""


@dataclass
class Kinematics:
    """Arguments of the force terms: piston motion and chamber pressures, SI units."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    pressures: Pair | None = None
    """Pressures [Pa] of chambers A and B; None if unknown."""
    acceleration: FloatArray | None = None
    """Piston acceleration [m/s2]; None if unknown."""


class _Corrected:
    """Parameters of a bench, overridden by those that a correction sets."""

    def __init__(self, bench: Bench) -> None:
        self.__dict__["bench"] = bench

    def __getattr__(self, name: str) -> Any:
        return getattr(self.bench, name)


@dataclass(frozen=True)
class Effect:
    """Candidate cause: an effect that the baseline leaves out. Effects with memory override the hooks they act in."""

    kind: Kind
    """Effect of the model, with its options."""
    parameters: tuple[FitParameter, ...] = ()
    """Fitted parameters, relative to the bench to which the effect is adapted."""
    estimated: bool = False
    """Whether it represents an estimated bench parameter (`estimation.unknown_parameters`): in every fit, no cause."""

    named: ClassVar[bool] = True
    """Whether the effect is in the table of causes; others are candidates that are never claimed."""
    stage: ClassVar[int] = 1
    """Order in the command path: 0 before the spool, 1 spool dynamics, 2 functions of its position (overlap)."""
    other_forms: ClassVar[tuple[Effect, ...]] = ()
    """Other forms of the same cause and parameters, never claimed; intervals also span those that fit as well."""
    models_presliding: ClassVar[bool] = False
    """Whether it models dry friction elastically (presliding): the model then adds no dry friction and no stiction."""
    depends_on_acceleration: ClassVar[bool] = False
    """Whether its term depends on the piston's acceleration."""
    is_position_error: ClassVar[bool] = False
    """Whether it is an error of the position sensor: the recorded position differs from the piston's."""
    nonlinear_channel: ClassVar[str] = ""
    """Channel whose reading is a nonlinear function of its signal by this effect; empty if none."""

    @cached_property
    def physics(self) -> physics.Effect:
        """Effect of the bench model; parameter values are bound to it in each hook."""
        return self.kind.make()

    @property
    def id(self) -> str:
        """Identifier of the effect in the table of causes."""
        return self.kind.effect.id

    @cached_property
    def options(self) -> dict[str, str]:
        """Options of the effect by key: chamber, sensor or form."""
        return dict(self.kind.chosen)

    @property
    def equations(self) -> tuple[str, ...]:
        """Equations in which it acts, the main one first."""
        return self.physics.equations

    @property
    def family(self) -> str:
        """Family of effects that can mimic form errors of one another."""
        return self.physics.family

    @property
    def needs(self) -> tuple[str, ...]:
        """Ids of effects without which this one does nothing."""
        return self.physics.needs

    @cached_property
    def blocks(self) -> frozenset[str]:
        """Blocks of residuals that depend on it."""
        return self.physics.balances or frozenset().union(
            *(blocks_of(one, self.sensor_channel) for one in self.equations)
        )

    @property
    def sensor_channel(self) -> str:
        """Channel of the sensor whose error it is; empty if it is no sensor's."""
        return self.physics.channel if isinstance(self.physics, Sensor) else ""

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
        """Amplitude parameters: those with a smallest size worth claiming; the others are `shapes`."""
        return tuple(one for one in self.parameters if one.smallest_reported > 0.0)

    @property
    def shapes(self) -> tuple[FitParameter, ...]:
        """Shape parameters, such as velocities, time constants and thresholds."""
        return tuple(one for one in self.parameters if one.smallest_reported == 0.0)

    def sentence(self, values: ParameterValues) -> str:
        """Return a description of the effect at parameter values, for a person at the bench."""
        return self.physics.sentence(values)

    def adapted(self, bench: Bench) -> Effect:
        """Return the effect with its fitted parameters relative to a bench."""
        return replace(self, parameters=self.physics.fitted_parameters(bench))

    def acts_in(self, *hooks: str) -> bool:
        """Return whether the effect acts in any of these hooks."""
        own: Any = type(self)
        physical: Any = self.kind.effect
        return any(_acts_in(own, physical, hook) for hook in hooks)

    def _bound(self, values: ParameterValues, memory: Memory | None = None, **context: Any) -> Any:
        """The effect of the model at these values; `context`: fields of `EffectContext` that its terms read."""
        return self.kind.bind(values, **context)

    # -- hooks, in the order in which the model calls them ------------------------------------------------------------

    def correct(self, bench: Bench, values: ParameterValues) -> Bench:
        """Return the bench with the parameters that the effect corrects."""
        numbers = _Corrected(bench)
        self._bound(values).correct(numbers)
        return with_values(bench, **{name: one for name, one in vars(numbers).items() if name != "bench"})

    def write_into_bench(self, bench: Bench, values: ParameterValues) -> Bench:
        """Return the bench with the effect merged into its parameters; exact if no earlier effect has its hooks."""
        if number := self.physics.equivalent_parameter:
            return with_values(bench, **{number: getattr(bench, number) * values["ratio"]})
        return self.correct(bench, values)

    def command(self, spool: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        """Spool position [A] from the command, shape (n, substeps); `memory`: of the substeps, in steady state."""
        path = np.ascontiguousarray(spool).ravel()
        return np.asarray(self._bound(values, memory).command(path)).reshape(spool.shape)

    def underlap(self, width: float, values: ParameterValues) -> float:
        """Width [A] by which all four edges are open at null."""
        return float(self._bound(values).underlap(width))

    def land(self, width: float, values: ParameterValues) -> tuple[float, float]:
        """Width [A] by which its edge is open at null, from that of all, and its share of the flow [-]."""
        own, share = self._bound(values).land(width)
        return float(own), float(share)

    def openings(self, edges: Pair, spool: FloatArray, time: FloatArray, values: ParameterValues) -> Pair:
        """Conductances [m3/s/sqrt(Pa)] of the edges that extend the piston, and of those that retract it.

        `spool` [A] and conductances have shape (..., substeps); `time` [s], since the recording began, shape (...).
        """
        bound = self._bound(values, step=0.0)
        bound.time = time[..., None] if np.ndim(time) else time
        out, back = bound.openings(*edges, spool)
        return np.asarray(out), np.asarray(back)

    def supply(self, supply: FloatArray, edges: EdgesOfLine, bench: Bench, memory: Memory,
               values: ParameterValues) -> FloatArray:  # fmt: skip
        """Supply pressure [Pa] at the valve, from that of the source."""
        return supply

    def tank(self, tank: FloatArray, edges: EdgesOfLine, bench: Bench, memory: Memory,
             values: ParameterValues) -> FloatArray:  # fmt: skip
        """Pressure [Pa] behind the valve's tank edges, from the tank's."""
        return tank

    def leaks(self, flows: Pair, oil: ChamberInputs, bench: Bench, memory: Memory, values: ParameterValues) -> Pair:
        """Flows [m3/s] into chambers A and B, less the effect's leakage."""
        bound = self._bound(
            values, memory, bench=bench, position=oil.position, velocity=oil.velocity, pressures=oil.pressures,
            spool=substep_mean(oil.spool),
        )  # fmt: skip
        from_a, from_b = bound.leaks(*oil.pressures)
        return flows[0] - from_a, flows[1] - from_b

    def modulus(
        self, modulus: FloatArray, pressure: FloatArray, values: ParameterValues, time: FloatArray | float = 0.0
    ) -> FloatArray:
        """Bulk modulus [Pa] of a chamber at its pressure [Pa], `time` [s] after the recording began."""
        bound = self._bound(values, step=0.0)
        bound.time = time
        return np.asarray(bound.modulus(modulus, pressure))

    def dry_level(self, level: FloatArray, motion: Kinematics, values: ParameterValues) -> FloatArray:
        """Magnitude [N, >= 0] of dry friction while sliding; the model applies the sign of the velocity."""
        return np.asarray(self._bound(values).dry_level(level, motion.velocity))

    def opposing_force(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                       values: ParameterValues) -> FloatArray:  # fmt: skip
        """Force [N] against the motion beyond viscous friction; `level`: magnitude of sliding dry friction [N]."""
        bound = self._bound(values, memory, pressures=motion.pressures or (0.0, 0.0))
        return np.asarray(force + bound.opposing_force(motion.position, motion.velocity))

    def load(
        self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: ParameterValues
    ) -> FloatArray:
        """Force [N] of the load on the piston."""
        return np.asarray(
            self._bound(values, memory, bench=bench, velocity=motion.velocity).load(force, motion.position)
        )

    def read_sensor(self, channel: str, signal: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        """Reading of a sensor for its true signal."""
        beside = {
            name: memory.other_signals.get(name, 0.0) for name in ("position", "velocity", "acceleration", "current")
        }
        pressures = tuple(memory.other_signals.get(f"pressure_{chamber}", 0.0) for chamber in "ab")
        bound = self._bound(values, memory, pressures=pressures, **beside)
        bound.held = beside["current"]
        return np.asarray(bound.read_sensor(channel, signal))

    def invert_reading(self, channel: str, reading: FloatArray, memory: Memory, values: ParameterValues) -> FloatArray:
        """True signal from a reading, as far as the sensor can be inverted."""
        return reading


@cache
def _acts_in(kind: Any, effect: Any, hook: str) -> bool:
    own = getattr(kind, hook) is not getattr(Effect, hook)
    return own or (hasattr(physics.Effect, hook) and effect.acts_in(hook))


@dataclass(frozen=True, kw_only=True)
class MachineScales:
    """Scales of the recorded force and motion, from which bounds of the causes' parameters follow."""

    force: float
    """Largest recorded force [N]."""
    speed: float
    """Top speed [m/s]."""
    stroke: float
    """Range [m] of the piston's position."""


def scale_bounds(effect: Effect, machine: MachineScales) -> Effect:
    """Return the effect with its parameters' bounds widened to the machine's scales, those of speeds set to them."""
    slow = 0.02 * machine.speed
    fading = 3.0**-0.5 * machine.speed  # of a rise towards standstill exp(-3), 5 %, are left at the top speed
    largest = {
        "N": 3.0 * machine.force, "N s/m": machine.force / slow * 3.0, "m/s": fading,
        "N/m": machine.force / (1e-3 * machine.stroke) * 3.0, "kg": machine.force * machine.stroke / slow**2 * 3.0,
    }  # fmt: skip
    parameters = []
    for one in effect.parameters:
        reach, low = largest.get(one.unit, 0.0), one.low  # 0 where there is no scale
        if one.unit == "m/s" and one.smallest_reported == 0.0:  # a slower fading cannot be told from dry friction
            starts = tuple(min(start, 0.5 * reach) for start in one.start_values)
            parameters.append(replace(one, low=min(low, 1e-3 * reach), high=reach, start_values=starts))
            continue
        if one.unit == "N/m" and one.smallest_reported == 0.0:
            low = min(low, 1e-3 * reach)
        elif low < 0.0 and one.neutral == 0.0 and low == -one.high:
            low = min(low, -reach)
        parameters.append(replace(one, low=low, high=max(one.high, reach)))
    return replace(effect, parameters=tuple(parameters))


@dataclass(frozen=True)
class EffectHypothesis:
    """An effect with parameter values, as a hypothesis of what acts on the bench beside its nominal equations."""

    effect: Effect
    values: ParameterValues

    @property
    def acts(self) -> bool:
        """Whether it has any influence: an unnamed term with all amplitudes 0 has none."""
        sizes = [self.values[one.name] for one in self.effect.amplitudes]
        return self.effect.named or any(sizes) or not sizes

    def to_mapping(self) -> dict[str, Any]:
        """Return the entry of corrected.yaml."""
        return {"id": self.effect.id, **self.effect.options, "parameters": dict(self.values)}


class BoundedCache:
    """Least-recently-used cache of at most `capacity` results, each of a quantity under some claims."""

    def __init__(self, capacity: int) -> None:
        self._capacity, self._found = capacity, dict[tuple[object, ...], Any]()

    def get_or_compute(
        self, what: str, claims: Sequence[EffectHypothesis], compute: Callable[[Sequence[EffectHypothesis]], Result]
    ) -> Result:
        """Return the cached result of quantity `what` under these claims and values, or compute it."""
        key = (what, *claims_key(claims))
        found: Result = self._found.pop(key) if key in self._found else compute(claims)
        self._found[key] = found
        if len(self._found) > self._capacity:
            self._found.pop(next(iter(self._found)))
        return found


def claims_key(claims: Sequence[EffectHypothesis]) -> tuple[tuple[Any, ...], ...]:
    """Return a cache key of claims: labels and parameter values."""
    return tuple((claim.effect.label, *claim.values.values()) for claim in claims)


def claims_acting_in(claims: Iterable[EffectHypothesis], *hooks: str) -> list[EffectHypothesis]:
    """Return the claims whose effects act in any of these hooks of `Effect`, in the given order."""
    return [claim for claim in claims if claim.effect.acts_in(*hooks)]
