# SPDX-License-Identifier: Apache-2.0
"""Where the search for names ends: beyond six causes it goes on, where names only nibble it stops, and it says why."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.estimation.fit import fit, noticeable
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.outcome import SearchSettings
from hydro_diagnosis.selection.search import Search, removes_little
from hydro_sim.model.bench import Bench

NOMINAL = Bench.nominal()
ADAPTED = [effect.adapted(NOMINAL) for effect in LIBRARY]
WORN = {
    "moving_mass": 1.6,
    "viscous_friction": 90.0,
    "spring_stiffness": 18500.0,
    "spring_rest_position": 0.0405,
    "bulk_modulus": 1.2e9,
    "supply_pressure": 15.2e6,
    "dead_volume_a": 2.2e-4,
    "area_ratio": 0.58,
}


@pytest.fixture(scope="module")
def worn(problem_of: Callable[..., Problem]) -> Problem:
    return problem_of(**WORN)


@pytest.mark.parametrize("settings, why", [({"most": 2}, "2 causes at most"), ({"effort": 150}, "150 evaluations")])
def test_a_search_that_ends_early_says_why(worn: Problem, settings: dict[str, int], why: str) -> None:
    outcome = Search(worn, ADAPTED, SearchSettings(restarts=1, **settings)).run()
    assert why in outcome.cut_short
    assert noticeable(worn, outcome.fit.residual)


@pytest.mark.parametrize("ratio, little", [(0.925, False), (0.9999, True)])
def test_a_claim_nibbles_that_removes_little_where_it_acts(worn: Problem, ratio: float, little: bool) -> None:
    effect = next(one for one in ADAPTED if one.id == "spring_stiffness")
    found = fit(worn, (Claim(effect, {"ratio": ratio}),), iterations=0)
    assert removes_little(worn, fit(worn, ()), found) is little
