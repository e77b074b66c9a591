# SPDX-License-Identifier: Apache-2.0
"""Measurement x of a bench: sensors, then the box's differentiation; shared by all physical plants.

::

    truth    f_h  f_l  p_a  p_b  x_p                              READINGS, 5
      | noise, quantisation             (`add_sensor_errors`: the sensors)
      | differentiated, lightly filtered (`condition_readings`: the box)
    x        f_h  f_h'  f_l  f_l'  p_a  p_b  x_p  x_p'            PLANT_FIELDS, 8 (eq. state_def)

A rate is r_k = a r_{k-1} + (1 - a) (z_k - z_{k-1}) / T. At low frequency it lags by T/2 + T a/(1 - a): its *age*, the
setting. The velocity's is 1 ms because the force law cancels the velocity term with it (physics.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt

from hydro_core.bench_scales import BenchScales, rescale
from hydro_core.settings import check, quantity
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.jit import njit
from hydro_sim.model.bench import NOMINAL
from hydro_sim.model.equations import READINGS

SENSORS_DTYPE = np.dtype(
    [("force_noise", np.float64), ("pressure_noise", np.float64), ("position_step", np.float64)]
    + [("force_memory", np.float64), ("velocity_memory", np.float64)]
)
CONDITIONING_DTYPE = np.dtype([("force_h", np.float64), ("force_l", np.float64), ("position", np.float64)])
"""Last readings that were differentiated; their rates are part of the measurement."""
READING_MAX = 1e9
"""Magnitude from which a reading is invalid, as NaN is: no sensor gives it."""


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Sensor noise (standard deviation per 1 kHz sample) and the box's differentiators."""

    force_noise: Annotated[float, quantity("N", 0.0, 1e5)] = NOMINAL.force / 500.0
    """Standard deviation, both load cells."""
    pressure_noise: Annotated[float, quantity("Pa", 0.0, 1e7)] = NOMINAL.pressure * 3.0 / 8000.0
    """Standard deviation."""
    position_step: Annotated[float, quantity("m", 0.0, 1e-1)] = NOMINAL.length / 80000.0
    """The encoder's step; 0: not quantised."""
    force_rate_age: Annotated[float, quantity("s", 0.0005, 0.02)] = 2e-3
    """Age of the force's rate."""
    velocity_age: Annotated[float, quantity("s", 0.0005, 0.02)] = 1e-3
    """Age of the velocity."""

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def of_size(cls, size: BenchScales) -> Sensors:
        """Return the default sensors, scaled to a bench of this size."""
        return rescale(cls(), NOMINAL, size)

    def constants(self, scale: float = 1.0) -> npt.NDArray[np.void]:
        """Return the record for compiled code, `SENSORS_DTYPE`, shape (1,); noise and step times `scale` (0: ideal)."""
        ages = self.force_rate_age / SAMPLE_PERIOD, self.velocity_age / SAMPLE_PERIOD
        memories = ((age - 0.5) / (age + 0.5) for age in ages)
        noises = scale * self.force_noise, scale * self.pressure_noise, scale * self.position_step
        return np.array([(*noises, *memories)], SENSORS_DTYPE)


class Noise:
    """Standard normal numbers for the sensors: one row of 5 per sample, independent of how many are drawn at a time."""

    BLOCK_SAMPLES = 1000

    def __init__(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)
        self._coming: FloatArray = np.empty((0, len(READINGS)))

    def row(self) -> FloatArray:
        """Return the next sample's standard normal numbers, shape (5,)."""
        return self.rows(1)[0]

    def rows(self, count: int) -> FloatArray:
        """Return the standard normal numbers of the next `count` samples, shape (count, 5)."""
        if (missing := count - len(self._coming)) > 0:
            drawn = self._generator.standard_normal((max(missing, self.BLOCK_SAMPLES), len(READINGS)))
            self._coming = np.concatenate((self._coming, drawn))
        rows, self._coming = self._coming[:count], self._coming[count:]
        return rows


@njit
def add_sensor_errors(sensors, noise, raw):
    """Add noise and quantisation to true values `raw`, shape (5,), in place; `noise`: standard normal, shape (5,)."""
    raw[0] += sensors.force_noise * noise[0]
    raw[1] += sensors.force_noise * noise[1]
    raw[2] += sensors.pressure_noise * noise[2]
    raw[3] += sensors.pressure_noise * noise[3]
    if sensors.position_step > 0.0:
        raw[4] = np.rint(raw[4] / sensors.position_step) * sensors.position_step


@njit
def reset_conditioning(last, raw, measurement):
    """Initialise the sensor conditioning in place: readings `raw`, shape (5,) [N, N, Pa, Pa, m], with zero rates.

    `last`: record of `CONDITIONING_DTYPE`, in which invalid readings count as 0. `measurement`: x, shape (8,).
    """
    last.force_h = raw[0] if abs(raw[0]) < READING_MAX else 0.0
    last.force_l = raw[1] if abs(raw[1]) < READING_MAX else 0.0
    last.position = raw[4] if abs(raw[4]) < READING_MAX else 0.0
    measurement[1], measurement[3], measurement[7] = 0.0, 0.0, 0.0
    _show(raw, measurement)


@njit
def condition_readings(sensors, last, raw, measurement):
    """Condition one sample: readings `raw`, shape (5,), into `measurement`, shape (8,), with filtered rates.

    An invalid reading (NaN, or from `READING_MAX` on) leaves its rate as it was; the next difference is to the last
    valid one.
    """
    force, velocity = sensors.force_memory, sensors.velocity_memory
    if abs(raw[0]) < READING_MAX:
        measurement[1] = force * measurement[1] + (1.0 - force) * (raw[0] - last.force_h) / SAMPLE_PERIOD
        last.force_h = raw[0]
    if abs(raw[1]) < READING_MAX:
        measurement[3] = force * measurement[3] + (1.0 - force) * (raw[1] - last.force_l) / SAMPLE_PERIOD
        last.force_l = raw[1]
    if abs(raw[4]) < READING_MAX:
        measurement[7] = velocity * measurement[7] + (1.0 - velocity) * (raw[4] - last.position) / SAMPLE_PERIOD
        last.position = raw[4]
    _show(raw, measurement)


@njit
def _show(raw, measurement):
    measurement[0], measurement[2] = raw[0], raw[1]
    measurement[4], measurement[5], measurement[6] = raw[2], raw[3], raw[4]
