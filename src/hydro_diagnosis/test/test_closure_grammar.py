# SPDX-License-Identifier: Apache-2.0
"""The grammar's words hold their closed forms, and each kind of law is found with all of its numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import FloatArray, StateArray
from hydro_diagnosis.closure.evidence import barred_equations, equals_ruled_out, has_identified_shapes, held_out_gain
from hydro_diagnosis.closure.model_selection import closures
from hydro_diagnosis.effects import CANDIDATES, Claim
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.effects.kernels import along, held_lag, limited
from hydro_diagnosis.effects.memory import Memory
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import REVERSING, Law, Signals, edge_losses, shifted
from tests.segments import claim, problem_in, record

BENCH = Bench.nominal()


def law(equation: str, form: str) -> Law:
    found = grammar.ALL[equation, form]
    assert isinstance(found, Law)
    return found


def problem_of(states: StateArray, *ruled_out: str) -> Problem:
    causes = [effect.adapted(BENCH) for effect in CANDIDATES if effect.label in ruled_out]
    return problem_in(states, ruled_out=causes)


def integrated(signal: FloatArray, now: float, rate: float) -> FloatArray:
    """A lag of two times and a largest rate in small steps: the begin of each sample and its mean, shape (n, 2)."""
    course = np.empty((len(signal), 4000))
    for k, held in enumerate(signal):
        for part in range(course.shape[1]):
            time = RISING if held > now else FALLING
            now += STEP / course.shape[1] * min(max((held - now) / time, -rate), rate)
            course[k, part] = now
    return np.column_stack([course[:, 0], course.mean(axis=1)])


STEP, RISING, FALLING = 1e-3, 7e-4, 2e-3
JUMPS = np.concatenate([np.zeros(2), np.ones(12), np.full(12, -0.4), np.full(12, -0.3)])


def test_lags_are_those_of_their_differential_equations() -> None:
    found = limited(JUMPS, STEP, 300.0, RISING, FALLING)
    np.testing.assert_allclose(found, integrated(JUMPS, 0.0, 300.0)[:, 1], atol=2e-4)
    slow = limited(JUMPS, STEP, 1e6, RISING, FALLING)  # no limit: an exponential
    assert slow[2] == pytest.approx(1.0 - RISING / STEP * (1.0 - np.exp(-STEP / RISING)))
    held = np.column_stack(held_lag(JUMPS, STEP, RISING, 0.3, FALLING))
    np.testing.assert_allclose(held, integrated(JUMPS, 0.3, np.inf), atol=4e-4)


def test_a_path_element_follows_direction_and_distance_alone() -> None:
    back_and_forth = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.5, 20)])
    force = along(back_and_forth, 10.0, np.ones(70))
    assert force[49] == pytest.approx(1.0 - np.exp(-10.0))
    assert force[-1] == pytest.approx(-1.0 + (force[49] + 1.0) * np.exp(-5.0))
    slow = np.repeat(back_and_forth, 3)
    np.testing.assert_allclose(along(slow, 10.0, np.ones(210))[2::3], force)


def test_a_pocket_takes_what_its_pressure_rises_by_and_gives_it_back() -> None:
    """Flow is the rate of what follows the pressure, so that over a rise and a fall nothing is lost."""
    effect, step = closure(law("pressure_a", "pocket"), BENCH), 1e-3
    pressure = 5e6 + 1e6 * np.concatenate([np.zeros(10), np.ones(400), np.zeros(6000)])
    values = {"coefficient": 2e-14, "rising": 0.02, "falling": 0.3}
    flow = effect.given(effect._remembering(Signals(pressure_a=pressure), Memory(step), values), values)
    taken = step * np.cumsum(flow)
    assert taken[409] == pytest.approx(2e-14 * 1e6, rel=1e-6)
    assert taken[-1] == pytest.approx(0.0, abs=1e-15)


def test_what_motion_warms_begins_cold_and_settles_at_speed_times_time_over_path() -> None:
    effect = closure(law("motion", "warming drag"), BENCH)
    speed, path, time = 0.2, 0.5, 3.0
    seconds = 1e-3 * np.arange(4000)
    memory, values = Memory(1e-3), {"coefficient": 1.0, "path": path, "time": time}
    at = Signals(velocity=np.full(4000, -speed))
    warm = -np.log(effect.given(effect._remembering(at, memory, values), values) / -speed)
    np.testing.assert_allclose(warm, speed / path * time * (1.0 - np.exp(-(seconds + 5e-4) / time)), atol=1e-6)


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
    film = law("load", f"rubbing, at a place, {REVERSING}")
    assert film.names == ("coefficient", "centre", "width", "turn")
    there = film.value(replace(at, position=0.04), BENCH, [8.0, 0.03, 0.01, 5e-3])
    np.testing.assert_allclose(there, 8.0 * np.exp(-1.0) * np.tanh(at.velocity / 5e-3))


def test_what_a_reversal_opens_is_open_again_after_a_path_of_ln_2_over_2() -> None:
    """From w = -1, w = 1 - 2 exp(-s / path): 1 - w^2 is 0 at a reversal, 1 after path ln 2, and fades then."""
    effect = closure(law("pressure", "leak, since a reversal"), BENCH)
    path, travelled = 5e-4, 1e-6 * np.arange(4000)
    values, there = {"coefficient": 1.0, "path": path}, 0.03 - travelled
    position = np.concatenate([there, there[-1] + travelled])
    at = Signals(position=position, pressure_a=1.0 + 0.0 * position)
    open_ = effect.given(effect._remembering(at, Memory(1e-3), values), values)[4000:]
    w = 1.0 - 2.0 * np.exp(-travelled / path)
    np.testing.assert_allclose(open_, 1.0 - w * w, atol=2e-3)
    assert travelled[np.argmax(open_)] == pytest.approx(path * np.log(2.0), abs=2e-6)


def test_a_spool_that_is_shifted_changes_the_flow_by_its_gain_even_across_null() -> None:
    p_a, p_b, gain = 5e6, 6e6, BENCH.constants()[0]["valve_gain"]
    lost_a, lost_b = shifted(BENCH, np.array([2e-3, 1e-4]), np.array([1e-4, -3e-4]), (p_a, p_b))
    out, back = np.sqrt(BENCH.supply_pressure - p_a), np.sqrt(p_a - BENCH.tank_pressure)
    np.testing.assert_allclose(lost_a, [-gain * 1e-4 * out, gain * (1e-4 * out + 2e-4 * back)], rtol=1e-3)
    assert lost_b[0] > 0.0 > lost_b[1]


def test_a_gauge_that_saturates_or_is_curved_is_undone() -> None:
    """Also where little of its slope is left; another sensor's reading is left alone."""
    pressure, memory = np.linspace(1e5, 1.5e7, 50), Memory(1e-3)
    for sensor, form, values, allowed in (
        ("pressure_b", "reading of pressure_b, above a limit", {"coefficient": -0.95, "threshold": 1e7}, 2e4),
        ("pressure_a", "quadratic reading of pressure_a", {"coefficient": 4e-9}, 1.0),
    ):
        effect = closure(law("sensor", form), BENCH)
        reading = effect.measure(sensor, pressure, memory, values)
        np.testing.assert_allclose(effect.unmeasure(sensor, reading, memory, values), pressure, rtol=0, atol=allowed)
        assert effect.unmeasure("piston_position", reading, memory, values) is reading


def test_a_position_with_play_is_undone() -> None:
    effect = closure(law("sensor", "reading of piston_position, with hysteresis"), BENCH)
    position = 0.04 + 5e-3 * np.sin(np.arange(3000) / 200.0)
    values = {"coefficient": -8e-5, "path": 3e-4}
    reading = effect.measure("piston_position", position, Memory(1e-3), values)
    found = effect.unmeasure("piston_position", reading, Memory(1e-3), values)
    assert np.max(np.abs(found - position)) < 1e-6 < 5e-5 < np.max(np.abs(reading - position))


FOUND = [
    ("load", "hysteresis", {"coefficient": 9.0, "path": 2e-3}, 0.1),
    ("sensor", "quadratic reading of pressure_a", {"coefficient": 2e-9}, 0.1),
    ("actuation", "null, as throttling warms", {"coefficient": 0.1, "time": 3.0}, 0.05),
    ("motion", "creeping stiffness", {"coefficient": 2000.0, "time": 0.2}, 0.05),
    ("pressure_b", "flow of the tank's edge", {"coefficient": 0.1}, 0.03),
    ("motion", "drag, times |p_a - p_b|", {"coefficient": 6e-5}, 0.05),
    ("pressure_b", "late relief", {"coefficient": 4e-13, "threshold": 9.5e6, "time": 0.04}, 0.1),
    ("sensor", "gain of hydraulic_force, times |u|", {"coefficient": -15.0}, 0.05),
    ("load", "rounded stiffness", {"coefficient": 4000.0, "level": 6e-3}, 0.05),
    ("pressure_a", "throttled flow of the port", {"coefficient": 1.0, "resistance": 2e15}, 0.1),
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


def test_a_number_that_no_sample_shows_is_not_known() -> None:
    """A rate that the spool never reaches, of which not even the square of a slope is left."""
    problem = problem_of(record(BENCH, 3))
    slow = closure(law("actuation", "rate limit"), BENCH)
    found = fit(problem, [Claim(slow, {"coefficient": 0.05, "rate": 9.0, "time": 1e-3})], iterations=0)
    place = [one.name for one in slow.parameters].index("rate")
    for size in (0.0, 1e-170):
        found.jacobian[:, place] = size * np.sign(found.jacobian[:, 0])
        assert not has_identified_shapes(problem, found, found.claims[0])
        assert np.isfinite(held_out_gain(problem, found, found))


def test_a_law_that_is_a_name_in_disguise_is_not_definite() -> None:
    """Friction that warms over an endless path is dry friction; that which warms over a short one is not."""
    dry = {"id": "friction_coulomb", "parameters": {"force": 8.0}}
    problem = problem_of(record(replace(BENCH, effects=(dry,)), 3))
    warming = closure(law("motion", "warming friction"), BENCH)
    disguised = fit(problem, [Claim(warming, {"coefficient": 8.0, "path": 10.0, "time": 3.0})])
    assert not has_identified_shapes(problem, disguised, disguised.claims[0])
    named = fit(problem, [claim("friction_coulomb", 8.0)])
    assert has_identified_shapes(problem, named, named.claims[0])


def test_no_law_does_what_a_ruled_out_cause_would_do() -> None:
    """Drag in one direction alone is friction that depends on the direction; a leak or quadratic drag is not."""
    one_way, squared = (
        record(replace(BENCH, closures=({"equation": "motion", "form": form, "parameters": {"coefficient": size}},)), 3)
        for form, size in (("drag, outwards", 150.0), ("quadratic drag", 800.0))
    )
    problem, directional = problem_of(one_way), "friction_viscous:directional"
    viscous = fit(problem, [claim("friction_viscous", 50.0)])
    drag = fit(problem, [Claim(closure(law("motion", "drag, outwards"), BENCH), {"coefficient": 150.0})])
    for ruled_out, same in ((), False), ((directional,), True), (("leakage_internal",), False):
        asked = problem_of(one_way, *ruled_out)
        assert equals_ruled_out(asked, drag, drag.claims[0]) == same
        assert barred_equations(asked, viscous) == ({"motion"} if same else set())
    other = problem_of(squared, directional, "leakage_internal")
    assert barred_equations(other, fit(other, [claim("friction_viscous", 50.0)])) == set()
