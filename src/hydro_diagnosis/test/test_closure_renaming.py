# SPDX-License-Identifier: Apache-2.0
"""A law that does what a cause of the table does gives way to it where several laws stand; others stay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.closure.growth import Closed
from hydro_diagnosis.closure.renaming import renamed
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 900.0}}
NAMES = [effect.adapted(BENCH) for effect in LIBRARY if effect.named]


def closed_by(states: StateArray, *forms: tuple[str, str]) -> Closed:
    """Laws fitted to a recording."""
    table = RawTable("run", states["time"].copy(), None, {field: states[field].copy() for field in STATE_FIELDS})
    problem = Problem([checked(table, BENCH).segments[0]], BENCH)
    laws = [closure(grammar.ALL[form], BENCH) for form in forms]
    found = fit(problem, [Claim(law, law.nothing()[0]) for law in laws])
    return Closed(found, "law", 1.0, problem)


def test_edges_that_pass_less_are_a_weaker_valve(record: Callable[..., StateArray]) -> None:
    weaker = {"id": "valve_gain", "parameters": {"ratio": 0.94}}
    states = record(replace(BENCH, effects=(weaker,), closures=(DRAG,)), 3)
    closed = closed_by(states, ("motion", "quadratic drag"), ("actuation", "narrowed flow"))
    found = renamed(closed, NAMES).fit
    assert {claim.effect.label for claim in found.claims} == {"closure:motion:quadratic drag", "valve_gain"}
    values = {claim.effect.label: claim.values for claim in found.claims}
    assert values["valve_gain"]["ratio"] == pytest.approx(0.94, abs=2e-3)
    alone = renamed(closed, [name for name in NAMES if name.id != "valve_gain"])
    assert alone is closed


def test_laws_that_no_name_does_stay(record: Callable[..., StateArray]) -> None:
    ring = {
        "equation": "pressure",
        "form": "leak, since a reversal",
        "parameters": {"coefficient": 3e-13, "path": 5e-4},
    }
    states = record(replace(BENCH, closures=(DRAG, ring)), 3)
    closed = closed_by(states, ("motion", "quadratic drag"), ("pressure", "leak, since a reversal"))
    assert renamed(closed, NAMES) is closed
