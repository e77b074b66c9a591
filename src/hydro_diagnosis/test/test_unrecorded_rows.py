# SPDX-License-Identifier: Apache-2.0
"""Loggers of any rate, with uneven stamps, with rows lost: nothing is claimed that comes of the logger."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.effects import CANDIDATES, Claim
from hydro_diagnosis.estimation.fit import fit, mean_squares
from hydro_diagnosis.estimation.intervals import without_insignificant
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.preprocessing.quality import checked, counted, uneven
from hydro_diagnosis.recording import Recording
from hydro_diagnosis.selection.search import all_significant
from hydro_diagnosis.stages.reporting import undetectable_causes
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
MASS = next(effect for effect in CANDIDATES if effect.id == "moving_mass")


def logged(states: StateArray, rows: object = slice(None), time: np.ndarray | None = None) -> Recording:
    """What a logger makes of a run whose rows it takes, without the box's count."""
    columns = {name: states[name][rows].copy() for name in STATE_FIELDS}
    stamps = (states["time"] if time is None else time)[rows].copy()
    return checked(RawTable("run", stamps, None, columns), BENCH)


@pytest.mark.parametrize("late", [0, 1])
def test_fast_logger_gives_the_rows_at_the_box_s_milliseconds(nominal: StateArray, late: int) -> None:
    fine = np.arange(4 * len(nominal) - 4)
    columns = {name: np.interp(fine / 4.0, np.arange(len(nominal)), nominal[name]) for name in STATE_FIELDS}
    columns["valve_current"] = nominal["valve_current"][fine // 4]
    table = RawTable("run", 2.5e-4 * fine[late:], None, {name: one[late:] for name, one in columns.items()})
    (segment,) = checked(table, BENCH).segments
    assert segment.step == 1e-3 and segment.thinner is None
    assert np.allclose(segment.channels["piston_position"], nominal["piston_position"][late : len(segment) + late])


@pytest.mark.parametrize("spacing", [2, 5, 20])
def test_slow_clean_recordings_are_noise(nominal: StateArray, spacing: int) -> None:
    """Without the doubt of missing rows the chambers at 200 Hz are at 4 times the noise's mean square."""
    problem = Problem(logged(nominal, slice(None, None, spacing)).segments, BENCH)
    assert problem.models[0].spacing == spacing and problem.models[0].step == pytest.approx(1e-3)
    assert max(mean_squares(problem, problem.residual(())).values()) < 1.35


@pytest.mark.parametrize("spacing", [2, 4, 5])
def test_no_mass_is_claimed_of_a_clean_bench(nominal: StateArray, spacing: int) -> None:
    problem = Problem(logged(nominal, slice(None, None, spacing)).segments, BENCH)
    found = fit(problem, [Claim(MASS, {"mass": 0.1})])
    assert not all_significant(problem, found) or not without_insignificant(problem, found)[0].claims


def test_rows_hide_no_cause_of_a_sensor_that_is_not_there(nominal: StateArray) -> None:
    columns = {name: nominal[name][::5].copy() for name in STATE_FIELDS if name != "hydraulic_force"}
    (part,) = checked(RawTable("run", nominal["time"][::5].copy(), None, columns), BENCH).segments
    problem = Problem([part], BENCH)
    sensors = [effect for effect in CANDIDATES if effect.id in ("sensor_lag", "load_cell_gain", "load_cell_bias")]
    assert any("hydraulic_force" in effect.options.values() for effect in sensors)
    assert undetectable_causes(problem, fit(problem, []), sensors, 20.0) is None


def test_lost_rows_and_their_neighbours_are_not_judged(nominal: StateArray) -> None:
    kept = np.random.default_rng(1).uniform(size=len(nominal)) > 0.03
    kept[[0, -1]] = True
    recording = logged(nominal, kept)
    (segment,) = recording.segments
    assert any("missing samples were bridged" in note for note in recording.quality)
    assert segment.measured is not None and np.array_equal(segment.measured, kept)
    rows = segment.judged(300, len(segment) - 20, 5, 6)
    lost = np.flatnonzero(~kept)
    assert isinstance(rows, np.ndarray) and len(rows) > 800 and np.min(np.diff(rows)) >= 5
    assert np.min(np.abs(rows[:, None] - lost[None, :])) > 6
    problem = Problem([segment], BENCH)
    assert max(mean_squares(problem, problem.residual(())).values()) < 1.35


def test_uneven_stamps_of_even_samples_change_nothing(nominal: StateArray) -> None:
    shaken = np.sort(nominal["time"] + np.random.default_rng(2).uniform(-3e-4, 3e-4, len(nominal)))
    recording = logged(nominal, time=shaken)
    (segment,) = recording.segments
    assert segment.measured is None and len(segment) == len(nominal)
    assert np.array_equal(segment.channels["piston_position"], nominal["piston_position"])
    assert any("the samples are even" in note for note in recording.quality)


def test_rows_lost_under_uneven_stamps_are_found(nominal: StateArray) -> None:
    random = np.random.default_rng(3)
    kept = random.uniform(size=len(nominal)) > 0.05
    shaken = np.sort(nominal["time"] + random.uniform(-3e-4, 3e-4, len(nominal)))
    assert uneven(shaken[kept]) and not uneven(nominal["time"][kept])
    _, rows = counted(shaken[kept])
    true = np.flatnonzero(kept)
    assert np.array_equal(rows - rows[0], true - true[0])


def test_samples_taken_unevenly_are_placed_by_their_stamps(nominal: StateArray) -> None:
    """Position between the box's rows by splines; the current, held for a millisecond, is of no use then."""
    time = nominal["time"][3:-3] + np.random.default_rng(4).uniform(-3e-4, 3e-4, len(nominal) - 6)
    columns = {name: np.interp(time, nominal["time"], nominal[name]) for name in STATE_FIELDS}
    recording = checked(RawTable("run", time, None, columns), BENCH)
    assert any("the samples were taken so" in note for note in recording.quality)
    channels = recording.segments[0].channels
    assert "valve_current" not in channels
    off = channels["piston_position"][50:-50] - nominal["piston_position"][53:-53]
    assert np.std(off) < 0.2 * np.std(columns["piston_position"][50:-50] - nominal["piston_position"][53:-53])
