# SPDX-License-Identifier: Apache-2.0
"""What mends forward selection: claims are exchanged, merged, renamed, started elsewhere, and dropped if they harm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from hydro_diagnosis.closure.admission import without_harmful_names
from hydro_diagnosis.closure.growth import ClosureFit, ForwardSelection, _exchanged
from hydro_diagnosis.closure.screen import Screen, laws
from hydro_diagnosis.closure.selection import closures, merged, renamed, starting_points
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.fit import Fit, fit, noticeable, score
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.selection.verdict import assess
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench

NAMES = {effect.label: effect.adapted(Bench.nominal()) for effect in LIBRARY if effect.named}


def term(equation: str, form: str, **numbers: float) -> dict[str, Any]:
    return {"equation": equation, "form": form, "parameters": numbers}


WEAKER = {"id": "valve_gain", "parameters": {"ratio": 0.94}}
HARDER = {"id": "spring_hardening", "parameters": {"coefficient": 5e6}}
DRY = {"id": "friction_coulomb", "parameters": {"force": 8.0}}
OFFSET = {"id": "valve_offset", "parameters": {"current": 2.5e-4}}
DRAG = term("motion", "quadratic drag", coefficient=900.0)
RING = term("pressure", "leak, since a reversal", coefficient=3e-13, path=5e-4)
RELIEF = term("pressure_a", "relief", coefficient=3.5e-13, threshold=6.3e6)
FORM = "closure:motion:quadratic drag"


def claims(problem: Problem, names: Mapping[str, Mapping[str, float]], *forms: tuple[str, str]) -> list[Claim]:
    """Names and laws to fit from; names without values from their probes."""
    found = [(NAMES[label], values) for label, values in names.items()]
    named = [Claim(one, values or {own.name: own.probes[0] for own in one.parameters}) for one, values in found]
    terms = [closure(grammar.ALL[form], problem.bench) for form in forms]
    return [*named, *(Claim(one, one.nothing()[0]) for one in terms)]


def closed_by(problem: Problem, names: Mapping[str, Mapping[str, float]], *forms: tuple[str, str]) -> ClosureFit:
    """Names and laws fitted to a recording; the laws are screened as a search does it."""
    screen = Screen(problem, fit(problem, claims(problem, names)), laws(problem))
    return ClosureFit(fit(problem, claims(problem, names, *forms), iterations=40), "law", 1.0, problem, screen)


def values_of(found: Fit) -> dict[str, Mapping[str, float]]:
    return {claim.effect.label: claim.values for claim in found.claims}


def test_a_name_is_exchanged_for_one_that_does_as_well_with_fewer_numbers(problem_of: Callable[..., Problem]) -> None:
    """A motor that saturates behind a weaker valve: an overlap that opens softly beside the same law fits as well."""
    problem = problem_of(
        effects=(WEAKER,), closures=(term("actuation", "rounded gain", coefficient=-1.0, level=0.015),)
    )
    law = closure(grammar.ALL["actuation", "rounded gain"], problem.bench)
    overlap = Claim(NAMES["valve_deadband:soft"], {"half_width": 3.7e-4, "softness": 4.4e-3})
    found = fit(problem, [overlap, Claim(law, {"coefficient": -0.9, "level": 0.013})], iterations=24)
    screen = Screen(problem, fit(problem, ()), laws(problem))
    better = _exchanged(problem, found, ForwardSelection(screen), list(NAMES.values()))
    assert not noticeable(problem, found.residual) and score(problem, better) < score(problem, found)
    assert set(values_of(better)) == {"valve_gain", "closure:actuation:rounded gain"}
    assert values_of(better)["valve_gain"]["ratio"] == pytest.approx(0.94, abs=2e-3)


def test_edges_that_pass_less_are_a_weaker_valve(problem_of: Callable[..., Problem]) -> None:
    """A law that does what a cause of the table does gives way to it where several laws stand."""
    problem = problem_of(effects=(WEAKER,), closures=(DRAG,))
    closed = closed_by(problem, {}, ("motion", "quadratic drag"), ("actuation", "narrowed flow"))
    values = values_of(renamed(closed, list(NAMES.values())).fit)
    assert set(values) == {FORM, "valve_gain"}
    assert values["valve_gain"]["ratio"] == pytest.approx(0.94, abs=2e-3)
    assert renamed(closed, [name for name in NAMES.values() if name.id != "valve_gain"]) is closed


def test_laws_that_no_name_does_stay(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(DRAG, RING))
    closed = closed_by(problem, {}, ("motion", "quadratic drag"), ("pressure", "leak, since a reversal"))
    assert renamed(closed, list(NAMES.values())) is closed


def test_friction_and_a_stiffness_that_creeps_are_drag_that_fades(problem_of: Callable[..., Problem]) -> None:
    """c (v - w), w' = (v - w) / T is c v - c / T (x - w), w' = (x - w) / T; another cause stays."""
    problem = problem_of(effects=(HARDER,), closures=(term("motion", "fading drag", coefficient=300.0, time=0.03),))
    names: dict[str, Mapping[str, float]] = {"friction_viscous": {}, "spring_hardening": {}}
    closed = closed_by(problem, names, ("motion", "creeping stiffness"))
    values = values_of(closed.fit)
    assert values["friction_viscous"]["coefficient"] == pytest.approx(300.0, rel=0.03)
    assert values["closure:motion:creeping stiffness"]["coefficient"] == pytest.approx(-300.0 / 0.03, rel=0.03)
    found = values_of(merged(closed).fit)
    assert set(found) == {"spring_hardening", "closure:motion:fading drag"}
    assert found["closure:motion:fading drag"]["coefficient"] == pytest.approx(300.0, rel=0.03)


def test_a_cause_and_a_law_that_are_both_there_stay(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(effects=(DRY,), closures=(DRAG,))
    closed = closed_by(problem, {"friction_coulomb": {}}, ("motion", "quadratic drag"))
    assert merged(closed) is closed


def test_a_cushion_and_a_cell_that_misreads_are_a_second_spring(problem_of: Callable[..., Problem]) -> None:
    """A cell at a spring reads more beyond a force as the load pushes harder beyond a place."""
    problem = problem_of(closures=(term("load", "second spring outwards", coefficient=6000.0, threshold=0.042),))
    closed = closed_by(problem, {"end_cushion:end": {}}, ("sensor", "reading of load_force, above a limit"))
    assert not noticeable(problem, closed.fit.residual)
    (claim,) = merged(closed).fit.claims
    assert claim.effect.label == "closure:load:second spring outwards"
    assert claim.values["coefficient"] == pytest.approx(6000.0, rel=0.02)
    assert claim.values["threshold"] == pytest.approx(0.042, abs=2e-5)


LIKELY = [NAMES[label] for label in ("valve_offset", "valve_gain", "leakage_internal", "leakage_external:a",
                                     "bulk_modulus")]  # fmt: skip


def test_the_name_beside_which_a_law_leaves_nothing_opens(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(RELIEF,), effects=(OFFSET,))
    nothing = fit(problem, ())
    screen = Screen(problem, nothing, laws(problem))
    alone = screen.gains(nothing)[1]
    weighed, first = next(starting_points(problem, nothing, screen, LIKELY, alone))
    assert [claim.effect.label for claim in first.claims] == ["valve_offset"]
    assert noticeable(weighed, first.residual)
    assert not list(starting_points(problem, nothing, screen, LIKELY, 1.0))  # next to nothing is left
    assert not list(starting_points(problem, nothing, Screen(problem, nothing, []), LIKELY, alone))  # no law is shown


def test_name_and_law_are_handed_back_though_the_judgement_claims_no_name(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(RELIEF,), effects=(OFFSET,))
    nothing = fit(problem, ())
    found = next(closures(problem, assess(problem, nothing, nothing), LIKELY))
    values = values_of(found.fit)
    assert set(values) == {"valve_offset", "closure:pressure_a:relief"}
    assert values["valve_offset"]["current"] == pytest.approx(2.5e-4, rel=0.01)
    assert values["closure:pressure_a:relief"]["coefficient"] == pytest.approx(3.5e-13, rel=0.02)
    assert values["closure:pressure_a:relief"]["threshold"] == pytest.approx(6.3e6, rel=0.005)
    assert not noticeable(found.problem, found.fit.residual)


def test_a_law_that_leaves_nothing_alone_gets_no_name(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(closures=(RELIEF,))
    nothing = fit(problem, ())
    found = next(closures(problem, assess(problem, nothing, nothing), LIKELY))
    assert set(values_of(found.fit)) == {"closure:pressure_a:relief"}


def test_a_name_that_the_held_out_recordings_do_not_have_goes(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(effects=(WEAKER,), closures=(DRAG, RING))
    closed = closed_by(problem, {"valve_gain": {"ratio": 0.95}}, ("motion", "quadratic drag"))
    assert noticeable(closed.problem, closed.fit.residual)
    assert without_harmful_names(closed, problem_of(effects=(WEAKER,), closures=(DRAG, RING))) is closed
    assert set(values_of(without_harmful_names(closed, problem_of(closures=(DRAG, RING))).fit)) == {FORM}


def test_where_nothing_remains_all_names_stay(problem_of: Callable[..., Problem]) -> None:
    problem = problem_of(effects=(WEAKER,), closures=(DRAG,))
    closed = closed_by(problem, {"valve_gain": {"ratio": 0.95}}, ("motion", "quadratic drag"))
    assert not noticeable(closed.problem, closed.fit.residual)
    assert without_harmful_names(closed, problem_of(closures=(DRAG,))) is closed
