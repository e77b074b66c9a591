# SPDX-License-Identifier: Apache-2.0
"""Where the search for names ends: beyond six causes it goes on, where names only nibble it stops, and it says why."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hydro_diagnosis.cli import run
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.estimation.budget import Budget
from hydro_diagnosis.estimation.fit import noticeable
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.outcome import SearchSettings
from hydro_diagnosis.selection.search import Search
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
def problem(problem_of: Callable[..., Problem]) -> Problem:
    return problem_of(**WORN)


@pytest.mark.parametrize("settings, why", [({"most": 2}, "2 causes at most"), ({"effort": 150}, "150 evaluations")])
def test_a_search_that_ends_early_says_why(problem: Problem, settings: dict[str, int], why: str) -> None:
    outcome = Search(problem, ADAPTED, SearchSettings(restarts=1, **settings)).run()
    assert why in outcome.cut_short
    assert noticeable(problem, outcome.fit.residual)


def test_budget_of_work_ends_it_with_the_best_answer_so_far(worn: list[Path], tmp_path: Path) -> None:
    """Counted, not timed: twice the same. The soft spring is found by then, or is not, and the report is whole."""
    reports = []
    for k in range(2):
        words = [*map(str, worn[:2]), "--holdout", str(worn[2]), "--quiet", "--seconds", "0.05"]
        assert run([*words, "--out", str(tmp_path / str(k))]) == 0
        report: dict[str, Any] = json.loads((tmp_path / str(k) / "report.json").read_text())
        assert report.pop("seconds") > 0.0
        reports.append(report)
    assert reports[0] == reports[1]
    assert any("budget of work (0.05 s" in note for note in reports[0]["data_quality"])
    assert reports[0]["verdict"] in ("explained", "partly_explained", "unknown")


def test_budget_grows_with_what_is_recorded_unless_it_is_chosen() -> None:
    budgets = [Budget(), Budget(), Budget(5.0)]
    for budget, samples in zip(budgets, (20_000, 600_000, 600_000), strict=True):
        budget.allow(samples)
    assert [budget.seconds for budget in budgets] == [60.0, 600.0, 5.0]
