# SPDX-License-Identifier: Apache-2.0
"""The one model of a bench: its derivatives and the sensitivities of a prediction against differences."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from hydro_core.signals import FloatArray
from hydro_sim.identification.bench_states import Sensitivities
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel


def effect(name: str, **parameters: float) -> dict[str, Any]:
    identifier, *options = name.split()
    return {"id": identifier, **dict(option.split("=") for option in options), "parameters": parameters}


VALVE = (
    effect("transport_delay", time=1.33e-3), effect("valve_offset", current=1e-4),
    effect("valve_lag", bandwidth=90.0, damping=0.7), effect("valve_gain_asymmetry", ratio=0.9),
    effect("valve_deadband form=soft", half_width=2e-4, softness=5e-5),
    effect("valve_null_leakage form=gaussian", coefficient=3e-10, width=5e-4),
)  # fmt: skip
MOTION = (
    effect("friction_coulomb", force=20.0), effect("friction_stribeck", breakaway_force=8.0, velocity=0.01),
    effect("backlash form=play", width=5e-4), effect("spring_hardening", coefficient=5e6),
    effect("moving_mass", mass=0.3), effect("load_cell_gain cell=load_force", ratio=1.02),
)  # fmt: skip
MEMORY = (
    effect("friction_coulomb", force=12.0), effect("friction_presliding", stiffness=3e5),
    effect("supply_droop", resistance=5e9, time_constant=0.02), effect("entrained_air", volume_fraction=0.01),
    effect("leakage_internal", coefficient=1e-12), effect("sensor_lag sensor=load_force", bandwidth=25.0, damping=0.55),
)  # fmt: skip
SETS = {"valve": VALVE, "motion": MOTION, "memory": MEMORY}


def wave(samples: int) -> FloatArray:
    time = 1e-3 * np.arange(samples)
    return np.asarray(4e-3 * np.sin(2 * np.pi * 3 * time) + 2e-3 * np.sin(2 * np.pi * 17 * time))


@pytest.mark.parametrize("name", SETS)
def test_jacobian_of_a_sample_is_that_of_differences(name: str) -> None:
    model = BenchModel(replace(Bench.nominal(), effects=SETS[name]))
    k, y, _ = model.begin(model.values)
    model.rollout(k, y, wave(137))
    _, dy, dz = model.jacobian(k, y.copy(), 3e-3)
    scales = np.array([state.scale for state in model.states] + [1e-2])
    for j, scale in enumerate(scales):
        step = 1e-6 * scale
        ends = []
        for side in (1.0, -1.0):
            moved, current = y.copy(), 3e-3
            if j < len(y):
                moved[j] += side * step
            else:
                current += side * step
            z = model.sample(k, moved, current)
            ends.append((moved, z))
        by_difference = [(up - down) / (2.0 * step) for up, down in zip(*ends, strict=True)]
        np.testing.assert_allclose(dy[:, j] * scale / scales[:-1], by_difference[0] * scale / scales[:-1], atol=2e-6)
        np.testing.assert_allclose(dz[:, j] * scale, by_difference[1] * scale, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("damping", [0.2, 1.0, 3.0])
def test_lags_are_exponentials_of_their_matrix(damping: float) -> None:
    bench = replace(Bench.nominal(), effects=(effect("valve_lag", bandwidth=300.0, damping=damping),))
    model = BenchModel(bench)
    k, y, _ = model.begin(model.values)
    y[6:8] = 2e-3, 0.5
    model.sample(k, y, 1e-3)
    omega = 2.0 * np.pi * 300.0
    system = np.array([[0.0, 1.0], [-omega * omega, -2.0 * damping * omega]])
    expected = expm(1e-3 * system) @ np.array([2e-3 - 1e-3, 0.5]) + np.array([1e-3, 0.0])
    np.testing.assert_allclose(y[6:8], expected, rtol=1e-9, atol=1e-12)


def test_a_mass_that_is_held_has_no_derivative_of_its_place_by_a_small_force() -> None:
    """Derivatives are those of the side that the step is on: what holds, holds whatever changes a little."""
    bench = replace(Bench.nominal(), effects=(effect("friction_coulomb", force=50.0),))
    model = BenchModel(bench)
    k, y, _ = model.begin(model.values)
    _, dy, _ = model.jacobian(k, y, 0.0)
    assert y[3] == 0.0
    assert (dy[3] == 0.0).all()
    assert dy[2, 0] == 0.0 and dy[2, 2] == 1.0


@pytest.mark.parametrize("spoil", ["current", "state"])
def test_what_is_not_finite_stays_so_whatever_the_equations_limit(spoil: str) -> None:
    model = BenchModel(Bench.nominal())
    k, y, _ = model.begin(model.values)
    if spoil == "state":
        y[2] = np.nan
    assert np.isnan(model.sample(k, y, np.nan if spoil == "current" else 1e-3)).all() and np.isnan(y).all()


def test_a_dead_time_beyond_the_files_is_refused() -> None:
    model = BenchModel(replace(Bench.nominal(), effects=(effect("transport_delay", time=3e-3),)))
    theta = model.values.copy()
    theta[[one.name.endswith(".time") for one in model.parameters]] = 0.02
    with pytest.raises(ValueError, match="a dead time is above the bench file's"):
        model.begin(theta)


NOISE: FloatArray = np.array([0.6, 0.6, 6e3, 6e3, 3e-7])
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
LEARNT: dict[str, Any] = {"bristles": {"effects": BRISTLES}, "held": {"effects": HELD, "closures": (DRAG,)}}


@pytest.mark.parametrize("name", LEARNT)
def test_sensitivities_are_those_of_differences(name: str) -> None:
    """By every parameter of every effect and closure, by the bench's numbers, and by the start, over 70 samples."""
    model = BenchModel(replace(Bench.nominal(), **LEARNT[name]), substeps=10)
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
