# SPDX-License-Identifier: Apache-2.0
"""What has no name is modelled, by what holds on recordings that nothing was fitted to; and only then."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import FloatArray
from hydro_diagnosis import diagnose
from hydro_diagnosis.cli import run
from hydro_diagnosis.closure.evidence import equals_ruled_out, excluded_blocks, has_identified_shapes, held_out_gain
from hydro_diagnosis.closure.screen import Screen
from hydro_diagnosis.closure.selection import ClosureFit, best_closure
from hydro_diagnosis.closure.validation import share_closed
from hydro_diagnosis.effects import CANDIDATES, EffectHypothesis
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.effects.memory import Memory, bristle_force, first_order_lag
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.report.corrected_bench import claims_of, corrected_bench
from hydro_diagnosis.report_json import ClosureReport
from hydro_diagnosis.stages import naming
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import REVERSING_TEXT, Signals, edge_losses, spool_shift_losses
from tests.segments import claim, frame, problem_in, problem_of, record

BENCH = Bench.nominal()
FORMS = grammar.FORMS


def entry(equation: str, form: str, **numbers: float) -> dict[str, Any]:
    return {"equation": equation, "form": form, "parameters": numbers}


def problem_with(*closures: dict[str, Any], ruled_out: tuple[str, ...] = (), effects: tuple[Any, ...] = ()) -> Problem:
    """What one recording of a bench with these closures and effects asks."""
    causes = [effect.adapted(BENCH) for effect in CANDIDATES if effect.label in ruled_out]
    return problem_in(record(replace(BENCH, closures=closures, effects=effects), 3), ruled_out=causes)


def term(equation: str, form: str, **values: float) -> EffectHypothesis:
    return EffectHypothesis(closure(FORMS[equation, form], BENCH), values)


# -- words of the grammar against their closed forms -------------------------------------------------------------------


def test_a_lag_is_that_of_its_differential_equation() -> None:
    step, time = 1e-3, 7e-4
    jumps = np.concatenate([np.zeros(2), np.ones(12), np.full(12, -0.4), np.full(12, -0.3)])
    means = first_order_lag(jumps, step, time, 0.3)
    now = 0.3
    for held, mean in zip(jumps, means, strict=True):
        course = held + (now - held) * np.exp(-np.linspace(0.0, step, 2001) / time)
        assert mean == pytest.approx(np.trapezoid(course, dx=step / 2000) / step, abs=1e-6)
        now = course[-1]


def test_a_path_element_follows_direction_and_distance_alone() -> None:
    back_and_forth = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.5, 20)])
    force = bristle_force(back_and_forth, 10.0, np.ones(70))
    assert force[49] == pytest.approx(1.0 - np.exp(-10.0))
    assert force[-1] == pytest.approx(-1.0 + (force[49] + 1.0) * np.exp(-5.0))
    slow = np.repeat(back_and_forth, 3)
    np.testing.assert_allclose(bristle_force(slow, 10.0, np.ones(210))[2::3], force)


def test_laminar_edges_pass_what_is_proportional_to_a_small_drop_and_the_root_of_a_large_one() -> None:
    """q = K dp / sqrt(|dp| + p_t) in place of K sqrt(dp), at the edge that feeds and at the one that drains."""
    opened, transition = 3e-8, 5e5
    p_a, p_b = np.array([1e6, 15.9e6]), np.array([2e5, 8e6])
    law = FORMS["actuation", "laminar edges"]
    lost_a, lost_b = edge_losses(BENCH, (opened, 0.0), (p_a, p_b), lambda at: law.value(at, BENCH, [1.0, transition]))
    fed, drained = BENCH.supply_pressure - p_a, p_b - BENCH.tank_pressure
    np.testing.assert_allclose(opened * np.sqrt(fed) - lost_a, opened * fed / np.sqrt(fed + transition), rtol=1e-3)
    left = -opened * np.sqrt(drained) - lost_b
    np.testing.assert_allclose(left, -opened * drained / np.sqrt(drained + transition), rtol=1e-3)


def test_a_law_reverses_over_a_millimetre_a_second_or_over_its_own_number() -> None:
    at = Signals(velocity=np.array([-0.05, -5e-3, 0.0, 1e-3, 5e-3]), pressure_a=6e6, pressure_b=5e6)
    plain = FORMS["motion", "friction by pressure of A"].value(at, BENCH, [1e-6])
    np.testing.assert_allclose(plain, 6.0 * np.tanh(at.velocity / 1e-3))
    own = FORMS["motion", f"friction by pressure of A, {REVERSING_TEXT}"].value(at, BENCH, [1e-6, 5e-3])
    np.testing.assert_allclose(own, 6.0 * np.tanh(at.velocity / 5e-3))
    film = FORMS["load", f"local rubbing along the stroke, {REVERSING_TEXT}"]
    assert film.names == ("coefficient", "centre", "width", "turn")
    there = film.value(replace(at, position=0.04), BENCH, [8.0, 0.03, 0.01, 5e-3])
    np.testing.assert_allclose(there, 8.0 * np.exp(-1.0) * np.tanh(at.velocity / 5e-3))


def test_a_spool_that_is_shifted_changes_the_flow_by_its_gain_even_across_null() -> None:
    p_a, p_b, gain = 5e6, 6e6, BENCH.constants()[0]["valve_gain"]
    lost_a, lost_b = spool_shift_losses(BENCH, np.array([2e-3, 1e-4]), np.array([1e-4, -3e-4]), (p_a, p_b))
    out, back = np.sqrt(BENCH.supply_pressure - p_a), np.sqrt(p_a - BENCH.tank_pressure)
    np.testing.assert_allclose(lost_a, [-gain * 1e-4 * out, gain * (1e-4 * out + 2e-4 * back)], rtol=1e-3)
    assert lost_b[0] > 0.0 > lost_b[1]


PRESSURE, POSITION = np.linspace(1e5, 1.5e7, 50), 0.04 + 5e-3 * np.sin(np.arange(3000) / 200.0)


@pytest.mark.parametrize(
    ("sensor", "form", "values", "signal", "allowed"),
    [
        ("pressure_b", "rising reading", {"coefficient": -0.95, "threshold": 1e7}, PRESSURE, 2e4),  # little slope left
        ("pressure_a", "even quadratic reading", {"coefficient": 4e-9}, PRESSURE, 1.0),
        ("piston_position", "hysteresis", {"coefficient": -8e-5, "path": 3e-4}, POSITION, 1e-6),
    ],
)
def test_the_error_of_a_sensor_is_undone_and_another_sensor_s_reading_left_alone(
    sensor: str, form: str, values: dict[str, float], signal: FloatArray, allowed: float
) -> None:
    effect = closure(FORMS["sensor", f"{form} of {sensor}"], BENCH)
    reading = effect.read_sensor(sensor, signal, Memory(1e-3), values)
    assert np.max(np.abs(reading - signal)) > 50.0 * allowed
    found = effect.invert_reading(sensor, reading, Memory(1e-3), values)
    np.testing.assert_allclose(found, signal, rtol=0, atol=allowed)
    assert effect.invert_reading("load_force", reading, Memory(1e-3), values) is reading


# -- laws that are found -----------------------------------------------------------------------------------------------

FOUND = [
    ("load", "hysteresis", {"coefficient": 9.0, "path": 2e-3}, 0.1),
    ("sensor", "even quadratic reading of pressure_a", {"coefficient": 2e-9}, 0.1),
    ("actuation", "null by past opening of the valve", {"coefficient": 0.1, "time": 3.0}, 0.05),
    ("motion", "creeping stiffness", {"coefficient": 2000.0, "time": 0.2}, 0.05),
    ("motion", "absolute drag by pressure difference", {"coefficient": 6e-5}, 0.05),
    ("pressure", "local leak along the stroke", {"coefficient": 3e-13, "centre": 0.0385, "width": 3e-3}, 0.1),
    ("load", "saturating spring", {"coefficient": 4000.0, "level": 6e-3}, 0.05),
    ("pressure_b", "positive leak of B by velocity", {"coefficient": 8e-14}, 0.1),
]
"""Laws of each kind: every other in `make test`, all in `make test-slow`."""


@pytest.mark.parametrize(
    ("equation", "form", "numbers", "tolerance"),
    [pytest.param(*one, marks=[pytest.mark.study] if k % 2 else []) for k, one in enumerate(FOUND)],
)
def test_a_law_is_found_with_all_of_its_numbers(
    equation: str, form: str, numbers: dict[str, float], tolerance: float
) -> None:
    problem = problem_with(entry(equation, form, **numbers))
    found = best_closure(problem, fit(problem, ()))
    assert found is not None
    assert [one.effect.label for one in found.fit.claims] == [f"closure:{equation}:{form}"]
    assert not problem.has_excess(found.fit.residual)
    for bound, value in zip(intervals(problem, found.fit), numbers.values(), strict=True):
        assert bound.value == pytest.approx(value, rel=tolerance, abs=0.0)


RELIEF = entry("pressure_a", "rising leak of A", coefficient=3.5e-13, threshold=6.3e6)
OFFSET = {"id": "valve_offset", "parameters": {"current": 2.5e-4}}
DRAG = entry("motion", "quadratic drag", coefficient=600.0)
DRY = {"id": "friction_coulomb", "parameters": {"force": 8.0}}
LEAK = {"coefficient": pytest.approx(3.5e-13, rel=0.02, abs=0.0), "threshold": pytest.approx(6.3e6, rel=0.005)}
FLOWS = ("valve_offset", "valve_gain", "leakage_internal", "leakage_external:a", "bulk_modulus")
FORCES = ("friction_viscous", "friction_coulomb", "moving_mass")


@pytest.mark.parametrize(
    ("closure", "effects", "likely", "wanted"),
    [
        pytest.param(RELIEF, (OFFSET,), FLOWS, {"closure:pressure_a:rising leak of A": LEAK, "valve_offset":
                     {"current": pytest.approx(2.5e-4, rel=0.01)}}, marks=pytest.mark.study),
        (RELIEF, (), FLOWS, {"closure:pressure_a:rising leak of A": LEAK}),
        (DRAG, (DRY,), FORCES, {"closure:motion:quadratic drag": {"coefficient": pytest.approx(600.0, rel=0.02)},
                                "friction_coulomb": {"force": pytest.approx(8.0, rel=0.05)}}),
    ],
)  # fmt: skip
def test_a_name_that_the_judgement_does_not_claim_is_found_beside_a_law_where_there_is_one(
    closure: dict[str, Any], effects: tuple[Any, ...], likely: tuple[str, ...], wanted: dict[str, Any]
) -> None:
    problem = problem_with(closure, effects=effects)
    names = [effect.adapted(BENCH) for effect in CANDIDATES if effect.label in likely]
    found = best_closure(problem, fit(problem, ()), names)
    assert found is not None
    assert {one.effect.label: dict(one.values) for one in found.fit.claims} == wanted
    assert not found.problem.has_excess(found.fit.residual)
    if effects == (DRY,):  # which leaves its sign in doubt: there, not in the judgement
        assert problem.uncertainty != found.problem.uncertainty


def test_what_a_formula_read_off_a_smooth_function_promises_is_what_it_gains() -> None:
    """The splines' sum stands for the law's own responses, to first order."""
    problem = problem_with(entry("motion", "quadratic drag", coefficient=800.0))
    nothing = fit(problem, ())
    (best,), _ = Screen(problem, nothing).best_laws(nothing, 1)
    assert best.effect.label == "closure:motion:quadratic drag"
    assert best.gain == pytest.approx(held_out_gain(problem, nothing, fit(problem, best.starts)), rel=0.1)


# -- evidence that a term must show ------------------------------------------------------------------------------------


def held(**errors: float) -> dict[str, object]:
    return {"holdout": {name: {"rmse_after": one, "noise_floor": 1.0} for name, one in errors.items()}}


@pytest.mark.parametrize(("after", "share"), [(1.0, 1.0), (5.0, 0.75), (10.0, 0.0), (20.0, -3.0)])
def test_the_share_closed_is_that_of_the_squared_error_above_the_noise(after: float, share: float) -> None:
    assert share_closed(held(a=10.0, b=0.9), held(a=after, b=0.9)) == pytest.approx(share, abs=0.05)


@pytest.mark.parametrize("later", [10.0, 20.0, float("nan")])
def test_a_law_that_does_not_improve_the_simulation_of_held_out_data_is_refused(
    problem: Problem, monkeypatch: pytest.MonkeyPatch, later: float
) -> None:
    base = fit(problem, ())
    names: Any = SimpleNamespace(problem=problem, holdout=problem, holdout_report=held(a=10.0), simulations={},
                                 assessment=SimpleNamespace(fit=base))  # fmt: skip
    monkeypatch.setattr(naming, "best_closure", lambda *_: ClosureFit(base, 1.0, problem))
    monkeypatch.setattr(naming, "errors_with_closure", lambda *_: held(a=later))
    assert naming._with_laws(names, []) is None


def test_a_number_that_no_sample_shows_is_not_known(problem: Problem) -> None:
    """Of which not even the square of a slope is left."""
    found = fit(problem, [term("actuation", "late share", coefficient=0.05, time=0.1)], iterations=0)
    place = [one.name for one in found.claims[0].effect.parameters].index("time")
    for size in (0.0, 1e-170):
        found.jacobian[:, place] = size * np.sign(found.jacobian[:, 0])
        assert not has_identified_shapes(problem, found, found.claims[0])
        assert np.isfinite(held_out_gain(problem, found, found))


def test_a_law_that_is_a_name_in_disguise_is_not_definite() -> None:
    """Friction that settles in no time is dry friction."""
    problem = problem_with(effects=(DRY,))
    settling = term("motion", "friction from the start", coefficient=8.0, time=0.5)
    for one, definite in ((settling, False), (claim("friction_coulomb", 8.0), True)):
        found = fit(problem, [one], iterations=24)
        assert has_identified_shapes(problem, found, found.claims[0]) == definite


def test_no_law_does_what_a_ruled_out_cause_would_do() -> None:
    """Drag in one direction alone is friction that depends on the direction; a leak or quadratic drag is not."""
    directional, one_way = "friction_viscous:directional", {"coefficient": 150.0, "threshold": 0.0}
    viscous = claim("friction_viscous", 50.0)
    for ruled_out, same in ((), False), ((directional,), True), (("leakage_internal",), False):
        problem = problem_with(entry("motion", "rising uneven drag", **one_way), ruled_out=ruled_out)
        drag = fit(problem, [term("motion", "rising uneven drag", **one_way)])
        assert equals_ruled_out(problem, drag, drag.claims[0]) == same
        assert excluded_blocks(problem, fit(problem, [viscous])) == ({"motion"} if same else set())
    squared = entry("motion", "quadratic drag", coefficient=800.0)
    problem = problem_with(squared, ruled_out=(directional, "leakage_internal"))
    assert excluded_blocks(problem, fit(problem, [viscous])) == set()


def test_an_interval_holds_no_value_that_the_recordings_rule_out() -> None:
    """Of two pulls that all but cancel."""
    sizes = {"stiffness": {"coefficient": -3200.0}, "saturating stiffness": {"coefficient": 4000.0, "level": 0.012}}
    problem = problem_of(closures=tuple(entry("motion", form, **values) for form, values in sizes.items()))
    found = fit(problem, [term("motion", form, **values) for form, values in sizes.items()])
    bounds = intervals(problem, found)
    assert not any(bound.low <= 0.0 <= bound.high for bound in bounds)
    for bound, value in zip(bounds, (-3200.0, 4000.0, 0.012), strict=True):
        assert bound.low < value < bound.high
    for pull in found.claims:
        assert fit(problem, found.claims_without(pull)).deviance - found.deviance > 1000.0


def test_a_diagnosis_models_what_has_no_name_and_its_corrected_bench_is_the_bench(tmp_path: Path) -> None:
    truth = replace(BENCH, closures=(entry("motion", "quadratic drag", coefficient=400.0),))
    files = [tmp_path / f"{seed}.csv" for seed in (1, 2, 3)]
    for seed, file in enumerate(files, 1):
        frame(record(truth, seed)).to_csv(file, index=False)
    assert run([*(str(file) for file in files), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == "modelled" and report["effects"] == []
    (term,) = report["closures"]
    assert (term["equation"], term["form"]) == ("motion", "law") and term["share_closed"] > 0.95
    low, high = term["terms"]["coefficient"]["ci95"]
    assert low <= 400.0 <= high and term["terms"]["coefficient"]["unit"] == "N s2/m2"
    position = report["fit"]["holdout"]["piston_position"]
    assert position["rmse_after"] < 1.1 * position["noise_floor"]
    assert position["rmse_named"] > 2.0 * position["rmse_after"]
    corrected = Bench.load(tmp_path / "out" / "corrected.yaml")
    assert corrected.closures[0]["form"] == "quadratic drag" and corrected.digest != BENCH.digest
    again = diagnose([files[2]], bench=corrected)
    assert again.report.verdict == "no_mismatch"
    twice = replace(again, report=replace(again.report, closures=[ClosureReport(**term)] * 2))
    assert str(twice).lower().count("close") == 1, "what all terms close together is said once"


def test_law_of_a_heavy_machine_is_written_and_read_again() -> None:
    """Weight of a boom of 115 kN, over its stroke."""
    effect = closure(grammar.FORMS["motion", "table over position"], BENCH, (0.3, 0.45))
    values = {one.name: 1.15e5 for one in effect.parameters}
    heavy = corrected_bench(BENCH, [EffectHypothesis(effect, values)])
    (again,) = claims_of(Bench.from_mapping(heavy.to_mapping()))
    assert dict(again.values) == values
