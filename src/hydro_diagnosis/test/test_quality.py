# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a recording is mended, cut out or refused, and listed; a logger's own rows make no claim."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from hydro_core.signals import STATE_FIELDS, StateArray, Waveform
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable, read_table
from hydro_diagnosis.preprocessing.box_clock import BETWEEN
from hydro_diagnosis.preprocessing.quality import check_recording, frozen_encoder, sampling_grid, uneven
from hydro_diagnosis.recording import InputError, Recording
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.stages import naming, reading
from hydro_diagnosis.stages.reading import Question
from hydro_sim.model.bench import Bench
from tests.segments import claim, frame, record

BENCH = Bench.nominal()


def read(data: pd.DataFrame, folder: Path) -> Recording:
    path = folder / "run.csv"
    data.to_csv(path, index=False)
    return check_recording(read_table(path), BENCH)


def without_numbers(data: pd.DataFrame) -> pd.DataFrame:
    data.loc[4000:4400, "pressure_a"] = np.nan
    return data


DAMAGED: tuple[tuple[str, int, Callable[[pd.DataFrame], pd.DataFrame]], ...] = (
    ("2 missing samples were bridged", 1, lambda data: data.drop(index=[3000, 3001])),
    ("200 samples are missing after 4.999 s", 2, lambda data: data.drop(index=range(5000, 5200))),
    ("no number of pressure_a in 401 samples from 4.", 2, without_numbers),
    ("pressure_b is frozen throughout", 1, lambda data: data.assign(pressure_b=5e6)),
)
"""What is said, the pieces that are left, and what was done to a recording."""


def test_what_is_damaged_is_bridged_cut_out_or_left_out_and_listed(tmp_path: Path, nominal: StateArray) -> None:
    for said, pieces, change in DAMAGED:
        recording = read(change(frame(nominal)), tmp_path)
        assert len(recording.segments) == pieces, said
        assert any(said in note for note in recording.quality), recording.quality
        assert ("pressure_b" in recording.segments[0].channels) == ("frozen" not in said)


UNUSABLE: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "does not run forward": lambda data: data.assign(time=data["time"].to_numpy()[::-1]),
    "does not change": lambda data: data.assign(piston_position=0.04),
    "saturated": lambda data: data.assign(valve_current=0.05),
    "BenchState": lambda data: data[["time"]].assign(foo=0.0),
    "empty": lambda data: data.iloc[:0, :0],
}


def test_what_cannot_be_used_is_refused_with_its_reason(tmp_path: Path, nominal: StateArray) -> None:
    for said, change in UNUSABLE.items():
        with pytest.raises(InputError, match=said):
            read(change(frame(nominal)), tmp_path)


def frozen(data: pd.DataFrame, begin: int, end: int) -> pd.DataFrame:
    data = data.copy()
    data.loc[begin:end, "piston_position"] = data.loc[begin, "piston_position"]
    return data


@pytest.mark.parametrize("without", [[], ["load_force"], ["piston_velocity"], ["load_force", "piston_velocity"]])
def test_frozen_encoder_is_cut_out_and_listed(tmp_path: Path, nominal: StateArray, without: list[str]) -> None:
    """Whatever else tells it: the load's force, the velocity, or where the position comes back."""
    recording = read(frozen(frame(nominal), 5000, 8000).drop(columns=without), tmp_path)
    assert len(recording.segments) == 2
    assert any("piston_position is frozen in 3001 samples" in note for note in recording.quality)


@pytest.mark.parametrize("quantum", [1e-6, 5e-6, 5e-5])
@pytest.mark.parametrize(
    "waveform, amplitude", [(Waveform.HOLD, 0.0), (Waveform.SINE, 30.0), (Waveform.SMOOTH_STEP, 250.0)]
)
def test_piston_that_stands_is_no_frozen_encoder(waveform: Waveform, amplitude: float, quantum: float) -> None:
    """Dry friction holds it at every reversal; at rest a coarse encoder repeats itself for seconds."""
    states = stuck(waveform, amplitude)
    columns = {name: states[name].copy() for name in ("piston_position", "piston_velocity", "load_force")}
    columns["piston_position"] = quantum * np.round(columns["piston_position"] / quantum)
    if waveform != Waveform.SINE:
        assert np.count_nonzero(np.diff(columns["piston_position"]) == 0.0) > 500  # else this shows nothing
    assert not frozen_encoder(columns, 1e-3, BENCH).any()


@cache
def stuck(waveform: Waveform, amplitude: float) -> StateArray:
    return record(
        corrected_bench(BENCH, [claim("friction_coulomb", 25.0)]),
        5,
        6.0,
        waveform,
        amplitude,
        offset=20.0,
        frequency=0.5,
    )


def logged(states: StateArray, rows: object = slice(None), time: np.ndarray | None = None) -> Recording:
    """What a logger makes of a run whose rows it takes, without the box's count."""
    columns = {name: states[name][rows].copy() for name in STATE_FIELDS}
    stamps = (states["time"] if time is None else time)[rows].copy()
    return check_recording(RawTable("run", stamps, None, columns), BENCH)


@pytest.mark.parametrize("late", [0, 1])
def test_fast_logger_gives_the_rows_at_the_box_s_milliseconds(nominal: StateArray, late: int) -> None:
    fine = np.arange(4 * len(nominal) - 4)
    columns = {name: np.interp(fine / 4.0, np.arange(len(nominal)), nominal[name]) for name in STATE_FIELDS}
    columns["valve_current"] = nominal["valve_current"][fine // 4]
    table = RawTable("run", 2.5e-4 * fine[late:], None, {name: one[late:] for name, one in columns.items()})
    (segment,) = check_recording(table, BENCH).segments
    assert segment.step == 1e-3 and segment.thinner is None
    assert np.allclose(segment.channels["piston_position"], nominal["piston_position"][late : len(segment) + late])


@pytest.mark.parametrize("spacing", [2, 5, 20])
def test_slow_clean_recordings_are_noise(nominal: StateArray, spacing: int) -> None:
    """Without the doubt of missing rows the chambers at 200 Hz are at 4 times the noise's mean square."""
    problem = Problem(logged(nominal, slice(None, None, spacing)).segments, BENCH)
    between = min(spacing, BETWEEN)
    assert problem.models[0].spacing == between and problem.models[0].step == pytest.approx(1e-3 * spacing / between)
    assert max(problem.mean_squares(problem.residual(())).values()) < 1.35


@pytest.mark.parametrize(("spacing", "shown"), [(1, True), (5, True), (10, False)])
def test_what_a_ringing_between_slow_rows_mimics_is_not_judged(
    spacing: int, shown: bool, tmp_path: Path, nominal: StateArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mass rings at 87 Hz: 200 rows a second show it; in 100 it is as slow as 13 Hz, and so it is in 50."""
    tried: list[Problem] = []
    monkeypatch.setattr(naming, "closures", lambda problem, *_: tried.append(problem) or ())
    frame(nominal)[::spacing].to_csv(tmp_path / "run.csv", index=False)
    question = Question(recordings=[tmp_path / "run.csv"], holdout=[], bench=BENCH, model=None, columns=None,
                        without=[], estimate=[], as_wired=True)  # fmt: skip
    case = reading.read(question, lambda text: None)
    assert case.problem.unseen_ringing == pytest.approx(0.0 if shown else 86.5, abs=0.5)
    assert any("the mass rings on the oil at 86.5 Hz" in note for note in case.facts["data_quality"]) != shown
    labels = {effect.label for effect in case.candidates}
    assert ({"bulk_modulus", "dead_volume:a", "moving_mass", "sensor_lag:pressure_a"} <= labels) == shown
    assert {"sensor_lag:load_force", "friction_coulomb", "valve_deadband"} <= labels
    remains: Any = SimpleNamespace(
        problem=case.problem, holdout=None, proof={}, simulated={}, curve=None, by_curve=None,
        assessment=SimpleNamespace(remainder=(SimpleNamespace(equation="load"),), fit=None),
    )  # fmt: skip
    naming.model_remainder(remains, case, Search(case.problem, []))
    assert bool(tried) == shown


def test_lost_rows_and_their_neighbours_are_not_judged(nominal: StateArray) -> None:
    kept = np.random.default_rng(1).uniform(size=len(nominal)) > 0.03
    kept[[0, -1]] = True
    recording = logged(nominal, kept)
    (segment,) = recording.segments
    assert any("missing samples were bridged" in note for note in recording.quality)
    assert segment.measured is not None and np.array_equal(segment.measured, kept)
    rows = segment.evaluated_rows(300, len(segment) - 20, 5, 6)
    lost = np.flatnonzero(~kept)
    assert isinstance(rows, np.ndarray) and len(rows) > 800 and np.min(np.diff(rows)) >= 5
    assert np.min(np.abs(rows[:, None] - lost[None, :])) > 6
    problem = Problem([segment], BENCH)
    assert max(problem.mean_squares(problem.residual(())).values()) < 1.35


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
    _, rows = sampling_grid(shaken[kept])
    true = np.flatnonzero(kept)
    assert np.array_equal(rows - rows[0], true - true[0])


def test_samples_taken_unevenly_are_placed_by_their_stamps(nominal: StateArray) -> None:
    """Position between the box's rows by splines; the current, held for a millisecond, is of no use then."""
    time = nominal["time"][3:-3] + np.random.default_rng(4).uniform(-3e-4, 3e-4, len(nominal) - 6)
    columns = {name: np.interp(time, nominal["time"], nominal[name]) for name in STATE_FIELDS}
    recording = check_recording(RawTable("run", time, None, columns), BENCH)
    assert any("the samples were taken so" in note for note in recording.quality)
    channels = recording.segments[0].channels
    assert "valve_current" not in channels
    off = channels["piston_position"][50:-50] - nominal["piston_position"][53:-53]
    assert np.std(off) < 0.2 * np.std(columns["piston_position"][50:-50] - nominal["piston_position"][53:-53])
