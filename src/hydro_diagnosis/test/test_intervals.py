# SPDX-License-Identifier: Apache-2.0
"""Intervals of shapes that are nearly one: they hold the truth, and not nothing, which the recordings rule out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.closure.candidates import laws
from hydro_diagnosis.effects import Claim
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import all_hold, intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
PULLS = {
    "force, at a place": {"coefficient": 26.7, "centre": 0.0364, "width": 0.00303},
    "stiffness, at a place": {"coefficient": 6560.0, "centre": 0.0359, "width": 0.00299},
}
"""Two pulls to a place that all but cancel."""


@pytest.fixture(scope="module")
def pulled(record: Callable[..., StateArray]) -> Problem:
    closures = tuple({"equation": "motion", "form": form, "parameters": values} for form, values in PULLS.items())
    states = record(replace(BENCH, closures=closures), 3)
    table = RawTable("run", states["time"].copy(), None, {field: states[field].copy() for field in STATE_FIELDS})
    return Problem([checked(table, BENCH).segments[0]], BENCH)


def test_an_interval_holds_no_value_that_the_recordings_rule_out(pulled: Problem) -> None:
    effects = {one.effect.label: one.effect for one in laws(pulled)}
    found = fit(pulled, [Claim(effects[f"closure:motion:{form}"], dict(values)) for form, values in PULLS.items()])
    bounds = intervals(pulled, found)
    assert all_hold(found.claims, bounds)
    k = 0
    for claim in found.claims:
        without = fit(pulled, tuple(one for one in found.claims if one is not claim))
        assert without.deviance - found.deviance > 1000.0
        for name, value in PULLS[claim.effect.options["form"]].items():
            assert bounds[k].low < value < bounds[k].high, name
            k += 1
