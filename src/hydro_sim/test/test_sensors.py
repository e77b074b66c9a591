# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_sim.model import sensors
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.model.sensors import CONDITIONING_DTYPE, Sensors


def differentiated(position: FloatArray, settings: Sensors) -> FloatArray:
    """Velocities, shape (n,), that the box finds for sampled positions, shape (n,)."""
    constants, last, x = settings.constants(0.0), np.zeros(1, CONDITIONING_DTYPE), np.zeros(8)
    raw = np.zeros(5)
    raw[4] = position[0]
    sensors.restart(last[0], raw, x)
    velocity = [0.0]
    for value in position[1:]:
        raw[4] = value
        sensors.condition(constants[0], last[0], raw, x)
        velocity.append(x[7])
    return np.array(velocity)


@pytest.mark.parametrize("age", [5e-4, 1e-3, 2e-3])
def test_a_velocity_is_as_old_as_its_setting_says(age: float) -> None:
    times = 1e-3 * np.arange(400)
    acceleration = 3.0
    velocity = differentiated(0.5 * acceleration * times**2, Sensors(velocity_age=age))
    np.testing.assert_allclose(velocity[100:], acceleration * (times[100:] - age), rtol=1e-9)


def test_readings_have_the_stated_noise_and_steps(bench: Bench) -> None:
    plant = AnalyticPlant(bench)
    samples = np.array([plant.reset(seed) for seed in range(2000)])
    spread = samples.std(axis=0)
    assert spread[[0, 2]] == pytest.approx(0.6, rel=0.05)
    assert spread[[4, 5]] == pytest.approx(6e3, rel=0.05)
    steps = samples[:, 6] / 1e-6
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
