# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hydro_bridge.signals import StateArray
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.estimation.fit import fit, mean_squares, noticeable, score
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_diagnosis.selection.outcome import Outcome, SearchSettings
from hydro_diagnosis.selection.search import Search
from hydro_sim.model.bench import Bench

NOMINAL = Bench.nominal()


def search(problem: Problem) -> Outcome:
    return Search(problem, [effect.adapted(NOMINAL) for effect in LIBRARY]).run()


def test_residuals_of_a_matching_bench_are_noise(problem: Problem) -> None:
    squares = mean_squares(problem, problem.residual([]))
    assert all(0.75 < square < 1.25 for square in squares.values()), squares


def test_nothing_is_claimed_where_nothing_is_missing(problem: Problem) -> None:
    assert search(problem).fit.claims == ()


@pytest.mark.parametrize(
    "key, factor, effect, parameter, expected, tolerance",
    [
        ("moving_mass", 1.5, "moving_mass", "mass", 0.6, 0.03),
        pytest.param("viscous_friction", 1.4, "friction_viscous", "coefficient", 24.0, 0.02, marks=pytest.mark.study),
        ("spring_stiffness", 0.95, "spring_stiffness", "ratio", 0.95, 0.001),
        pytest.param("supply_pressure", 0.96, "supply_pressure", "ratio", 0.96, 0.002, marks=pytest.mark.study),
        ("bulk_modulus", 0.8, "bulk_modulus", "ratio", 0.8, 0.002),
        pytest.param("piston_area", 1.03, "piston_area", "ratio", 1.03, 0.002, marks=pytest.mark.study),
        pytest.param("dead_volume_a", 1.1, "dead_volume", "ratio", 1.1, 0.002, marks=pytest.mark.study),
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


DRY, DIRECTED = "friction_coulomb", "friction_coulomb:directional"


def claim_of(label: str, *sizes: float) -> Claim:
    effect = next(one for one in LIBRARY if one.label == label)
    return Claim(effect, {one.name: size for one, size in zip(effect.parameters, sizes, strict=True)})


def problem_with(record: Callable[..., StateArray], *claims: Claim) -> Problem:
    states = record(corrected_bench(NOMINAL, claims), 3, seconds=8.0)
    table = RawTable("dry", states["time"].copy(), None, {name: states[name].copy() for name in SENSED})
    return Problem(checked(table, NOMINAL).segments, NOMINAL)


SENSED = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position", "valve_current")


def test_richer_form_must_pay_for_its_parameter(record: Callable[..., StateArray]) -> None:
    """15.0 and 15.1 N: the second number gains 14 of BIC, which errors of the residuals' own reach."""
    problem = problem_with(record, claim_of(DIRECTED, 15.0, 15.1))
    outcome = search(problem)
    problem, found = outcome.problem, outcome.fit
    assert [claim.effect.label for claim in found.claims] == [DRY]
    richer = score(problem, found) - score(problem, fit(problem, [claim_of(DIRECTED, 15.0, 15.0)]))
    assert 2.0 < richer < SearchSettings().threshold  # else this shows nothing


def test_richer_form_that_pays_is_named(record: Callable[..., StateArray]) -> None:
    found = search(problem_with(record, claim_of(DIRECTED, 15.0, 15.3))).fit
    assert [claim.effect.label for claim in found.claims] == [DIRECTED]
    assert found.claims[0].values["force_negative"] == pytest.approx(15.3, abs=0.1)


def test_hard_dead_band_beside_a_gain_is_no_soft_one(record: Callable[..., StateArray]) -> None:
    """A soft dead band comes first, as it takes the form of both; beside it neither a leak nor the gain is left."""
    sizes = {"valve_deadband": 8e-4, "valve_gain": 0.9, "leakage_external:a": 3e-14}
    concealed = [claim_of(label, size) for label, size in sizes.items()]
    found = search(problem_with(record, *concealed)).fit
    assert {one.effect.label: one.values for one in found.claims} == {
        one.effect.label: pytest.approx(one.values, rel=0.02) for one in concealed
    }


@pytest.mark.parametrize("square, remains", [(1.45, set(CHANNELS[:4])), (1.7, set(CHANNELS))])
def test_what_remains_is_judged_by_how_many_residuals_tell(problem: Problem, square: float, remains: set[str]) -> None:
    """12 s: 2300 residuals in most channels, but 117 means over 100 ms, whose mean square chance brings to 1.4."""
    for index, name in enumerate(CHANNELS):
        residual = np.where(problem.layout.channel == index, square**0.5, 1.0)
        assert noticeable(problem, residual) == (name in remains), name
