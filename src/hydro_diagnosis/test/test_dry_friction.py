# SPDX-License-Identifier: Apache-2.0
"""Dry friction, where it is hardest: at standstill and on the way out of it."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.preprocessing.smoothing import TOTAL_WIDTH, finish
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
STEP = 1e-3
FORCE = 10.0


def claim(label: str, **values: float) -> Claim:
    return Claim(next(one for one in LIBRARY if one.label == label), values)


def pushed(force: float) -> SegmentModel:
    """A bench at the spring's rest with its valve shut, and more force on the piston than the spring takes."""
    p_b = 8e6
    p_a = BENCH.area_ratio * p_b + force / BENCH.piston_area
    values = {"valve_current": 0.0, "piston_position": BENCH.spring_rest_position, "pressure_a": p_a, "pressure_b": p_b}
    channels = {name: np.full(400, value) for name, value in values.items()}
    return SegmentModel(Segment("pushed", 0.0, STEP, channels), BENCH)


@pytest.mark.parametrize(
    ("label", "values", "moves"),
    [
        ("friction_coulomb", {"force": 11.0}, False),
        ("friction_coulomb", {"force": 9.0}, True),
        ("friction_coulomb:directional", {"force_positive": 11.0, "force_negative": 1.0}, False),
        ("friction_coulomb:directional", {"force_positive": 9.0, "force_negative": 99.0}, True),
        ("friction_stribeck", {"breakaway_force": 11.0, "velocity": 0.01}, False),
    ],
)
def test_piston_sticks_exactly_as_far_as_friction_reaches(label: str, values: dict[str, float], moves: bool) -> None:
    plant = Plant.of(pushed(FORCE), [claim(label, **values)])
    begins = np.array([50])
    travel = np.abs(plant.run(plant.start(begins), begins, 100)[:, 0, 0] - BENCH.spring_rest_position).max()
    assert (travel > 1e-7) == moves
    if not moves:
        assert travel < 1e-12


def test_sliding_piston_is_stopped_and_stays() -> None:
    plant = Plant.of(pushed(0.0), [claim("friction_coulomb", force=40.0)])
    begins = np.array([50])
    state = plant.start(begins)
    state[1] = 0.02
    states = plant.run(state, begins, 100)
    assert states[-1, 1, 0] == 0.0
    assert states[-1, 0, 0] == states[-40, 0, 0] > BENCH.spring_rest_position


def test_friction_is_averaged_over_the_velocities_within_the_test_function() -> None:
    """Breaking loose at 5 m/s^2, a Stribeck rise is passed in some milliseconds."""
    acceleration, strength, width = 5.0, 6.0, 0.012
    time = (np.arange(400) - 200.0) * STEP
    channels = {"piston_position": 0.04 + 0.5 * acceleration * time**2}
    model = SegmentModel(Segment("loose", 0.0, STEP, channels), BENCH)
    got = finish(model.dry_friction([claim("friction_stribeck", breakaway_force=strength, velocity=width)]))

    fine = np.linspace(-8.0, 8.0, 4001)
    bell = np.exp(-0.5 * (fine / TOTAL_WIDTH) ** 2)
    velocity = acceleration * (time[:, None] + fine * STEP)
    true = (strength * np.sign(velocity) * np.exp(-((velocity / width) ** 2))) @ bell / bell.sum()
    np.testing.assert_allclose(got[50:350], true[50:350], atol=0.06 * strength)
    assert np.abs(got - true)[204:212].max() < 0.03 * strength  # where it is told from Coulomb friction
