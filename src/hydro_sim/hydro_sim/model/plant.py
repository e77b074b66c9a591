# SPDX-License-Identifier: Apache-2.0
"""Plants with a step of one millisecond: the interface, and the analytic plant.

Order of a sample: the box reads x_k, decides u_k, and the plant holds u_k until x_{k+1}. A plant gives the finished
measurement x of eq. state_def: a physical plant runs its five readings through `model.sensors` as the box does, a
learned model predicts all eight at once.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from hydro_core.signals import FloatArray
from hydro_sim.jit import njit
from hydro_sim.model import machine_code, sensors
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.sensors import CONDITIONING_DTYPE, Noise, Sensors


class Plant(Protocol):
    """Interface of a plant with a step of one box sample, 1 ms."""

    def reset(self, seed: int) -> FloatArray:
        """Reset with noise from `seed`; return the measurement x, shape (8,), of a bench at rest."""

    def step(self, valve_current: float) -> FloatArray:
        """Hold the valve current [A] for one sample; return the measurement x after it, shape (8,)."""


STATES_MAX, COEFFICIENTS_MAX = 128, 320
"""Capacity of a record: more than `effects.catalogue.EFFECTS_MAX` effects need."""
MODEL_DTYPE = np.dtype([("address", np.int64), ("k", np.float64, (COEFFICIENTS_MAX,))])
"""A model for compiled code: address of its `bench_sample` in this process, and its coefficients."""
PLANT_STATE_DTYPE = np.dtype([("y", np.float64, (STATES_MAX,)), ("x", np.float64, (8,)), ("last", CONDITIONING_DTYPE)])
"""State of an analytic plant: the model's state y, measurement x, the differentiators' last samples."""


class AnalyticPlant:
    """The bench's model (`hydro_sim.model.bench_model`) behind the sensors of `hydro_sim.model.sensors`.

    `bench`: simulated bench, with its effects. `noise`: scale of the sensors' noise and quantisation, 0 or more;
    0: ideal sensors. `settings`: the sensors at scale 1.
    """

    def __init__(self, bench: Bench, *, noise: float = 1.0, settings: Sensors | None = None) -> None:
        self.model = BenchModel(bench)
        self.constants = np.zeros(1, MODEL_DTYPE)
        self.constants["address"] = self.model.address_of("bench_sample")
        self.sensors = (settings or Sensors()).constants(noise)
        self.state = np.zeros(1, PLANT_STATE_DTYPE)
        self.noise = Noise(0)
        self.reset(0)

    def reset(self, seed: int) -> FloatArray:
        """See `Plant.reset`."""
        self.noise = Noise(seed)
        k, y, readings = self.model.begin(self.model.values)
        self.constants["k"][0, : len(k)], self.state["y"][0, : len(y)] = k, y
        begin(self.sensors, self.state, self.noise.row(), readings)
        return self.measurement()

    def step(self, valve_current: float) -> FloatArray:
        """See `Plant.step`."""
        advance(self.constants, self.sensors, self.state, self.noise.row(), valve_current)
        return self.measurement()

    def measurement(self) -> FloatArray:
        """Return a copy of the present measurement x, shape (8,)."""
        return self.state["x"][0].copy()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore in another process, where the model has another address."""
        vars(self).update(state)
        self.constants["address"] = self.model.address_of("bench_sample")


@njit
def begin(sensor_constants, state, noise, readings):
    """Initialise the state; `sensor_constants`, `state`: shape (1,), `noise`, true `readings`: shape (5,)."""
    sensors.add_sensor_errors(sensor_constants[0], noise, readings)
    sensors.reset_conditioning(state[0].last, readings, state[0].x)


@njit
def advance(constants, sensor_constants, state, noise, valve_current):
    """Advance by a sample of 1 ms in place; `constants` as `MODEL_DTYPE`, shapes as in `begin`; for all simulations."""
    raw = np.empty(5)
    machine_code.sample(constants[0].address, constants[0].k, state[0].y, valve_current, raw)
    sensors.add_sensor_errors(sensor_constants[0], noise, raw)
    sensors.condition_readings(sensor_constants[0], state[0].last, raw, state[0].x)
