# SPDX-License-Identifier: Apache-2.0
"""One law takes the place of a name and a law that together do what it does alone; what is needed stays."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hydro_diagnosis.closure.growth import ClosureFit
from hydro_diagnosis.closure.screen import Screen, laws
from hydro_diagnosis.closure.selection import merged
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_diagnosis.estimation.fit import fit, noticeable
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench

FADING = {"equation": "motion", "form": "fading drag", "parameters": {"coefficient": 300.0, "time": 0.03}}
HARDER = {"id": "spring_hardening", "parameters": {"coefficient": 5e6}}
DRY = {"id": "friction_coulomb", "parameters": {"force": 8.0}}
DRAG = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 900.0}}


def closed_by(problem: Problem, names: list[str], *forms: str, equation: str = "motion") -> ClosureFit:
    """Names and laws of an equation fitted to a recording; the laws are screened as a search does it."""
    found = [effect.adapted(Bench.nominal()) for effect in LIBRARY if effect.label in names]
    terms: list[Closure] = [closure(grammar.ALL[equation, form], problem.bench) for form in forms]
    claims = [Claim(name, {one.name: one.probes[0] for one in name.parameters}) for name in found]
    screen = Screen(problem, fit(problem, claims), laws(problem))
    claims += [Claim(term, term.nothing()[0]) for term in terms]
    return ClosureFit(fit(problem, claims, iterations=40), "law", 1.0, problem, screen)


def test_friction_and_a_stiffness_that_creeps_are_drag_that_fades(problem_of: Callable[..., Problem]) -> None:
    """c (v - w), w' = (v - w) / T is c v - c / T (x - w), w' = (x - w) / T; another cause stays."""
    problem = problem_of(effects=(HARDER,), closures=(FADING,))
    closed = closed_by(problem, ["spring_hardening", "friction_viscous"], "creeping stiffness")
    values = {claim.effect.label: claim.values for claim in closed.fit.claims}
    apart = -300.0 / 0.03
    assert values["friction_viscous"]["coefficient"] == pytest.approx(300.0, rel=0.03)
    assert values["closure:motion:creeping stiffness"]["coefficient"] == pytest.approx(apart, rel=0.03)
    found = {claim.effect.label: claim.values for claim in merged(closed).fit.claims}
    assert set(found) == {"spring_hardening", "closure:motion:fading drag"}
    assert found["closure:motion:fading drag"]["coefficient"] == pytest.approx(300.0, rel=0.03)


def test_a_cause_and_a_law_that_are_both_there_stay(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(effects=(DRY,), closures=(DRAG,))
    closed = closed_by(problem, ["friction_coulomb"], "quadratic drag")
    assert merged(closed) is closed


def test_a_cushion_and_a_cell_that_misreads_are_a_second_spring(problem_of: Callable[..., Problem]) -> None:
    """A cell at a spring reads more beyond a force as the load pushes harder beyond a place."""
    second = {
        "equation": "load",
        "form": "second spring outwards",
        "parameters": {"coefficient": 6000.0, "threshold": 0.042},
    }
    problem = problem_of(closures=(second,))
    closed = closed_by(problem, ["end_cushion:end"], "reading of load_force, above a limit", equation="sensor")
    assert not noticeable(problem, closed.fit.residual)
    (claim,) = merged(closed).fit.claims
    assert claim.effect.label == "closure:load:second spring outwards"
    assert claim.values["coefficient"] == pytest.approx(6000.0, rel=0.02)
    assert claim.values["threshold"] == pytest.approx(0.042, abs=2e-5)
