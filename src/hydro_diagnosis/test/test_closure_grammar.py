# SPDX-License-Identifier: Apache-2.0
"""The grammar's words hold their closed forms, and each kind of law is found with all of its numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import StateArray
from hydro_diagnosis.closure.evidence import barred_equations, equals_ruled_out, has_identified_shapes, held_out_gain
from hydro_diagnosis.closure.screen import Screen
from hydro_diagnosis.closure.selection import closures
from hydro_diagnosis.effects import CANDIDATES, Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.effects.memory import Memory, bristle_force, held_lag
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import REVERSING, Law, Signals, edge_losses, spool_shift_losses
from tests.segments import claim, problem_in, record

BENCH = Bench.nominal()


def law(equation: str, form: str) -> Law:
    found = grammar.FORMS[equation, form]
    assert isinstance(found, Law)
    return found


def problem_of(states: StateArray, *ruled_out: str) -> Problem:
    causes = [effect.adapted(BENCH) for effect in CANDIDATES if effect.label in ruled_out]
    return problem_in(states, ruled_out=causes)


STEP, TIME = 1e-3, 7e-4
JUMPS = np.concatenate([np.zeros(2), np.ones(12), np.full(12, -0.4), np.full(12, -0.3)])


def test_a_lag_is_that_of_its_differential_equation() -> None:
    begins, means = held_lag(JUMPS, STEP, TIME, 0.3)
    now = 0.3
    for held, begin, mean in zip(JUMPS, begins, means, strict=True):
        course = held + (now - held) * np.exp(-np.linspace(0.0, STEP, 2001) / TIME)
        assert (begin, mean) == pytest.approx((now, np.trapezoid(course, dx=STEP / 2000) / STEP), abs=1e-6)
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
    effect = law("actuation", "laminar edges")
    lost_a, lost_b = edge_losses(
        BENCH, (opened, 0.0), (p_a, p_b), lambda at: effect.value(at, BENCH, [1.0, transition])
    )
    fed, drained = BENCH.supply_pressure - p_a, p_b - BENCH.tank_pressure
    np.testing.assert_allclose(opened * np.sqrt(fed) - lost_a, opened * fed / np.sqrt(fed + transition), rtol=1e-3)
    left = -opened * np.sqrt(drained) - lost_b
    np.testing.assert_allclose(left, -opened * drained / np.sqrt(drained + transition), rtol=1e-3)


def test_a_law_reverses_over_a_millimetre_a_second_or_over_its_own_number() -> None:
    at = Signals(velocity=np.array([-0.05, -5e-3, 0.0, 1e-3, 5e-3]), pressure_a=6e6, pressure_b=5e6)
    plain, own = law("motion", "friction by pressure of A"), law("motion", f"friction by pressure of A, {REVERSING}")
    np.testing.assert_allclose(plain.value(at, BENCH, [1e-6]), 6.0 * np.tanh(at.velocity / 1e-3))
    np.testing.assert_allclose(own.value(at, BENCH, [1e-6, 5e-3]), 6.0 * np.tanh(at.velocity / 5e-3))
    film = law("load", f"local rubbing along the stroke, {REVERSING}")
    assert film.names == ("coefficient", "centre", "width", "turn")
    there = film.value(replace(at, position=0.04), BENCH, [8.0, 0.03, 0.01, 5e-3])
    np.testing.assert_allclose(there, 8.0 * np.exp(-1.0) * np.tanh(at.velocity / 5e-3))


def test_a_spool_that_is_shifted_changes_the_flow_by_its_gain_even_across_null() -> None:
    p_a, p_b, gain = 5e6, 6e6, BENCH.constants()[0]["valve_gain"]
    lost_a, lost_b = spool_shift_losses(BENCH, np.array([2e-3, 1e-4]), np.array([1e-4, -3e-4]), (p_a, p_b))
    out, back = np.sqrt(BENCH.supply_pressure - p_a), np.sqrt(p_a - BENCH.tank_pressure)
    np.testing.assert_allclose(lost_a, [-gain * 1e-4 * out, gain * (1e-4 * out + 2e-4 * back)], rtol=1e-3)
    assert lost_b[0] > 0.0 > lost_b[1]


def test_a_gauge_that_saturates_or_is_curved_is_undone() -> None:
    """Also where little of its slope is left; another sensor's reading is left alone."""
    pressure, memory = np.linspace(1e5, 1.5e7, 50), Memory(1e-3)
    for sensor, form, values, allowed in (
        ("pressure_b", "rising reading of pressure_b", {"coefficient": -0.95, "threshold": 1e7}, 2e4),
        ("pressure_a", "even quadratic reading of pressure_a", {"coefficient": 4e-9}, 1.0),
    ):
        effect = closure(law("sensor", form), BENCH)
        reading = effect.read_sensor(sensor, pressure, memory, values)
        np.testing.assert_allclose(
            effect.invert_reading(sensor, reading, memory, values), pressure, rtol=0, atol=allowed
        )
        assert effect.invert_reading("piston_position", reading, memory, values) is reading


def test_a_position_with_play_is_undone() -> None:
    effect = closure(law("sensor", "hysteresis of piston_position"), BENCH)
    position = 0.04 + 5e-3 * np.sin(np.arange(3000) / 200.0)
    values = {"coefficient": -8e-5, "path": 3e-4}
    reading = effect.read_sensor("piston_position", position, Memory(1e-3), values)
    found = effect.invert_reading("piston_position", reading, Memory(1e-3), values)
    assert np.max(np.abs(found - position)) < 1e-6 < 5e-5 < np.max(np.abs(reading - position))


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
    truth = replace(BENCH, closures=({"equation": equation, "form": form, "parameters": numbers},))
    problem = problem_of(record(truth, 3))
    nothing = fit(problem, ())
    found = next(closures(problem, nothing))
    assert [one.effect.label for one in found.fit.claims] == [f"closure:{equation}:{form}"]
    assert not problem.noticeable(found.fit.residual)
    for bound, value in zip(intervals(problem, found.fit), numbers.values(), strict=True):
        assert bound.value == pytest.approx(value, rel=tolerance)


def test_what_a_formula_read_off_a_smooth_function_promises_is_what_it_gains() -> None:
    """The splines' sum stands for the law's own responses, to first order."""
    drag = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 800.0}}
    problem = problem_of(record(replace(BENCH, closures=(drag,)), 3))
    nothing = fit(problem, ())
    (best,), _ = Screen(problem, nothing).prospects(nothing, 1)
    assert best.effect.label == "closure:motion:quadratic drag"
    assert best.gain == pytest.approx(held_out_gain(problem, nothing, fit(problem, best.starts)), rel=0.1)


def test_a_number_that_no_sample_shows_is_not_known() -> None:
    """Of which not even the square of a slope is left."""
    problem = problem_of(record(BENCH, 3))
    late = closure(law("actuation", "late share"), BENCH)
    found = fit(problem, [Claim(late, {"coefficient": 0.05, "time": 0.1})], iterations=0)
    place = [one.name for one in late.parameters].index("time")
    for size in (0.0, 1e-170):
        found.jacobian[:, place] = size * np.sign(found.jacobian[:, 0])
        assert not has_identified_shapes(problem, found, found.claims[0])
        assert np.isfinite(held_out_gain(problem, found, found))


def test_a_law_that_is_a_name_in_disguise_is_not_definite() -> None:
    """Friction that settles in no time is dry friction."""
    dry = {"id": "friction_coulomb", "parameters": {"force": 8.0}}
    problem = problem_of(record(replace(BENCH, effects=(dry,)), 3))
    settling = closure(law("motion", "friction from the start"), BENCH)
    disguised = fit(problem, [Claim(settling, {"coefficient": 8.0, "time": 0.5})], iterations=24)
    assert not has_identified_shapes(problem, disguised, disguised.claims[0])
    named = fit(problem, [claim("friction_coulomb", 8.0)])
    assert has_identified_shapes(problem, named, named.claims[0])


ONE_WAY = {"coefficient": 150.0, "threshold": 0.0}


def test_no_law_does_what_a_ruled_out_cause_would_do() -> None:
    """Drag in one direction alone is friction that depends on the direction; a leak or quadratic drag is not."""
    one_way, squared = (
        record(replace(BENCH, closures=({"equation": "motion", "form": form, "parameters": numbers},)), 3)
        for form, numbers in (("rising uneven drag", ONE_WAY), ("quadratic drag", {"coefficient": 800.0}))
    )
    problem, directional = problem_of(one_way), "friction_viscous:directional"
    viscous = fit(problem, [claim("friction_viscous", 50.0)])
    drag = fit(problem, [Claim(closure(law("motion", "rising uneven drag"), BENCH), ONE_WAY)])
    for ruled_out, same in ((), False), ((directional,), True), (("leakage_internal",), False):
        asked = problem_of(one_way, *ruled_out)
        assert equals_ruled_out(asked, drag, drag.claims[0]) == same
        assert barred_equations(asked, viscous) == ({"motion"} if same else set())
    other = problem_of(squared, directional, "leakage_internal")
    assert barred_equations(other, fit(other, [claim("friction_viscous", 50.0)])) == set()
