# SPDX-License-Identifier: Apache-2.0
"""Forward sensitivities of a prediction, against differences; the filter that starts one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.sensitivities import Sensitivities

NOISE: FloatArray = np.array([0.6, 0.6, 6e3, 6e3, 3e-7])


def effect(name: str, **parameters: float) -> dict[str, Any]:
    identifier, *options = name.split()
    return {"id": identifier, **dict(option.split("=") for option in options), "parameters": parameters}


BRISTLES = (
    effect("transport_delay", time=1.33e-3), effect("valve_lag", bandwidth=90.0, damping=0.7),
    effect("valve_deadband form=soft", half_width=2e-4, softness=5e-5), effect("friction_coulomb", force=12.0),
    effect("friction_presliding", stiffness=3e5), effect("supply_droop", resistance=5e9, time_constant=0.02),
    effect("leakage_internal", coefficient=1e-12), effect("spring_stiffness", ratio=1.3),
    effect("sensor_lag sensor=load_force", bandwidth=25.0, damping=0.55),
)  # fmt: skip
HELD = (
    effect("friction_coulomb", force=20.0), effect("friction_stribeck", breakaway_force=8.0, velocity=0.01),
    effect("backlash form=play", width=5e-4), effect("entrained_air", volume_fraction=0.01),
    effect("valve_gain_asymmetry", ratio=0.9),
)  # fmt: skip
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 120.0}}
SETS: dict[str, Any] = {"bristles": {"effects": BRISTLES}, "held": {"effects": HELD, "closures": (DRAG,)}}


def wave(samples: int) -> FloatArray:
    time = 1e-3 * np.arange(samples)
    return np.asarray(4e-3 * np.sin(2 * np.pi * 3 * time) + 2e-3 * np.sin(2 * np.pi * 17 * time))


@pytest.mark.parametrize("name", SETS)
def test_sensitivities_are_those_of_differences(name: str) -> None:
    """By every parameter of every effect and closure, by the bench's numbers, and by the start, over 70 samples."""
    model = BenchModel(replace(Bench.nominal(), **SETS[name]), substeps=10)
    exact = Sensitivities(model)
    k, dk = exact.coefficients(model.values)
    np.testing.assert_array_equal(k, model.begin(model.values)[0])
    _, start, _ = model.begin(model.values)
    model.rollout(k, start, wave(137))
    current = wave(207)[137:].copy()
    sizes = np.maximum(np.abs(model.values), [1e-3 * one.scale for one in model.parameters])
    scales = np.array([state.scale for state in model.states])[: exact.held]
    z, dz, end = exact.window(k, start, current, np.diag(scales), dk * sizes)
    last = start.copy()
    np.testing.assert_allclose(z, model.rollout(k, last, current), rtol=1e-9)
    np.testing.assert_allclose(end, last, rtol=1e-9, atol=1e-12)
    step = 1e-6
    for j in range(dz.shape[2]):
        ends = []
        for side in (step, -step):
            theta, y = model.values.copy(), start.copy()
            if j < exact.held:
                y[j] += side * scales[j]
            else:
                theta[j - exact.held] += side * sizes[j - exact.held]
            ends.append(model.rollout(model.begin(theta)[0], y, current) / NOISE)
        difference = (ends[0] - ends[1]) / (2.0 * step)
        allowed = 1e-3 * np.max(np.abs(difference)) + 2e-3
        assert np.max(np.abs(dz[:, :, j] / NOISE - difference)) < allowed, (j, np.max(np.abs(difference)))
