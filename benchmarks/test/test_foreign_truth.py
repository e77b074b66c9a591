# SPDX-License-Identifier: Apache-2.0
"""The foreign plant against closed forms and its own finer steps."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.foreign_truth.bench import Numbers, numbers
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, STATES, VELOCITY
from benchmarks.foreign_truth.plant import NONE, FloatArray, advance, reference, run

pytestmark = pytest.mark.study
STEP = 5e-6


def left_alone(bench: Numbers, seconds: float, velocity: float = 0.0) -> FloatArray:
    """States after each step with the valve closed, from the spring's rest."""
    state, work = np.zeros(STATES), np.zeros((3, STATES))
    state[PRESSURE_A], state[PRESSURE_B] = 6e6, 6e6 / bench.area_ratio
    state[POSITION], state[VELOCITY] = bench.spring_rest_position, velocity
    states = np.empty((round(seconds / STEP), STATES))
    for k in range(len(states)):
        advance(NONE, bench, k * STEP, 0.0, state, STEP, work)
        states[k] = state
    return states


def test_undamped_mass_swings_at_the_frequency_of_oil_and_spring_and_keeps_its_energy() -> None:
    bench = numbers(viscous_friction=0.0)
    area, middle = bench.piston_area, bench.spring_rest_position
    compliance_a = bench.dead_volume_a + area * middle
    compliance_b = bench.dead_volume_b + bench.area_ratio * area * (bench.stroke - middle)
    oil = bench.bulk_modulus * area**2 * (1.0 / compliance_a + bench.area_ratio**2 / compliance_b)
    expected = np.sqrt((oil + bench.spring_stiffness) / bench.moving_mass) / (2.0 * np.pi)
    velocity = left_alone(bench, 0.15, velocity=1e-3)[:, VELOCITY]
    (up,) = np.nonzero((velocity[:-1] < 0.0) & (velocity[1:] >= 0.0))
    crossings = up + velocity[up] / (velocity[up] - velocity[up + 1])
    assert 1.0 / (STEP * np.diff(crossings).mean()) == pytest.approx(expected, rel=1e-4)
    assert velocity[-3000:].max() == pytest.approx(1e-3, rel=1e-4)


def test_friction_stops_the_mass_where_it_must_and_then_holds_it() -> None:
    soft = numbers(bulk_modulus=1.0, spring_stiffness=0.0, viscous_friction=0.0, coulomb=24.0)  # no force but friction
    states = left_alone(soft, 0.03, velocity=0.5)
    travel = states[-1, POSITION] - soft.spring_rest_position
    assert travel == pytest.approx(0.5 * soft.moving_mass * 0.5**2 / soft.coulomb, rel=1e-3)
    assert np.abs(states[-100:, VELOCITY]).max() == 0.0
    pushed = left_alone(soft._replace(force_offset=10.0), 0.01)
    creep = (pushed[-1, POSITION] - pushed[0, POSITION]) / 0.01
    assert 0.0 < creep < 10.0 * STEP / soft.moving_mass  # what the splitting costs: um/s


def test_finer_steps_change_nothing_without_friction_and_less_than_the_encoder_sees_with_it() -> None:
    drive = reference("sines", 1500, 3)

    def apart(coarse: int, **truth: float) -> float:
        first, second = (run(numbers(**truth), drive, substeps=substeps) for substeps in (coarse, 2 * coarse))
        return float(np.abs(first[:, 6] - second[:, 6]).max())

    assert apart(100, leak_internal=6e-14) < 1e-13
    friction = {"coulomb": 8.0, "stribeck": 6.0}
    fine = apart(100, **friction)
    assert fine < 1e-6  # the encoder's step
    assert apart(50, **friction) / fine == pytest.approx(2.0, rel=0.05)
