# SPDX-License-Identifier: Apache-2.0
"""What the box reads of the truth plant: noise, quantisation, gain, bias, lag, differentiation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import signal

from hydro_bridge.signals import PLANT_FIELDS, FloatArray
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.emulator.truth.plant import TruthPlant

MOVING = 0.003 * np.sin(2 * np.pi * 2.0 * np.arange(1500) * 1e-3)


def logs(
    sensors: dict[str, Any] | None = None, outside: dict[str, Any] | None = None, **effects: Any
) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Measured, noise-free and physical columns of a moving bench with an ideal load cell, by field name."""
    config = {
        "profile": "nominal",
        "bench": {"load_cell_bandwidth": None},
        "sensors": sensors or {},
        "effects": effects,
        "outside": outside or {},
    }
    noisy, clean, physical = TruthPlant(truth_from_mapping(config)).run(MOVING)
    return {name: (noisy[:, i], clean[:, i], physical[:, i]) for i, name in enumerate(PLANT_FIELDS)}


@pytest.mark.parametrize("scale", [0.1, 1.0, 4.0])
def test_noise_has_the_stated_deviation(scale: float) -> None:
    columns = logs({"noise_scale": scale})
    for name, deviation in (("hydraulic_force", 0.6), ("load_force", 0.6), ("pressure_a", 6e3), ("pressure_b", 6e3)):
        noisy, clean, physical = columns[name]
        assert np.std(noisy - clean) == pytest.approx(scale * deviation, rel=0.08)
        assert clean == pytest.approx(physical, abs=1e-9 * np.abs(physical).max())


def test_encoder_counts_whole_micrometers_and_no_finer() -> None:
    noisy, clean, _ = logs()["piston_position"]
    assert noisy * 1e6 == pytest.approx(np.rint(noisy * 1e6), abs=1e-6)
    assert np.abs(noisy - clean).max() <= 0.5e-6 + 1e-12
    assert len(np.unique(noisy)) > 100


@pytest.mark.parametrize(
    ("effects", "name", "gain", "bias"),
    [
        ({"load_cell_gain": {"ratio": 1.05}}, "load_force", 1.05, 0.0),
        ({"load_cell_gain": {"ratio": 0.9, "cell": "hydraulic_force"}}, "hydraulic_force", 0.9, 0.0),
        ({"load_cell_bias": {"force": -7.0, "cell": "hydraulic_force"}}, "hydraulic_force", 1.0, -7.0),
        ({"pressure_sensor_bias": {"pressure": 2e5, "chamber": "b"}}, "pressure_b", 1.0, 2e5),
    ],
)
def test_gain_and_bias_touch_their_own_sensor_only(
    effects: dict[str, Any], name: str, gain: float, bias: float
) -> None:
    for other, (_, clean, physical) in logs(**effects).items():
        if not other.endswith(("_rate", "_velocity")):
            expected = gain * physical + bias if other == name else physical
            assert clean == pytest.approx(expected, abs=1e-9 * np.abs(physical).max())


@pytest.mark.parametrize("order", [1, 2])
def test_sensor_lag_is_the_low_pass_that_it_says(order: int) -> None:
    """Against scipy's exact response of the same filter to the physical force."""
    lag = {"bandwidth": 30.0, "order": order, "damping": 0.6}
    _, clean, physical = logs(sensor_lag=lag)["load_force"]
    w = 2 * np.pi * 30.0
    system = ([w], [1.0, w]) if order == 1 else ([w * w], [1.0, 1.2 * w, w * w])
    _, expected, _ = signal.lsim(system, physical, np.arange(len(physical)) * 1e-3)
    assert clean == pytest.approx(expected, abs=1e-3 * np.abs(physical).max())
    assert np.abs(clean - physical).max() > 0.02 * np.abs(physical).max()


def test_rates_are_differences_of_what_was_measured_and_follow_the_truth() -> None:
    columns = logs({"noise_scale": 0.0, "encoder_step": 0.0})
    for value, rate in (("load_force", "load_force_rate"), ("piston_position", "piston_velocity")):
        measured = columns[rate][0]
        assert np.sum(measured) * 1e-3 == pytest.approx(columns[value][0][-1] - columns[value][0][0], rel=0.05)
        assert measured[100:] == pytest.approx(columns[rate][2][100:], abs=0.2 * np.abs(measured).max())
