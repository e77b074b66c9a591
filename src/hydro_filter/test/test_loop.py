# SPDX-License-Identifier: Apache-2.0
"""The filter's loop of a bench file."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.metric import rest_loop
from hydro_filter.model.coordinates import LOOP, PAPER_SCALES
from hydro_filter.model.linearization import linearize
from hydro_filter.model.loop import (
    SUBSTEPS,
    loop_of,
    memories,
    rest_measurement,
    step_of,
    without_disturbances,
)
from hydro_filter.model.observer import follow, hydraulic_slopes, model_state, settle
from hydro_filter.model.parts import Loop
from hydro_filter.model.sample import POSITION, VELOCITY
from hydro_filter.model.terms import hidden_state_numbers
from hydro_sim.box import firmware
from hydro_sim.box.box import BoxConfig
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.grammar import LAWS

Entry = dict[str, Any]
LAG: Entry = {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}}
LEAK: Entry = {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}}


def of(*effects: dict[str, object]) -> Bench:
    return Bench.from_mapping(Bench.nominal().to_mapping() | {"effects": list(effects)})


def test_bounded_disturbances_are_no_part_of_the_linearized_loop(bench: Bench) -> None:
    """Dry friction that has no name, too."""
    friction: Entry = {"id": "friction_coulomb", "parameters": {"force": 12.0}}
    overlap: Entry = {"id": "valve_deadband", "parameters": {"half_width": 5e-4}}
    law = {"coefficient": 670.0, "threshold": 0.027}
    closure = {"equation": "motion", "form": "friction, below a speed", "parameters": law}
    plain = rest_loop(loop_of(of(LAG), bench), 60.0)
    for truth in (of(LAG, friction), of(LAG, overlap), replace(of(LAG), closures=(closure,))):
        for with_it, without in zip(rest_loop(loop_of(truth, bench), 60.0), plain, strict=True):
            assert np.array_equal(with_it, without)


def test_sensors_that_are_off_and_a_shifted_null_leave_the_still_loop_as_it_is(bench: Bench) -> None:
    """The design point is the still bench as these sensors show it, its valve closed by the current that this takes."""
    shift = {"id": "valve_offset", "parameters": {"current": 1e-3}}
    off = [
        {"id": "load_cell_bias", "cell": "load_force", "parameters": {"force": 40.0}},
        {"id": "load_cell_bias", "cell": "hydraulic_force", "parameters": {"force": -30.0}},
        {"id": "pressure_sensor_bias", "chamber": "a", "parameters": {"pressure": 2e5}},
        {"id": "pressure_sensor_bias", "chamber": "b", "parameters": {"pressure": -2e5}},
    ]
    plain, shown = loop_of(of(LAG, LEAK), bench), loop_of(of(shift, LAG, LEAK, *off), bench)
    x = rest_measurement(shown.model)
    _, _, readings = (model := BenchModel(of(shift, LAG, LEAK, *off))).begin(model.values)
    assert x[[0, 2, 4, 5, 6]] == pytest.approx(readings)
    for ours, theirs in zip(rest_loop(shown, 60.0)[:2], rest_loop(plain, 60.0)[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_a_closure_that_remembers_is_refused_in_a_sentence() -> None:
    for law in (law for law in LAWS if law.element is not None):
        numbers = {"coefficient": law.typical, **{one.name: one.probes[0] for one in law.numbers}}
        closure = {"equation": law.equation, "form": law.form, "parameters": numbers}
        with pytest.raises(ValueError, match=f"no place for what closures remember: take {law.form} out"):
            loop_of(replace(Bench.nominal(), closures=(closure,)), Bench.nominal())


def test_what_is_compiled_hangs_on_the_effects_and_not_on_their_numbers(
    bench: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    loop_of(of(LAG, LEAK), bench)
    capfd.readouterr()
    other = [{**one, "parameters": {**one["parameters"], name: value}} for one, name, value in (
        (LAG, "bandwidth", 90.0), (LEAK, "coefficient", 2e-13))]  # fmt: skip
    loop_of(of(*other), replace(bench, spring_stiffness=3e4))
    assert "compiling" not in capfd.readouterr().err


def test_bristles_bend_by_the_motion_that_was_measured() -> None:
    """Closed form of a steady motion, although the forces at hand would throw the mass off within a sample."""
    coulomb, breakaway, width, stiffness, speed, count = 12.0, 45.0, 0.01, 5e5, 1e-3, 100
    numbers = (
        ("friction_coulomb", {"force": coulomb}),
        ("friction_stribeck", {"breakaway_force": breakaway, "velocity": width}),
        ("friction_presliding", {"stiffness": stiffness}),
    )
    model = of(*({"id": name, "parameters": each} for name, each in numbers))
    loop, memory = loop_of(model, model), memories()[0]
    x = rest_measurement(loop.model)
    x[VELOCITY] = speed
    for _ in range(count):
        settle(loop, memory, x, 0.0, 0.0)
        follow(loop, memory, x, 0.0, 0.0)
        x[POSITION] += speed * SAMPLE_PERIOD
    bent = memory["hidden"][hidden_state_numbers(model)["friction_presliding", 0, "bent"]]
    level = coulomb + breakaway * np.exp(-((speed / width) ** 2))
    moved = count * speed * SAMPLE_PERIOD
    assert bent == pytest.approx(level * (1.0 - np.exp(-stiffness * moved / level)), rel=1e-3)


LIMIT = 1e-6
COUNT = 40
Case = tuple[FloatArray, FloatArray, float]


@pytest.fixture(scope="module")
def loop(bench: Bench) -> Loop:
    return loop_of(load_model(), bench)


@pytest.fixture(scope="module")
def cases(loop: Loop, states: FloatArray) -> list[Case]:
    """x, simulated states with the spool well on one side, current."""
    rng, p, made = np.random.default_rng(2), loop.model, list[Case]()
    for k, side in enumerate(rng.choice([-1.0, 1.0], COUNT)):
        memory, current = memories()[0], float(side * rng.uniform(2e-3, 0.05))
        settle(loop, memory, states[k], current, 0.0)
        hidden, n = memory["hidden"].copy(), len(p.rest)
        hidden[p.spool], hidden[p.spool_rate] = current * rng.uniform(0.8, 1.2), rng.normal(0, 1)
        hidden[n], hidden[n + 1] = hidden[p.spool] + p.after, hidden[p.spool_rate]
        made.append((states[k], hidden, current))
    return made


def state_of(loop: Loop, x: FloatArray, hidden: FloatArray) -> FloatArray:
    """State of the loop's model."""
    whole = np.empty(len(loop.model.rest))
    model_state(loop.model, hidden, x, whole, True)
    return np.asarray(whole[loop.model.from_whole])


def displaced(loop: Loop, y: FloatArray, opening: float, q: FloatArray) -> FloatArray:
    """A state with a displacement q of the loop, in units of its scale (docstring of `coordinates`)."""
    p, change, moved = loop.model, q * loop.scale, y.copy()
    gain, _, _, soft_a, soft_b = hydraulic_slopes(p, y, opening)
    total = p.gain[0] * p.area * (soft_a + p.ratio * soft_b)
    moved[0] += soft_a / total * change[0]
    moved[1] -= soft_b / total * change[0]
    moved[p.loop_spool] += change[1] / gain
    moved[p.loop_spool_rate] += change[2] / gain
    moved[p.loop_cell] += change[3] / p.gain[1]
    moved[p.loop_cell_rate] += change[4] / p.gain[1]
    moved[2] += change[5]
    moved[3] += change[6]
    return moved


def test_f_and_g_are_derivatives_of_the_models_own_sample(loop: Loop, cases: list[Case]) -> None:
    step, p = step_of(loop), loop.model
    model, kept = BenchModel(without_disturbances(load_model()), substeps=SUBSTEPS), p.memories[1]
    for x, hidden, current in cases:
        linearize(loop, hidden, x, current, current, 60.0, PAPER_SCALES, step)
        before, opening = state_of(loop, x, hidden), hidden[len(p.rest)]
        after = before.copy()
        model.sample(p.loop_k, after, current)
        later = hydraulic_slopes(p, after, opening)[0]

        def shown(  # q a sample later
            q: FloatArray, change: float, y: FloatArray = before, later: float = later, opening: float = opening,
            current: float = current,
        ) -> FloatArray:  # fmt: skip
            begun = displaced(loop, y, opening, q)
            ended = begun.copy()
            model.sample(p.loop_k, ended, current + change)
            speed = kept * q[7] * loop.scale[7] + (1.0 - kept) * (ended[2] - begun[2]) / SAMPLE_PERIOD
            force = p.gain[0] * p.area * (ended[0] - p.ratio * ended[1])
            spool, cell = later * ended[[p.loop_spool, p.loop_spool_rate]], ended[[p.loop_cell, p.loop_cell_rate]]
            return np.array([force, *spool, *cell, ended[2], ended[3], speed]) / loop.scale

        exact = np.column_stack([step.transition, step.push * 0.01])
        numeric, width, none = np.empty((LOOP, LOOP + 1)), 1e-4, np.zeros(LOOP)
        for k in range(LOOP):
            q = width * np.eye(LOOP)[k]
            sides = [shown(sign * q, 0.0) for sign in (1, -1, 2, -2)]
            numeric[:, k] = (8.0 * (sides[0] - sides[1]) - (sides[2] - sides[3])) / (12.0 * width)
        near, far = (shown(none, 0.01 * s) - shown(none, -0.01 * s) for s in (width, 2 * width))
        numeric[:, LOOP] = (8.0 * near - far) / (12.0 * width)
        assert np.abs(exact - numeric).max() <= LIMIT * np.abs(exact).max()


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.3, 1.0), (0.0, 2.5)])
def test_k_is_the_derivative_of_the_boxs_law(loop: Loop, cases: list[Case], scales: tuple[float, float]) -> None:
    """With what f_h is made of, and on the spool's side of zero."""
    step, bench, p = step_of(loop), loop.bench[0], loop.model
    config = BoxConfig().constants(Bench.nominal())
    config["gain_floor"] = loop.gain_floor
    for name in firmware.BENCH_FIELDS:
        config["bench"][name] = bench[name]
    for x, hidden, current in cases:
        opening = hidden[len(p.rest)]
        side = np.copysign(current, opening)
        linearize(loop, hidden, x, current, current, -35.0, scales, step)
        g = scales[1] * hydraulics.input_gain(bench, x[6], x[4], x[5], side)
        driven = max(g, loop.gain_floor) * side
        # the f_c' that gives this current
        wanted = driven + scales[0] * hydraulics.velocity_term(bench, x[6], x[7]) + 35.0 * 110.0
        y = state_of(loop, x, hidden)

        change_of = partial(displaced, loop, y, opening)

        def law(
            q: FloatArray, x: FloatArray = x, wanted: float = wanted, change_of: Any = change_of, y: Any = y
        ) -> float:
            moved, change = x.copy(), q * loop.scale
            moved[4:6] += (change_of(q) - y)[:2]
            moved[2] += change[3]
            moved[6] += change[5]
            moved[7] += change[7]
            force = x[2] + 110.0
            return firmware.nominal_current(config, moved, force - moved[2], 0.0, wanted, -35.0, *scales)

        numeric, width = np.zeros(LOOP), 1e-4
        for k in range(LOOP):
            q = width * np.eye(LOOP)[k]
            numeric[k] = (8.0 * (law(q) - law(-q)) - (law(2 * q) - law(-2 * q))) / (12.0 * width)
        assert law(np.zeros(LOOP)) == pytest.approx(side, rel=1e-9)
        if abs(g / loop.gain_floor - 1.0) < 0.01:
            continue  # a kink lies within the difference's reach
        np.testing.assert_allclose(step.feedback, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())
