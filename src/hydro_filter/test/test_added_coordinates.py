# SPDX-License-Identifier: Apache-2.0
"""Dead time and lagging pressure sensors in the filter's loop, against the whole bench's own loop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from hydro_core.signals import (
    SAMPLE_PERIOD,
    STATE_DTYPE,
    Command,
    Flag,
    FloatArray,
    ReferenceSignal,
    StateArray,
    Waveform,
    to_matrix,
)
from hydro_filter.controller.loop_filter import loop_parts
from hydro_filter.metric import MetricDesign, ScheduledMetric, closed_loop_at_rest, require_stable_gain
from hydro_filter.model.coordinates import LOOP_SIZE
from hydro_filter.model.loop import (
    SUBSTEPS,
    Loop,
    coordinate_names,
    make_loop,
    make_samples,
    recorded_samples,
    rest_measurement,
)
from hydro_filter.model.records import (
    NO_STATE,
    Linearization,
    law_gradient,
    linearize,
    new_memories,
    new_monitors,
    run_monitor,
)
from hydro_sim.box.box import Box
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.plant import AnalyticPlant

Entry = dict[str, Any]
LAG: Entry = {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}}
CLOSED = 1e-9
"""HYDRO_CLOSED of firmware/hydro/loop.h."""
LEAK: Entry = {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}}


def dead_time(seconds: float) -> Entry:
    return {"id": "transport_delay", "parameters": {"time": seconds}}


def slow_sensor(chamber: str, bandwidth: float) -> Entry:
    sizes = {"bandwidth": bandwidth, "damping": 0.7}
    return {"id": "sensor_lag", "sensor": f"pressure_{chamber}", "parameters": sizes}


CASES: dict[str, tuple[Entry, ...]] = {
    "1 ms": (dead_time(1e-3), LAG, LEAK),
    "2 ms": (dead_time(2e-3), LAG, LEAK),
    "1.3 ms, no lag of the valve": (dead_time(1.3e-3), LEAK),
    "all of it": (dead_time(1e-3), LAG, LEAK, slow_sensor("a", 80.0), slow_sensor("b", 200.0)),
}


def having(*effects: Entry) -> Bench:
    return replace(Bench.nominal(), effects=effects)


def of(case: str) -> Loop:
    return make_loop(having(*CASES[case]), Bench.nominal())


def whole_loop(bench: Bench, gain: float) -> FloatArray:
    """One sample of bench and force law about rest, all states and the box's velocity, without an integral."""
    model, loop = BenchModel(bench, substeps=SUBSTEPS), make_loop(bench, Bench.nominal())
    n, spool, memory = len(model.states), loop["whole.spool"], loop["velocity_memory"]
    k, y, _ = model.begin(model.values)
    y[n - loop["past"] :] = CLOSED  # the edges' slopes differ on both sides of zero
    if spool != NO_STATE:
        y[spool] = CLOSED
    _, slopes, _ = model.jacobian(k, y, CLOSED)
    law = law_gradient(loop.record, make_samples(rest_measurement(loop)[None], nominal=1e-9, k_p=gain))
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
    gain = 60.0
    loops = closed_loop_at_rest(of(case), gain), whole_loop(having(*CASES[case]), gain)
    ours, theirs = (np.linalg.eigvals(one) for one in loops)
    slow = ours[np.abs(ours) > 0.05]
    assert np.abs(slow[:, None] - theirs).min(axis=1).max() < 2e-3
    moving = theirs[np.abs(theirs.imag) > 1e-2]
    assert np.abs(moving[:, None] - ours).min(axis=1).max() < 2e-3


def test_with_two_milliseconds_and_this_valve_no_gain_decays() -> None:
    """The whole bench does not, either: no metric of it exists."""
    assert min(np.abs(np.linalg.eigvals(whole_loop(having(*CASES["2 ms"]), gain))).max() for gain in (1, 10, 90)) > 1.02
    require_stable_gain(of("1 ms"))
    with pytest.raises(ValueError, match=r"2.3 ms late by its lag and 2.0 ms by its dead time, decays at no K_p"):
        require_stable_gain(of("2 ms"))


class Run(NamedTuple):
    """A run of box and plant: records of `STATE_DTYPE`, and the plant's states y."""

    states: StateArray
    y: FloatArray


def run(bench: Bench, gain: float, *, noise: float = 0.0, samples: int = 700, amplitude: float = 100.0) -> Run:
    """`amplitude` [N] at 1 Hz."""
    box, plant, states, y = Box(Bench.nominal()), AnalyticPlant(bench, noise=noise), np.zeros(samples, STATE_DTYPE), []
    reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=amplitude, frequency=1.0)
    changes = {"delta_kp": gain - box.config.base_kp, "delta_ki": -box.config.base_ki}
    box.receive(Command(), 0.0)
    x = plant.reset(0)
    for k in range(samples):
        box.receive(Command(arm=True, **changes, filter_fresh=True, reference=reference), k * SAMPLE_PERIOD)
        y.append(plant.state[0]["y"].copy())
        states[k] = box.tick(x, k * SAMPLE_PERIOD)
        x = plant.step(float(states["valve_current"][k]))
    assert not (states["flags"] & Flag.TRIPPED).any()
    return Run(states, np.array(y))


def seen_by(loop: Loop, seen: Run) -> Linearization:
    """What the filter makes of a run's samples."""
    return linearize(loop.record, recorded_samples(seen.states), linearized=np.zeros(len(seen.states), np.bool_))


def test_the_pressure_behind_a_slow_sensor_is_estimated() -> None:
    """Without noise nearly without an error; with it, better than the reading."""
    bench, loop = having(*CASES["all of it"]), of("all of it")
    for noise, share in ((0.0, 0.01), (1.0, 0.5)):
        seen = run(bench, 60.0, noise=noise)
        found = seen_by(loop, seen).states[:, :2]
        late = slice(100, None)
        ours, theirs = ((one - seen.y[:, :2])[late].std() for one in (found, to_matrix(seen.states)[:, 4:6]))
        assert ours < share * theirs, (noise, ours, theirs)


@pytest.mark.parametrize("ratio", [1.0, 0.6])
def test_the_monitor_tells_a_chamber_behind_a_slow_sensor_that_is_not_the_files(ratio: float) -> None:
    """A valve that gives 40 % less; the pressures that are estimated are then wrong, and f_h tells it."""
    gain, loop = {"id": "valve_gain", "parameters": {"ratio": ratio}}, of("all of it")
    seen = run(having(*CASES["all of it"], gain), 60.0, noise=1.0, samples=2000, amplitude=250.0)
    monitor = new_monitors()
    run_monitor(loop.record, recorded_samples(seen.states), new_memories(), monitor)
    assert bool(monitor["broken"][0]) == (ratio < 1.0)


def test_a_metric_of_other_coordinates_and_a_second_lag_are_refused_in_a_sentence(tmp_path: Path, bench: Bench) -> None:
    with pytest.raises(ValueError, match=r"this model's loop has .*current_1: make one with"):
        loop_parts(ScheduledMetric.load(), having(*CASES["1 ms"]), bench)
    made = ScheduledMetric.from_design(of("all of it"), MetricDesign(gain_low=40.0, gain_high=60.0))
    made.save(tmp_path / "wide.safetensors")
    read = ScheduledMetric.load(tmp_path / "wide.safetensors")
    assert read.coordinates == coordinate_names(of("all of it"))
    np.testing.assert_array_equal(read.table, made.table)
    loop_parts(read, having(*CASES["all of it"]), bench)
    with pytest.raises(ValueError, match="a place for one lag of the pressure sensor of a, the bench file has more"):
        make_loop(having(slow_sensor("a", 80.0), slow_sensor("a", 200.0)), bench)


def test_a_bench_that_follows_its_reference_is_not_displaced() -> None:
    """Without noise, at a gain that follows well: no added coordinate stands out."""
    bench, loop = having(*CASES["all of it"]), of("all of it")
    typical = np.median(np.abs(seen_by(loop, run(bench, 80.0)).displacement)[300:], axis=0)
    assert typical[LOOP_SIZE:].max() < 2.0 * typical[:LOOP_SIZE].max() and typical[LOOP_SIZE:].max() < 0.1, typical


def test_a_hydraulic_force_behind_a_slow_cell_is_taken_without_its_lag() -> None:
    """The same displacement as with a fast cell, which the law does not read."""
    slow: Entry = {"id": "sensor_lag", "sensor": "hydraulic_force", "parameters": {"bandwidth": 60.0, "damping": 0.7}}
    found = []
    for effects in ((LAG, LEAK), (LAG, LEAK, slow)):
        bench = having(*effects)
        seen = run(bench, 60.0, samples=550)
        found.append(
            (seen_by(make_loop(bench, Bench.nominal()), seen).displacement[-1], seen.states["hydraulic_force"][-1])
        )
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-3)
    assert abs(found[0][1] - found[1][1]) > 1.0
