# SPDX-License-Identifier: Apache-2.0
"""Sensors of the truth plant: crosstalk, amplifier lag, gain and bias, noise, quantisation, differentiation.

Two chains run side by side over the same lags: one with noise and quantisation (the measurement), one without (the
noise-free log, for scoring only). Differentiation is the box's own code, `hydro_sim.model.sensors.condition`.
"""

from __future__ import annotations

import numpy as np

from hydro_sim.emulator.truth.parameters import SUBSTEP
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model.sensors import CONDITIONING_DTYPE, condition, restart

CHAIN = np.dtype(
    [
        ("lagged", np.float64, (5,)),  # the five readings behind their amplifiers, order of effects.SENSORS
        ("lag_rate", np.float64, (5,)),
        ("before", np.float64, (5,)),  # what went into the amplifiers a substep ago
        ("now", np.float64, (5,)),
        ("noisy_last", CONDITIONING_DTYPE),
        ("clean_last", CONDITIONING_DTYPE),
        ("measurement", np.float64, (8,)),  # x as the box has it
        ("clean", np.float64, (8,)),  # the same without noise and quantisation
    ]
)
"""State of the sensors."""


@njit
def _collect(p, state, readings):
    a, b = state.pressure_a, state.pressure_b
    readings[0] = state.hydraulic_force + p.crosstalk_hydraulic_force_a * a + p.crosstalk_hydraulic_force_b * b
    readings[1] = state.load_force + p.crosstalk_load_force_a * a + p.crosstalk_load_force_b * b
    readings[2] = a
    readings[3] = b
    readings[4] = state.y[2]


@njit
def start(p, box, state, chain, noise):
    """First reading of a bench at rest; `noise`: standard normal numbers, the first four are used."""
    _collect(p, state, chain.before)
    copy_vector(chain.lagged, chain.before)
    chain.lag_rate[:] = 0.0
    raw = np.empty(5)
    _read(p, chain, noise, False, raw)
    restart(chain.clean_last, raw, chain.clean)
    _read(p, chain, noise, True, raw)
    restart(chain.noisy_last, raw, chain.measurement)


@njit
def follow(p, state, chain):
    """Advance the amplifiers by one substep, by the trapezoidal rule."""
    _collect(p, state, chain.now)
    for i in range(5):
        w, mean = p.lag_frequency[i], 0.5 * (chain.before[i] + chain.now[i])
        y, rate = chain.lagged[i], chain.lag_rate[i]
        half = 0.5 * SUBSTEP * w
        if p.lag_order[i] == 2.0:
            damped = 2.0 * p.lag_damping[i] * half
            push = SUBSTEP * w * w * (mean - y)
            ahead = (rate * (1.0 - damped - half * half) + push) / (1.0 + damped + half * half)
            chain.lagged[i] = y + 0.5 * SUBSTEP * (rate + ahead)
            chain.lag_rate[i] = ahead
        elif p.lag_order[i] == 1.0:
            chain.lagged[i] = (y * (1.0 - half) + 2.0 * half * mean) / (1.0 + half)
        else:
            chain.lagged[i] = chain.now[i]
        chain.before[i] = chain.now[i]


@njit
def _read(p, chain, noise, noisy, raw):
    for i in range(5):
        raw[i] = p.sensor_gain[i] * chain.lagged[i] + p.sensor_bias[i]
    if not noisy:
        return
    raw[0] += p.noise_force * noise[0]
    raw[1] += p.noise_force * noise[1]
    raw[2] += p.noise_pressure * noise[2]
    raw[3] += p.noise_pressure * noise[3]
    if p.encoder_step > 0.0:
        raw[4] = np.floor(raw[4] / p.encoder_step + 0.5) * p.encoder_step


@njit
def read(p, box, chain, noise):
    """Read one sample of the box into `measurement` and `clean` of `chain`."""
    raw = np.empty(5)
    _read(p, chain, noise, False, raw)
    condition(box, chain.clean_last, raw, chain.clean)
    _read(p, chain, noise, True, raw)
    condition(box, chain.noisy_last, raw, chain.measurement)
