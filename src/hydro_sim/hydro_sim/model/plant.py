# SPDX-License-Identifier: Apache-2.0
"""A bench to step by the millisecond: the interface, and the analytic plant behind it.

Order of a sample: the box reads x_k, decides u_k, and the plant holds u_k until x_{k+1}. A plant gives the finished
measurement x of eq. state_def: a physical plant runs its five readings through `model.sensors` as the box does, a
learned model predicts all eight at once.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numba import njit

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.model import hydraulics, sensors
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import integration, sensing
from hydro_sim.model.effects.record import MEMORY_DTYPE
from hydro_sim.model.sensors import CONDITIONING_DTYPE, Noise, Sensors


class Plant(Protocol):
    """One box sample of 1 ms at a time."""

    def reset(self, seed: int) -> FloatArray:
        """Begin anew with noise from `seed`; returns the measurement x, shape (8,), of a still bench."""

    def step(self, valve_current: float) -> FloatArray:
        """Hold the valve current [A] for one sample; returns the measurement x after it, shape (8,)."""


PLANT_STATE_DTYPE = np.dtype(
    [("y", np.float64, (hydraulics.STATES,)), ("x", np.float64, (8,)), ("last", CONDITIONING_DTYPE)]
    + [("memory", MEMORY_DTYPE)]
)
"""All that an analytic plant remembers: physical state y, measurement x, the differentiators' last samples, effects."""


class AnalyticPlant:
    """The equations of `hydro_sim.model.hydraulics` behind the sensors of `hydro_sim.model.sensors`.

    Parameters
    ----------
    bench
        What is simulated, its `effects` with it.
    noise
        Scale of the sensors' noise and quantisation, 0 or more; 0: ideal sensors.
    settings
        The sensors at scale 1.
    """

    def __init__(self, bench: Bench, *, noise: float = 1.0, settings: Sensors | None = None) -> None:
        if not 0.0 <= noise < np.inf:
            raise ValueError(f"noise scale {noise!r} is not a number of 0 or more")
        self.constants = bench.constants()
        self.sensors = (settings or Sensors()).constants(noise)
        self.state = np.zeros(1, PLANT_STATE_DTYPE)
        self.noise = Noise(0)
        self.reset(0)

    def reset(self, seed: int) -> FloatArray:
        """See `Plant.reset`."""
        self.noise = Noise(seed)
        self.state["y"] = hydraulics.rest_state(self.constants[0])
        begin(self.constants, self.sensors, self.state, self.noise.row())
        return self.measurement()

    def step(self, valve_current: float) -> FloatArray:
        """See `Plant.step`."""
        advance(self.constants, self.sensors, self.state, self.noise.row(), valve_current)
        return self.measurement()

    def measurement(self) -> FloatArray:
        """The present measurement x, shape (8,), a copy."""
        return self.state["x"][0].copy()

    def physical_state(self) -> FloatArray:
        """The present y of `hydro_sim.model.hydraulics`, shape (6,), a copy: the truth behind the sensors."""
        return self.state["y"][0].copy()


@njit(cache=True)
def begin(constants, sensor_constants, state, noise):
    """First sample: `constants`, `sensor_constants`, `state` of shape (1,), `noise` of shape (5,)."""
    bench, raw = constants[0], np.empty(5)
    integration.read(bench, state[0].y, raw)
    if bench.effects.active:
        integration.begin(bench, state[0].memory, state[0].y, raw)
    sensors.sense(sensor_constants[0], noise, raw)
    sensors.restart(state[0].last, raw, state[0].x)


@njit(cache=True)
def advance(constants, sensor_constants, state, noise, valve_current):
    """One sample of 1 ms in place; shapes as in `begin`. What `AnalyticPlant.step` and the offline loop both run."""
    bench, raw = constants[0], np.empty(5)
    if bench.effects.active:
        integration.advance(bench, state[0].memory, state[0].y, valve_current)
    else:
        hydraulics.advance(bench, state[0].y, valve_current, SAMPLE_PERIOD, hydraulics.SUBSTEPS)
    integration.read(bench, state[0].y, raw)
    if bench.effects.active:
        sensing.show(bench.effects, state[0].memory, raw)
    sensors.sense(sensor_constants[0], noise, raw)
    sensors.condition(sensor_constants[0], state[0].last, raw, state[0].x)
