# SPDX-License-Identifier: Apache-2.0
"""The filter's loop of a bench file, against the whole bench's own model, the box's law and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import SAMPLE_PERIOD, Flag, FloatArray, ReferenceSignal, StateArray, Waveform, to_matrix
from hydro_filter import metric
from hydro_filter.controller.loop_filter import filter_record
from hydro_filter.model import records
from hydro_filter.model.coordinates import LOOP_SIZE
from hydro_filter.model.loop import (
    SUBSTEPS,
    Loop,
    coordinate_names,
    make_loop,
    make_samples,
    recorded_samples,
    rest_measurement,
    without_disturbances,
)
from hydro_filter.model.sample import POSITION, VELOCITY
from hydro_filter.model.terms import hidden_state_indices
from hydro_sim.box import firmware
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.firmware import RecordArray
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model import equations, hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.grammar import LAWS
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.checks import each

Entry = dict[str, Any]
NOMINAL = Bench.nominal()
CLOSED = 1e-9
"""HYDRO_CLOSED of firmware/hydro/loop.h."""


def effect(label: str, **parameters: float) -> Entry:
    name, *options = label.split()
    return {"id": name, **dict(option.split("=") for option in options), "parameters": parameters}


def having(*effects: Entry) -> Bench:
    return replace(NOMINAL, effects=effects)


LAG, LEAK = effect("valve_lag", bandwidth=110.0, damping=0.8), effect("leakage_internal", coefficient=1e-13)
LATE = effect("transport_delay", time=1e-3)
SLOW_A, SLOW_B, SLOW_CELL = (
    effect(f"sensor_lag sensor={sensor}", bandwidth=bandwidth, damping=0.7)
    for sensor, bandwidth in (("pressure_a", 80.0), ("pressure_b", 200.0), ("hydraulic_force", 60.0))
)
CASES = {
    "1 ms": having(LATE, LAG, LEAK),
    "2 ms": having(effect("transport_delay", time=2e-3), LAG, LEAK),
    "1.3 ms, no lag of the valve": having(effect("transport_delay", time=1.3e-3), LEAK),
    "all of it": having(LATE, LAG, LEAK, SLOW_A, SLOW_B),
}
ALL = CASES["all of it"]


def test_bounded_disturbances_are_no_part_of_the_linearized_loop() -> None:
    """Dry friction that has no name, too."""
    law = {"coefficient": 670.0, "threshold": 0.027}
    closure = {"equation": "motion", "form": "falling friction along the stroke", "parameters": law}
    disturbed = having(LAG, effect("friction_coulomb", force=12.0), effect("valve_deadband", half_width=5e-4))
    plain = metric.linearize_at_rest(make_loop(having(LAG), NOMINAL), 60.0)
    found = metric.linearize_at_rest(make_loop(replace(disturbed, closures=(closure,)), NOMINAL), 60.0)
    assert all(map(np.array_equal, found, plain))


def test_sensors_that_are_off_and_a_shifted_null_leave_the_still_loop_as_it_is() -> None:
    """The design point is the still bench as these sensors show it, its valve closed by the current that this takes."""
    off = having(
        effect("valve_offset", current=1e-3), LAG, LEAK,
        effect("load_cell_bias cell=load_force", force=40.0), effect("pressure_sensor_bias chamber=a", pressure=2e5),
        effect("load_cell_bias cell=hydraulic_force", force=-30.0),
        effect("pressure_sensor_bias chamber=b", pressure=-2e5),
    )  # fmt: skip
    plain, shown, model = make_loop(having(LAG, LEAK), NOMINAL), make_loop(off, NOMINAL), BenchModel(off)
    assert rest_measurement(shown)[[0, 2, 4, 5, 6]] == pytest.approx(model.begin(model.values)[2])
    found, wanted = (metric.linearize_at_rest(one, 60.0)[:2] for one in (shown, plain))
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_what_the_loop_has_no_place_for_is_refused_in_a_sentence(tmp_path: Path) -> None:
    """Closures that remember, a second lag of a sensor, a metric of other coordinates; one of the same is read back."""
    for law in (law for law in LAWS if law.memory_element is not None):
        numbers = {"coefficient": law.typical, **{one.name: one.start_values[0] for one in law.shape_parameters}}
        closure = {"equation": law.equation, "form": law.form, "parameters": numbers}
        with pytest.raises(ValueError, match=f"no place for what closures remember: take {law.form} out"):
            make_loop(replace(NOMINAL, closures=(closure,)), NOMINAL)
    with pytest.raises(ValueError, match="a place for one lag of the pressure sensor of a, the bench file has more"):
        make_loop(having(SLOW_A, SLOW_A), NOMINAL)
    with pytest.raises(ValueError, match=r"this model's loop has .*current_1: make one with"):
        filter_record(metric.ScheduledMetric.load(), CASES["1 ms"], NOMINAL)
    loop = make_loop(ALL, NOMINAL)
    made = metric.ScheduledMetric.from_design(loop, metric.MetricDesign(gain_low=40.0, gain_high=60.0))
    made.save(tmp_path / "wide.safetensors")
    read = metric.ScheduledMetric.load(tmp_path / "wide.safetensors")
    assert read.coordinates == coordinate_names(loop)
    np.testing.assert_array_equal(read.table, made.table)
    filter_record(read, ALL, NOMINAL)


def test_bristles_bend_by_the_motion_that_was_measured() -> None:
    """Closed form of a steady motion, although the forces at hand would throw the mass off within a sample."""
    coulomb, breakaway, width, stiffness, speed, count = 12.0, 45.0, 0.01, 5e5, 1e-3, 100
    model = having(
        effect("friction_coulomb", force=coulomb), effect("friction_presliding", stiffness=stiffness),
        effect("friction_stribeck", breakaway_force=breakaway, velocity=width),
    )  # fmt: skip
    loop, memory = make_loop(model, model), records.new_memories()
    x = np.tile(rest_measurement(loop), (count, 1))
    x[:, VELOCITY] = speed
    x[:, POSITION] += speed * SAMPLE_PERIOD * np.arange(count)
    records.linearize(loop.record, make_samples(x), memory)
    bent = memory["hidden"][0, hidden_state_indices(model)["friction_presliding", 0, "bent"]]
    level = coulomb + breakaway * np.exp(-((speed / width) ** 2))
    moved = count * speed * SAMPLE_PERIOD
    assert bent == pytest.approx(level * (1.0 - np.exp(-stiffness * moved / level)), rel=1e-3)


Case = tuple[FloatArray, RecordArray, float]
LOW = np.array([-800.0, -2e4, -800.0, -2e4, 1e6, 1e6, 0.005, -0.4])
HIGH = np.array([800.0, 2e4, 800.0, 2e4, 15e6, 15e6, 0.075, 0.4])


@pytest.fixture(scope="module")
def loop() -> Loop:
    return make_loop(load_model(), NOMINAL)


@pytest.fixture(scope="module")
def cases(loop: Loop) -> list[Case]:
    """x within what the sensors can show, a memory with the spool well on one side, current."""
    rng, spool, made = np.random.default_rng(2), loop["whole.spool"], list[Case]()
    states = LOW + (HIGH - LOW) * np.random.default_rng(7).random((40, len(LOW)))
    for x, side in zip(states, rng.choice([-1.0, 1.0], 40), strict=True):
        memory, current = records.new_memories(), float(side * rng.uniform(2e-3, 0.05))
        hidden = memory["hidden"][0]
        hidden[: len(loop.arrays["rest"])] = loop.arrays["rest"]
        hidden[spool], hidden[loop["whole.spool_rate"]] = current * rng.uniform(0.8, 1.2), rng.normal(0, 1)
        memory["opening"], memory["opening_rate"] = hidden[spool] + loop["after"], hidden[loop["whole.spool_rate"]]
        memory["running"] = True
        made.append((x, memory, current))
    return made


def of_case(loop: Loop, case: Case, gain: float, scales: tuple[float, float] = (1.0, 1.0)) -> records.Linearization:
    """What the filter makes of a case as its only sample."""
    x, memory, current = case
    sample = make_samples(x[None], nominal=current, current=current, k_p=gain, c_1=scales[0], c_2=scales[1])
    return records.linearize(loop.record, sample, memory.copy())


def sensitivity(loop: Loop, state: FloatArray, opening: float) -> FloatArray:
    """g [N/s/A], -d f_h'/dv, f_h' of the closed valve at rest, -d p_a'/dv and d p_b'/dv at a state, by the firmware."""
    made = np.empty(5)
    pointers = firmware.address_of(loop.record), firmware.address_of(state), firmware.address_of(made)
    records.library().hydro_c_filter_sensitivity(*pointers[:2], opening, pointers[2])
    return made


def displaced(loop: Loop, y: FloatArray, opening: float, q: FloatArray) -> FloatArray:
    """A state with a displacement q of the loop, in units of its scale (docstring of `coordinates`)."""
    change, moved, cell = q * loop.scale, y.copy(), loop["gain"][1]
    gain, _, _, soft_a, soft_b = sensitivity(loop, y, opening)
    total = loop["gain"][0] * loop["area"] * (soft_a + loop["ratio"] * soft_b)
    moved[:2] += np.array([soft_a, -soft_b]) / total * change[0]
    places = [loop[f"linear.{name}"] for name in ("spool", "spool_rate", "cell", "cell_rate")]
    moved[[*places, 2, 3]] += change[1:7] / (gain, gain, cell, cell, 1.0, 1.0)
    return moved


def derivative(function: Callable[[FloatArray], Any], size: int, width: float = 1e-4) -> FloatArray:
    """At 0, by differences of fourth order; a column for each argument."""
    steps = width * np.eye(size)
    near, far = (np.array([function(k * one) - function(-k * one) for one in steps]) for k in (1, 2))
    return (8.0 * near - far).T / (12.0 * width)


def test_f_and_g_are_derivatives_of_the_models_own_sample(loop: Loop, cases: list[Case]) -> None:
    model, kept = BenchModel(without_disturbances(load_model()), substeps=SUBSTEPS), loop["velocity_memory"]
    k = loop.arrays["linear.k"]
    spools, cells = ([loop[f"linear.{name}"], loop[f"linear.{name}_rate"]] for name in ("spool", "cell"))

    def check(case: Case) -> None:
        seen, current = of_case(loop, case, 60.0), case[2]
        before, opening = seen.states[0][loop.arrays["from_whole"]], float(seen.opening[0, 0])
        after = before.copy()
        model.sample(k, after, current)
        later = sensitivity(loop, after, opening)[0]

        def shown(q: FloatArray) -> FloatArray:
            """q a sample later; the last of the arguments is the current."""
            begun = displaced(loop, before, opening, q[:-1])
            ended = begun.copy()
            model.sample(k, ended, current + 0.01 * q[-1])
            speed = kept * q[7] * loop.scale[7] + (1.0 - kept) * (ended[2] - begun[2]) / SAMPLE_PERIOD
            force = loop["gain"][0] * loop["area"] * (ended[0] - loop["ratio"] * ended[1])
            return np.array([force, *later * ended[spools], *ended[cells], ended[2], ended[3], speed]) / loop.scale

        exact = np.column_stack([seen.transition[0], seen.input_vector[0] * 0.01])
        assert np.abs(exact - derivative(shown, LOOP_SIZE + 1)).max() <= 1e-6 * np.abs(exact).max()

    each(cases, check)


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.3, 1.0), (0.0, 2.5)])
def test_k_is_the_derivative_of_the_boxs_law(loop: Loop, cases: list[Case], scales: tuple[float, float]) -> None:
    """With what f_h is made of, and on the spool's side of zero."""
    bench, config, floor = NOMINAL.constants()[0], BoxConfig().constants(NOMINAL), loop["gain_floor"]

    def check(case: Case) -> None:
        seen, (x, _, current) = of_case(loop, case, -35.0, scales), case
        y, opening = seen.states[0][loop.arrays["from_whole"]], float(seen.opening[0, 0])
        side = np.copysign(current, opening)
        g = scales[1] * hydraulics.input_gain(bench, x[6], x[4], x[5], side)
        h = equations.force_rate(NOMINAL, hydraulics.stiffnesses(bench, x[6]), (0.0, 0.0), x[7])
        # the f_c' that gives this current
        wanted = max(g, floor) * side + scales[0] * h + 35.0 * 110.0

        def law(q: FloatArray) -> float:
            moved, change = x.copy(), q * loop.scale
            moved[4:6] += (displaced(loop, y, opening, q) - y)[:2]
            moved[[2, 6, 7]] += change[[3, 5, 7]]
            numbers = (x[2] + 110.0 - moved[2], 0.0, wanted, -35.0, *scales)  # e_c, I, f_c', K_p, C_1, C_2
            address = firmware.address_of
            return float(firmware.library().hydro_c_nominal_current(address(config), address(moved), *numbers))

        assert law(np.zeros(LOOP_SIZE)) == pytest.approx(side, rel=1e-9)
        if abs(g / floor - 1.0) >= 0.01:  # else a kink lies within the difference's reach
            numeric = derivative(law, LOOP_SIZE)
            np.testing.assert_allclose(seen.feedback[0], numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())

    each(cases, check)


def whole_loop(bench: Bench, gain: float) -> FloatArray:
    """One sample of bench and force law about rest, all states and the box's velocity, without an integral."""
    model, loop = BenchModel(bench, substeps=SUBSTEPS), make_loop(bench, NOMINAL)
    n, spool, memory = len(model.states), loop["whole.spool"], loop["velocity_memory"]
    k, y, _ = model.begin(model.values)
    y[n - loop["past"] :] = CLOSED  # the edges' slopes differ on both sides of zero
    if spool != records.NO_STATE:
        y[spool] = CLOSED
    _, slopes, _ = model.jacobian(k, y, CLOSED)
    law = records.law_gradient(loop.record, make_samples(rest_measurement(loop)[None], nominal=1e-9, k_p=gain))
    shown = {int(one["chamber"]): int(one["signal"]) for one in loop["lagging"][: loop["lagging_count"]]}
    closed, feedback = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
    feedback[[loop["whole.cell"], 2, n]] = law[[2, 6, 7]]
    for chamber in range(2):
        feedback[shown.get(chamber, chamber)] += law[4 + chamber]
    closed[:n, :n] = slopes[:, :n]
    closed[:n] += np.outer(slopes[:, n], feedback)
    closed[n] = (1.0 - memory) / SAMPLE_PERIOD * (closed[2] - np.eye(n + 1)[2])
    closed[n, n] += memory
    return closed


@pytest.mark.parametrize(
    "case", [pytest.param(one, marks=[pytest.mark.study] if k else []) for k, one in enumerate(CASES)]
)
def test_the_loops_eigenvalues_are_those_of_the_whole_bench_under_the_law(case: str) -> None:
    """But for the sum of the pressures, which no force moves, and what the coordinates leave out of it."""
    loops = metric.closed_loop_at_rest(make_loop(CASES[case], NOMINAL), 60.0), whole_loop(CASES[case], 60.0)
    ours, theirs = (np.linalg.eigvals(one) for one in loops)
    slow = ours[np.abs(ours) > 0.05]
    assert np.abs(slow[:, None] - theirs).min(axis=1).max() < 2e-3
    moving = theirs[np.abs(theirs.imag) > 1e-2]
    assert np.abs(moving[:, None] - ours).min(axis=1).max() < 2e-3


def run(bench: Bench, gain: float, *, noise: float = 0.0, seconds: float = 0.7, amplitude: float = 100.0) -> StateArray:
    """At 1 Hz."""
    reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=amplitude, frequency=1.0)
    schedule = Schedule(reference=reference, gains=(gain, 0.0), seconds=seconds)
    states = simulate(AnalyticPlant(bench, noise=noise), NOMINAL, schedule)
    assert not (states["flags"] & Flag.TRIPPED).any()
    return states


def seen_by(bench: Bench, states: StateArray) -> records.Linearization:
    """What the filter of a bench file makes of a run's samples."""
    record = make_loop(bench, NOMINAL).record
    return records.linearize(record, recorded_samples(states), linearized=np.zeros(len(states), np.bool_))


@pytest.mark.parametrize(("noise", "share"), [(0.0, 0.01), (1.0, 0.5)])
def test_the_pressure_behind_a_slow_sensor_is_estimated(noise: float, share: float) -> None:
    """Without noise nearly without an error; with it, better than the reading."""
    states, plant, true = run(ALL, 60.0, noise=noise), AnalyticPlant(ALL, noise=0.0), []
    for current in states["valve_current"]:
        true.append(plant.state[0]["y"][:2].copy())
        plant.step(float(current))
    estimates = seen_by(ALL, states).states[:, :2], to_matrix(states)[:, 4:6]
    ours, theirs = ((one - np.array(true))[100:].std() for one in estimates)
    assert ours < share * theirs


@pytest.mark.parametrize("ratio", [1.0, 0.6])
def test_the_monitor_tells_a_chamber_behind_a_slow_sensor_that_is_not_the_files(ratio: float) -> None:
    """A valve that gives 40 % less; the pressures that are estimated are then wrong, and f_h tells it."""
    weak, monitor = having(*ALL.effects, effect("valve_gain", ratio=ratio)), records.new_monitors()
    samples = recorded_samples(run(weak, 60.0, noise=1.0, seconds=2.0, amplitude=250.0))
    records.run_monitor(make_loop(ALL, NOMINAL).record, samples, records.new_memories(), monitor)
    assert bool(monitor["broken"][0]) == (ratio < 1.0)


def test_a_bench_that_follows_its_reference_is_not_displaced() -> None:
    """Without noise, at a gain that follows well: no added coordinate stands out."""
    typical = np.median(np.abs(seen_by(ALL, run(ALL, 80.0)).displacement)[300:], axis=0)
    assert typical[LOOP_SIZE:].max() < 2.0 * typical[:LOOP_SIZE].max() and typical[LOOP_SIZE:].max() < 0.1, typical


def test_a_hydraulic_force_behind_a_slow_cell_is_taken_without_its_lag() -> None:
    """The same displacement as with a fast cell, which the law does not read."""
    benches = having(LAG, LEAK), having(LAG, LEAK, SLOW_CELL)
    runs = [run(one, 60.0, seconds=0.55) for one in benches]
    fast, slow = (seen_by(one, states).displacement[-1] for one, states in zip(benches, runs, strict=True))
    np.testing.assert_allclose(fast, slow, atol=1e-3)
    assert abs(runs[0]["hydraulic_force"][-1] - runs[1]["hydraulic_force"][-1]) > 1.0
