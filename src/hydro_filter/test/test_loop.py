# SPDX-License-Identifier: Apache-2.0
"""The filter's loop of a bench file."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.metric import linearize_at_rest
from hydro_filter.model.coordinates import LOOP_SIZE
from hydro_filter.model.loop import SUBSTEPS, Loop, make_loop, make_samples, rest_measurement, without_disturbances
from hydro_filter.model.records import Linearization, library, linearize, new_memories
from hydro_filter.model.sample import POSITION, VELOCITY
from hydro_filter.model.terms import hidden_state_indices
from hydro_sim.box import firmware
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.firmware import Records
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
    closure = {"equation": "motion", "form": "falling friction along the stroke", "parameters": law}
    plain = linearize_at_rest(make_loop(of(LAG), bench), 60.0)
    for truth in (of(LAG, friction), of(LAG, overlap), replace(of(LAG), closures=(closure,))):
        for with_it, without in zip(linearize_at_rest(make_loop(truth, bench), 60.0), plain, strict=True):
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
    plain, shown = make_loop(of(LAG, LEAK), bench), make_loop(of(shift, LAG, LEAK, *off), bench)
    x = rest_measurement(shown)
    _, _, readings = (model := BenchModel(of(shift, LAG, LEAK, *off))).begin(model.values)
    assert x[[0, 2, 4, 5, 6]] == pytest.approx(readings)
    for ours, theirs in zip(linearize_at_rest(shown, 60.0)[:2], linearize_at_rest(plain, 60.0)[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_a_closure_that_remembers_is_refused_in_a_sentence() -> None:
    for law in (law for law in LAWS if law.memory_element is not None):
        numbers = {"coefficient": law.typical, **{one.name: one.probes[0] for one in law.numbers}}
        closure = {"equation": law.equation, "form": law.form, "parameters": numbers}
        with pytest.raises(ValueError, match=f"no place for what closures remember: take {law.form} out"):
            make_loop(replace(Bench.nominal(), closures=(closure,)), Bench.nominal())


def test_what_is_compiled_hangs_on_the_effects_and_not_on_their_numbers(
    bench: Bench, capfd: pytest.CaptureFixture[str]
) -> None:
    make_loop(of(LAG, LEAK), bench)
    capfd.readouterr()
    other = [{**one, "parameters": {**one["parameters"], name: value}} for one, name, value in (
        (LAG, "bandwidth", 90.0), (LEAK, "coefficient", 2e-13))]  # fmt: skip
    make_loop(of(*other), replace(bench, spring_stiffness=3e4))
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
    loop, memory = make_loop(model, model), new_memories()
    x = np.tile(rest_measurement(loop), (count, 1))
    x[:, VELOCITY] = speed
    x[:, POSITION] += speed * SAMPLE_PERIOD * np.arange(count)
    linearize(loop.record, make_samples(x), memory)
    bent = memory["hidden"][0, hidden_state_indices(model)["friction_presliding", 0, "bent"]]
    level = coulomb + breakaway * np.exp(-((speed / width) ** 2))
    moved = count * speed * SAMPLE_PERIOD
    assert bent == pytest.approx(level * (1.0 - np.exp(-stiffness * moved / level)), rel=1e-3)


LIMIT = 1e-6
COUNT = 40
Case = tuple[FloatArray, Records, float]


@pytest.fixture(scope="module")
def loop(bench: Bench) -> Loop:
    return make_loop(load_model(), bench)


@pytest.fixture(scope="module")
def cases(loop: Loop, states: FloatArray) -> list[Case]:
    """x, a memory with the spool well on one side, current."""
    rng, spool, made = np.random.default_rng(2), loop["whole.spool"], list[Case]()
    for k, side in enumerate(rng.choice([-1.0, 1.0], COUNT)):
        memory, current = new_memories(), float(side * rng.uniform(2e-3, 0.05))
        hidden = memory["hidden"][0]
        hidden[: len(loop.arrays["rest"])] = loop.arrays["rest"]
        hidden[spool], hidden[loop["whole.spool_rate"]] = current * rng.uniform(0.8, 1.2), rng.normal(0, 1)
        memory["opening"], memory["opening_rate"] = hidden[spool] + loop["after"], hidden[loop["whole.spool_rate"]]
        memory["running"] = True
        made.append((states[k], memory, current))
    return made


def seen_by(loop: Loop, case: Case, gain: float, scales: tuple[float, float] = (1.0, 1.0)) -> Linearization:
    """What the filter makes of a case as its only sample."""
    x, memory, current = case
    sample = make_samples(x[None], nominal=current, current=current, k_p=gain, c_1=scales[0], c_2=scales[1])
    return linearize(loop.record, sample, memory.copy())


def sensitivity(loop: Loop, state: FloatArray, opening: float) -> FloatArray:
    """g [N/s/A], -d f_h'/dv, f_h' of the closed valve at rest, -d p_a'/dv and d p_b'/dv at a state, by the firmware."""
    made = np.empty(5)
    pointers = firmware.address_of(loop.record), firmware.address_of(state), firmware.address_of(made)
    library().hydro_c_filter_sensitivity(*pointers[:2], opening, pointers[2])
    return made


def displaced(loop: Loop, y: FloatArray, opening: float, q: FloatArray) -> FloatArray:
    """A state with a displacement q of the loop, in units of its scale (docstring of `coordinates`)."""
    change, moved = q * loop.scale, y.copy()
    gain, _, _, soft_a, soft_b = sensitivity(loop, y, opening)
    total = loop["gain"][0] * loop["area"] * (soft_a + loop["ratio"] * soft_b)
    moved[0] += soft_a / total * change[0]
    moved[1] -= soft_b / total * change[0]
    moved[loop["linear.spool"]] += change[1] / gain
    moved[loop["linear.spool_rate"]] += change[2] / gain
    moved[loop["linear.cell"]] += change[3] / loop["gain"][1]
    moved[loop["linear.cell_rate"]] += change[4] / loop["gain"][1]
    moved[2] += change[5]
    moved[3] += change[6]
    return moved


def test_f_and_g_are_derivatives_of_the_models_own_sample(loop: Loop, cases: list[Case]) -> None:
    model, kept = BenchModel(without_disturbances(load_model()), substeps=SUBSTEPS), loop["velocity_memory"]
    k = loop.arrays["linear.k"]
    spools, cells = ([loop[f"linear.{name}"], loop[f"linear.{name}_rate"]] for name in ("spool", "cell"))
    for case in cases:
        seen, current = seen_by(loop, case, 60.0), case[2]
        before, opening = seen.states[0][loop.arrays["from_whole"]], float(seen.opening[0, 0])
        after = before.copy()
        model.sample(k, after, current)
        later = sensitivity(loop, after, opening)[0]

        def shown(  # q a sample later
            q: FloatArray, change: float, y: FloatArray = before, later: float = later, opening: float = opening,
            current: float = current,
        ) -> FloatArray:  # fmt: skip
            begun = displaced(loop, y, opening, q)
            ended = begun.copy()
            model.sample(k, ended, current + change)
            speed = kept * q[7] * loop.scale[7] + (1.0 - kept) * (ended[2] - begun[2]) / SAMPLE_PERIOD
            force = loop["gain"][0] * loop["area"] * (ended[0] - loop["ratio"] * ended[1])
            spool, cell = later * ended[spools], ended[cells]
            return np.array([force, *spool, *cell, ended[2], ended[3], speed]) / loop.scale

        exact = np.column_stack([seen.transition[0], seen.push[0] * 0.01])
        numeric, width, none = np.empty((LOOP_SIZE, LOOP_SIZE + 1)), 1e-4, np.zeros(LOOP_SIZE)
        for i in range(LOOP_SIZE):
            q = width * np.eye(LOOP_SIZE)[i]
            sides = [shown(sign * q, 0.0) for sign in (1, -1, 2, -2)]
            numeric[:, i] = (8.0 * (sides[0] - sides[1]) - (sides[2] - sides[3])) / (12.0 * width)
        near, far = (shown(none, 0.01 * s) - shown(none, -0.01 * s) for s in (width, 2 * width))
        numeric[:, LOOP_SIZE] = (8.0 * near - far) / (12.0 * width)
        assert np.abs(exact - numeric).max() <= LIMIT * np.abs(exact).max()


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.3, 1.0), (0.0, 2.5)])
def test_k_is_the_derivative_of_the_boxs_law(loop: Loop, cases: list[Case], scales: tuple[float, float]) -> None:
    """With what f_h is made of, and on the spool's side of zero."""
    bench, floor = loop.believed.constants()[0], loop["gain_floor"]
    config = BoxConfig().constants(loop.believed)
    for case in cases:
        seen, (x, _, current) = seen_by(loop, case, -35.0, scales), case
        opening = float(seen.opening[0, 0])
        side = np.copysign(current, opening)
        g = scales[1] * hydraulics.input_gain(bench, x[6], x[4], x[5], side)
        driven = max(g, floor) * side
        # the f_c' that gives this current
        wanted = driven + scales[0] * hydraulics.velocity_term(bench, x[6], x[7]) + 35.0 * 110.0
        y = seen.states[0][loop.arrays["from_whole"]]

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

        numeric, width = np.zeros(LOOP_SIZE), 1e-4
        for k in range(LOOP_SIZE):
            q = width * np.eye(LOOP_SIZE)[k]
            numeric[k] = (8.0 * (law(q) - law(-q)) - (law(2 * q) - law(-2 * q))) / (12.0 * width)
        assert law(np.zeros(LOOP_SIZE)) == pytest.approx(side, rel=1e-9)
        if abs(g / floor - 1.0) < 0.01:
            continue  # a kink lies within the difference's reach
        np.testing.assert_allclose(seen.feedback[0], numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())
