# SPDX-License-Identifier: Apache-2.0
"""The emulated bench: physics and sensors, and `TruthPlant` behind the interface of `hydro_sim.model.plant.Plant`.

Sensors: crosstalk, amplifier lag, gain and bias, noise, quantisation, differentiation. Two chains run side by side over
the same lags: one with noise and quantisation (the measurement), one without (the noise-free log, for scoring only).
Differentiation is the box's own code, `hydro_sim.model.sensors.condition_readings`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_core.signals import PLANT_FIELDS, FloatArray
from hydro_sim.emulator.truth import dynamics
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.emulator.truth.parameters import SUBSTEP_TIME, SUBSTEPS, compile_parameters
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model.sensors import CONDITIONING_DTYPE, Noise, Sensors, condition_readings, reset_conditioning

TRUTH_FIELDS = (
    *PLANT_FIELDS,
    "spool",  # A, of the command that would hold it
    "friction_force",  # N, dry and viscous, against motion
    "supply_pressure",  # Pa
    "valve_draw",  # m3/s, from the supply
)
"""Columns of the physical log: the state before any sensor, then quantities that no sensor measures."""

CHAIN_DTYPE = np.dtype(
    [
        ("lagged", np.float64, (5,)),  # the five readings behind their amplifiers, order of effects.SENSORS
        ("lag_rate", np.float64, (5,)),
        ("before", np.float64, (5,)),  # the amplifiers' inputs a substep ago
        ("now", np.float64, (5,)),
        ("noisy_last", CONDITIONING_DTYPE),
        ("clean_last", CONDITIONING_DTYPE),
        ("measurement", np.float64, (8,)),  # x as the box measures it
        ("clean", np.float64, (8,)),  # the same without noise and quantisation
    ]
)
"""State of the sensor chain: amplifiers, conditioning, readings."""


@njit
def _collect(p, state, readings):
    a, b = state.pressure_a, state.pressure_b
    readings[0] = state.hydraulic_force + p.crosstalk_hydraulic_force_a * a + p.crosstalk_hydraulic_force_b * b
    readings[1] = state.load_force + p.crosstalk_load_force_a * a + p.crosstalk_load_force_b * b
    readings[2] = a
    readings[3] = b
    readings[4] = state.y[2]


@njit
def advance_amplifiers(p, state, chain):
    """Advance the amplifiers by one substep, by the trapezoidal rule."""
    _collect(p, state, chain.now)
    for i in range(5):
        w, mean = p.lag_frequency[i], 0.5 * (chain.before[i] + chain.now[i])
        y, rate = chain.lagged[i], chain.lag_rate[i]
        half = 0.5 * SUBSTEP_TIME * w
        if p.lag_order[i] == 2.0:
            damped = 2.0 * p.lag_damping[i] * half
            push = SUBSTEP_TIME * w * w * (mean - y)
            ahead = (rate * (1.0 - damped - half * half) + push) / (1.0 + damped + half * half)
            chain.lagged[i] = y + 0.5 * SUBSTEP_TIME * (rate + ahead)
            chain.lag_rate[i] = ahead
        elif p.lag_order[i] == 1.0:
            chain.lagged[i] = (y * (1.0 - half) + 2.0 * half * mean) / (1.0 + half)
        else:
            chain.lagged[i] = chain.now[i]
        chain.before[i] = chain.now[i]


@njit
def read_sensors(p, box, chain, noise, first):
    """Read one sample of the box into `measurement` and `clean` of `chain`; `first`: of a bench at rest, rates 0."""
    raw = np.empty(5)
    for i in range(5):
        raw[i] = p.sensor_gain[i] * chain.lagged[i] + p.sensor_bias[i]
    if first:
        reset_conditioning(chain.clean_last, raw, chain.clean)
    else:
        condition_readings(box, chain.clean_last, raw, chain.clean)
    raw[0] += p.noise_force * noise[0]
    raw[1] += p.noise_force * noise[1]
    raw[2] += p.noise_pressure * noise[2]
    raw[3] += p.noise_pressure * noise[3]
    if p.encoder_step > 0.0:
        raw[4] = np.floor(raw[4] / p.encoder_step + 0.5) * p.encoder_step
    if first:
        reset_conditioning(chain.noisy_last, raw, chain.measurement)
    else:
        condition_readings(box, chain.noisy_last, raw, chain.measurement)


@njit
def start_at_rest(p, box, state, chain, noise):
    """Set the bench at rest, with its first reading; arguments as of `advance_sample`."""
    dynamics.rest_state(p[0], state[0])
    _collect(p[0], state[0], chain[0].before)
    copy_vector(chain[0].lagged, chain[0].before)
    chain[0].lag_rate[:] = 0.0
    read_sensors(p[0], box[0], chain[0], noise, True)


@njit
def advance_sample(p, box, state, chain, work, noise, current):
    """Advance by one sample of 1 ms in place at a held valve current [A]: physics, amplifiers, readings.

    `p`, `box`, `state`, `chain`: arrays of shape (1,): plant parameters, the box's differentiation, physical state,
    sensors. `work`: scratch space, shape (3, 9). `noise`: standard normal numbers, shape (5,).
    """
    dynamics.hold_command(p[0], state[0], current, noise[4])
    for index in range(SUBSTEPS):
        dynamics.advance_substep(p[0], state[0], index, work)
        advance_amplifiers(p[0], state[0], chain[0])
    read_sensors(p[0], box[0], chain[0], noise, False)


@njit
def copy_physical(state, row):
    """Copy the physical quantities into `row`, shape (len(`TRUTH_FIELDS`),)."""
    s = state[0]
    row[0], row[1], row[2], row[3] = s.hydraulic_force, s.hydraulic_force_rate, s.load_force, s.load_force_rate
    row[4], row[5], row[6], row[7] = s.pressure_a, s.pressure_b, s.y[2], s.y[3]
    row[8], row[9], row[10], row[11] = s.y[4], s.friction_force, s.y[6], s.draw


class TruthPlant:
    """The emulated bench; implements `hydro_sim.model.plant.Plant`.

    `config`: the bench. `seed`: of the sensors' noise and the random force.
    """

    def __init__(self, config: TruthConfig, seed: int = 0) -> None:
        self.config = config
        self.parameters = compile_parameters(config)
        ages = config.sensors
        self.sensors = Sensors(force_rate_age=ages.force_rate_age, velocity_age=ages.velocity_age)
        self.differentiation = self.sensors.constants()
        self.state, self.chain = np.zeros(1, dynamics.TRUTH_STATE_DTYPE), np.zeros(1, CHAIN_DTYPE)
        self.work = np.zeros((3, 9))
        self.reset(seed)

    @property
    def records(self) -> tuple[npt.NDArray[np.void], ...]:
        """Parameters, differentiation, state and sensors, for compiled code."""
        return self.parameters, self.differentiation, self.state, self.chain

    def reset(self, seed: int) -> FloatArray:
        """Reset to rest, with noise from `seed`; return the measurement x, shape (8,)."""
        self.noise = Noise(seed)
        start_at_rest(*self.records, self.noise.row())
        return self.measurement()

    def step(self, valve_current: float) -> FloatArray:
        """Hold `valve_current` [A] for 1 ms; return the measurement x after it, shape (8,)."""
        advance_sample(*self.records, self.work, self.noise.row(), valve_current)
        return self.measurement()

    def measurement(self) -> FloatArray:
        """Present measurement x (eq. state_def), shape (8,), SI units; a copy."""
        return self.chain["measurement"][0].copy()
