# SPDX-License-Identifier: Apache-2.0
"""Randomisation of an episode: reference, bench and noise seed, as functions of the episode's number and a seed.

Randomised are the bench's parameters that vary from day to day (spring, supply pressure), uncertain ones (oil, valve,
friction, mass), sensor noise and transport delays. The bench assumed by the box stays the configured one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hydro_core.settings import check, quantity
from hydro_core.signals import FloatArray, ReferenceSignal, Waveform
from hydro_policy.task.mdp.settings import TaskSettings
from hydro_sim.model.bench import NOMINAL, Bench

if TYPE_CHECKING:
    from hydro_sim.model.plant import AnalyticPlant

NOISE_STREAM, BENCH_STREAM, EXAM_STREAM, KNOWN_STREAM = 1, 2, 3, 4
"""Random streams of one episode: seed of its noise, its bench, the bench of that number in an examination, choice
between known and drawn bench."""

_R2: FloatArray = np.array((0.7548776662466927, 0.5698402909980532))  # 1 / p, 1 / p^2 with p^3 = p + 1


def reference(task: TaskSettings, episode: int, seed: int) -> ReferenceSignal:
    """Return the sine of an episode: amplitude and frequency spread evenly over their ranges, from a random start.

    Independent draws leave corners of the ranges unvisited for dozens of episodes; this sequence (Roberts' R2, from the
    plastic number) is also uniform, and any eight consecutive episodes cover the plane.
    """
    start = np.random.default_rng(seed).random(2)
    amplitude, frequency = (start + episode * _R2) % 1.0
    return ReferenceSignal(
        waveform=Waveform.SINE,
        amplitude=task.amplitude_min + float(amplitude) * (task.amplitude_max - task.amplitude_min),
        frequency=task.frequency_min + float(frequency) * (task.frequency_max - task.frequency_min),
    )


def stream_seed(seed: int, episode: int, stream: int) -> int:
    """Return the seed of one random stream of an episode, from the run's seed."""
    return int(np.random.default_rng((seed, episode, stream)).integers(2**62))


AMPLITUDE_SHARE_MAX = 0.8
"""Largest amplitude of a reference, relative to the spring's force at half of the stroke."""

_CHANGE_MAX = {
    "bulk_modulus": 0.2, "moving_mass": 0.2, "viscous_friction": 0.5, "friction_coulomb": 0.5, "friction_stribeck": 0.5,
    "leakage_internal": 0.5, "load_cell_frequency": 0.2, "spool_frequency": 0.2, "valve_gain": 0.15,
}  # fmt: skip
"""Largest relative change at `spread` 1; valve gains change together."""

_EFFECT_PARAMETER_CHANGES = {
    "friction_coulomb.force": "friction_coulomb", "friction_stribeck.breakaway_force": "friction_stribeck",
    "leakage_internal.coefficient": "leakage_internal", "valve_lag.bandwidth": "spool_frequency",
    "sensor_lag.bandwidth": "load_cell_frequency",
}  # fmt: skip
"""Change that applies to each parameter of a bench file's effects; the others keep the file's values."""


@dataclass(frozen=True, kw_only=True)
class Randomisation:
    """Domain randomisation: ranges of each episode's bench, uniform distributions (spring: log-uniform)."""

    known_share: Annotated[float, quantity("-", 0.0, 1.0)] = 0.125
    """Share of the episodes that run on the bench as it is known."""
    spring_min: Annotated[float, quantity("N/m", 1.0, 1e8)] = NOMINAL.force / NOMINAL.length * 4.0 / 3.0
    """Smallest spring stiffness."""
    spring_max: Annotated[float, quantity("N/m", 1.0, 1e8)] = NOMINAL.force / NOMINAL.length * 44.0 / 3.0
    """Largest spring stiffness."""
    supply_min: Annotated[float, quantity("Pa", 1e5, 1e8)] = NOMINAL.pressure * 0.59375
    """Lowest supply pressure."""
    supply_max: Annotated[float, quantity("Pa", 1e5, 1e8)] = NOMINAL.pressure * 1.0625
    """Highest supply pressure, above the nominal one, for policies are worst at the edge of what they were trained
    on.
    """
    spread: Annotated[float, quantity("-", 0.0, 1.5)] = 0.5
    """Scale of the changes of what is known badly; 1: oil 20 %, mass 20 %, friction 50 %, valve 15 % ..."""
    noise_min: Annotated[float, quantity("-", 0.0, 10.0)] = 0.5
    """Smallest scale of the sensors' noise."""
    noise_max: Annotated[float, quantity("-", 0.0, 10.0)] = 2.0
    """Largest scale of the sensors' noise."""
    gain_delay_max: Annotated[int, quantity("-", 1, 10)] = 2
    """Samples until gains act, from 1 on."""
    dead_time_max: Annotated[int, quantity("-", 0, 8)] = 1
    """Samples between the box and the valve, from 0 on."""

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, kw_only=True)
class RandomisedBench:
    """Randomised bench of an episode: plant, and transport delays [samples]."""

    plant: AnalyticPlant
    spring: float
    """Spring stiffness [N/m]."""
    gain_delay: int
    dead_time: int
    stroke: float
    """Stroke of the piston [m]."""

    def limit_amplitude(self, reference: ReferenceSignal) -> ReferenceSignal:
        """Return the reference with at most `AMPLITUDE_SHARE_MAX` times the spring's force at half of the stroke."""
        return replace(
            reference, amplitude=min(reference.amplitude, AMPLITUDE_SHARE_MAX * 0.5 * self.stroke * self.spring)
        )


def draw_bench(settings: Randomisation, source: Bench, seed: int) -> RandomisedBench:
    """Draw a bench with parameters randomised around those of `source`."""
    from hydro_sim.model.plant import AnalyticPlant  # numba: not needed to draw a reference
    from hydro_sim.model.sensors import Sensors

    rng = np.random.default_rng(seed)
    spring = math.exp(rng.uniform(math.log(settings.spring_min), math.log(settings.spring_max)))
    supply = rng.uniform(settings.supply_min, settings.supply_max)
    factors = {name: 1.0 + settings.spread * reach * rng.uniform(-1.0, 1.0) for name, reach in _CHANGE_MAX.items()}
    noise = rng.uniform(settings.noise_min, settings.noise_max)
    delays = int(rng.integers(1, settings.gain_delay_max + 1)), int(rng.integers(0, settings.dead_time_max + 1))
    bandwidth, effects = source.load_cell_bandwidth, []
    for effect in source.effects:
        parameters = {
            name: float(value) * factors.get(_EFFECT_PARAMETER_CHANGES.get(f"{effect['id']}.{name}", ""), 1.0)
            for name, value in effect["parameters"].items()
        }
        effects.append({**effect, "parameters": parameters})
    drawn = replace(
        source,
        spring_stiffness=spring,
        supply_pressure=supply,
        bulk_modulus=source.bulk_modulus * factors["bulk_modulus"],
        moving_mass=source.moving_mass * factors["moving_mass"],
        viscous_friction=source.viscous_friction * factors["viscous_friction"],
        valve_nominal_flow=source.valve_nominal_flow * factors["valve_gain"],
        load_cell_bandwidth=bandwidth and bandwidth * factors["load_cell_frequency"],
        effects=tuple(effects),
    )
    plant = AnalyticPlant(drawn, noise=noise, settings=Sensors.of_size(source.size))
    return RandomisedBench(plant=plant, spring=spring, gain_delay=delays[0], dead_time=delays[1], stroke=source.stroke)
