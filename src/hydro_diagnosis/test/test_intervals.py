# SPDX-License-Identifier: Apache-2.0
"""Intervals of shapes that are nearly one: they hold the truth, and not nothing, which the recordings rule out."""

from __future__ import annotations

from collections.abc import Callable

from hydro_diagnosis.closure.screen import laws
from hydro_diagnosis.effects import Claim
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import all_exclude_neutral, intervals
from hydro_diagnosis.estimation.problem import Problem

PULLS = {
    "force, at a place": {"coefficient": 26.7, "centre": 0.0364, "width": 0.00303},
    "stiffness, at a place": {"coefficient": 6560.0, "centre": 0.0359, "width": 0.00299},
}
"""Two pulls to a place that all but cancel."""


def test_an_interval_holds_no_value_that_the_recordings_rule_out(problem_of: Callable[..., Problem]) -> None:
    closures = tuple({"equation": "motion", "form": form, "parameters": values} for form, values in PULLS.items())
    pulled = problem_of(closures=closures)
    effects = {one.effect.label: one.effect for one in laws(pulled)}
    found = fit(pulled, [Claim(effects[f"closure:motion:{form}"], dict(values)) for form, values in PULLS.items()])
    bounds = intervals(pulled, found)
    assert all_exclude_neutral(found.claims, bounds)
    k = 0
    for claim in found.claims:
        without = fit(pulled, tuple(one for one in found.claims if one is not claim))
        assert without.deviance - found.deviance > 1000.0
        for name, value in PULLS[claim.effect.options["form"]].items():
            assert bounds[k].low < value < bounds[k].high, name
            k += 1
