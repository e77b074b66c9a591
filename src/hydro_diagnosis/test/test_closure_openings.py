# SPDX-License-Identifier: Apache-2.0
"""A name that explains most only beside a law that is missing is found with that law, and none where none is true."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hydro_diagnosis.closure.screen import Screen, laws
from hydro_diagnosis.closure.selection import closures, starting_points
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.estimation.fit import fit, noticeable
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.verdict import assess
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
NAMES = [
    effect.adapted(BENCH)
    for effect in LIBRARY
    if effect.label in ("valve_offset", "valve_gain", "leakage_internal", "leakage_external:a", "bulk_modulus")
]
OFFSET = {"id": "valve_offset", "parameters": {"current": 2.5e-4}}
RELIEF = {"equation": "pressure_a", "form": "relief", "parameters": {"coefficient": 3.5e-13, "threshold": 6.3e6}}
LABEL = "closure:pressure_a:relief"


def test_the_name_beside_which_a_law_leaves_nothing_opens(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(RELIEF,), effects=(OFFSET,))
    nothing = fit(problem, ())
    screen = Screen(problem, nothing, laws(problem))
    alone = screen.gains(nothing)[1]
    weighed, first = next(starting_points(problem, nothing, screen, NAMES, alone))
    assert [claim.effect.label for claim in first.claims] == ["valve_offset"]
    assert noticeable(weighed, first.residual)
    assert (
        list(starting_points(problem, nothing, screen, NAMES, 1.0)) == []
    )  # where next to nothing is left there is no need
    assert (
        list(starting_points(problem, nothing, Screen(problem, nothing, []), NAMES, alone)) == []
    )  # no law can be shown


def test_name_and_law_are_handed_back_though_the_judgement_claims_no_name(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(RELIEF,), effects=(OFFSET,))
    nothing = fit(problem, ())
    found = next(closures(problem, assess(problem, nothing, nothing), NAMES))
    values = {claim.effect.label: claim.values for claim in found.fit.claims}
    assert set(values) == {"valve_offset", LABEL}
    assert values["valve_offset"]["current"] == pytest.approx(2.5e-4, rel=0.01)
    assert values[LABEL]["coefficient"] == pytest.approx(3.5e-13, rel=0.02)
    assert values[LABEL]["threshold"] == pytest.approx(6.3e6, rel=0.005)
    assert not noticeable(found.problem, found.fit.residual)


def test_a_law_that_leaves_nothing_alone_gets_no_name(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(RELIEF,))
    nothing = fit(problem, ())
    found = next(closures(problem, assess(problem, nothing, nothing), NAMES))
    assert [claim.effect.label for claim in found.fit.claims] == [LABEL]
