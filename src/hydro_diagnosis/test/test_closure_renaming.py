# SPDX-License-Identifier: Apache-2.0
"""A law that does what a cause of the table does gives way to it where several laws stand; others stay."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hydro_diagnosis.closure.growth import ClosureFit
from hydro_diagnosis.closure.selection import renamed
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench

NAMES = [effect.adapted(Bench.nominal()) for effect in LIBRARY if effect.named]
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 900.0}}
RING = {"equation": "pressure", "form": "leak, since a reversal", "parameters": {"coefficient": 3e-13, "path": 5e-4}}
WEAKER = {"id": "valve_gain", "parameters": {"ratio": 0.94}}


def closed_by(problem: Problem, *forms: tuple[str, str]) -> ClosureFit:
    """Laws fitted to a recording."""
    laws = [closure(grammar.ALL[form], problem.bench) for form in forms]
    return ClosureFit(fit(problem, [Claim(law, law.nothing()[0]) for law in laws]), "law", 1.0, problem)


def test_edges_that_pass_less_are_a_weaker_valve(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(effects=(WEAKER,), closures=(DRAG,))
    closed = closed_by(problem, ("motion", "quadratic drag"), ("actuation", "narrowed flow"))
    found = renamed(closed, NAMES).fit
    values = {claim.effect.label: claim.values for claim in found.claims}
    assert set(values) == {"closure:motion:quadratic drag", "valve_gain"}
    assert values["valve_gain"]["ratio"] == pytest.approx(0.94, abs=2e-3)
    assert renamed(closed, [name for name in NAMES if name.id != "valve_gain"]) is closed


def test_laws_that_no_name_does_stay(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(DRAG, RING))
    closed = closed_by(problem, ("motion", "quadratic drag"), ("pressure", "leak, since a reversal"))
    assert renamed(closed, NAMES) is closed
