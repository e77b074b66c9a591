# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.locate import mean_squares
from hydro_diagnosis.outcome import Outcome
from hydro_diagnosis.problem import Problem
from hydro_diagnosis.search import Search
from hydro_sim.bench import Bench

NOMINAL = Bench.nominal()


def search(problem: Problem) -> Outcome:
    return Search(problem, [effect.adapted(NOMINAL) for effect in LIBRARY]).run()


def test_residuals_of_a_matching_bench_are_noise(problem: Problem) -> None:
    squares = mean_squares(problem, problem.residual([]))
    assert all(0.75 < square < 1.25 for square in squares.values()), squares


def test_noise_floor_is_the_sensors_noise(problem: Problem) -> None:
    assert problem.sensor_noise["load_force"] == pytest.approx(0.6, rel=0.05)
    assert problem.sensor_noise["hydraulic_force"] == pytest.approx(0.6, rel=0.1)
    assert problem.sensor_noise["pressure_a"] == pytest.approx(6e3, rel=0.05)
    assert problem.sensor_noise["piston_position"] == pytest.approx(1e-6 / np.sqrt(12.0), rel=0.1)


def test_nothing_is_claimed_where_nothing_is_missing(problem: Problem) -> None:
    assert search(problem).fit.claims == ()


@pytest.mark.parametrize(
    "key, factor, effect, parameter, expected, tolerance",
    [
        ("moving_mass", 1.5, "moving_mass", "mass", 0.6, 0.03),
        ("viscous_friction", 1.4, "friction_viscous", "coefficient", 24.0, 0.02),
        ("spring_stiffness", 0.95, "spring_stiffness", "ratio", 0.95, 0.001),
        ("supply_pressure", 0.96, "supply_pressure", "ratio", 0.96, 0.002),
        ("bulk_modulus", 0.8, "bulk_modulus", "ratio", 0.8, 0.002),
        ("piston_area", 1.03, "piston_area", "ratio", 1.03, 0.002),
        ("dead_volume_a", 1.1, "dead_volume", "ratio", 1.1, 0.002),
    ],
)
def test_wrong_value_of_the_bench_is_named_and_sized(
    problem_of: Callable[..., Problem],
    key: str,
    factor: float,
    effect: str,
    parameter: str,
    expected: float,
    tolerance: float,
) -> None:
    found = search(problem_of(**{key: getattr(NOMINAL, key) * factor}))
    assert [claim.effect.id for claim in found.fit.claims] == [effect]
    assert found.fit.claims[0].values[parameter] == pytest.approx(expected, rel=tolerance)
