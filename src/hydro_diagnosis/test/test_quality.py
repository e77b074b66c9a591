# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hydro_bridge.signals import StateArray
from hydro_diagnosis.quality import checked
from hydro_diagnosis.recording import Recording
from hydro_diagnosis.table import InputError, read_table
from hydro_sim.bench import Bench

BENCH = Bench.nominal()
Frame = Callable[[StateArray], pd.DataFrame]


def read(data: pd.DataFrame, folder: Path) -> Recording:
    path = folder / "run.csv"
    data.to_csv(path, index=False)
    return checked(read_table(path), BENCH)


def test_missing_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such recording"):
        read_table(tmp_path / "nowhere")


def test_empty_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(InputError, match="empty"):
        read_table(tmp_path / "empty.csv")


def test_table_without_known_columns_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.csv").write_text("time,foo\n0,1\n")
    with pytest.raises(InputError, match="BenchState"):
        read_table(tmp_path / "other.csv")


def test_short_gap_is_bridged_and_listed(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    recording = read(frame(nominal).drop(index=[3000, 3001]), tmp_path)
    assert len(recording.segments) == 1
    assert any("2 missing samples were bridged" in note for note in recording.quality)


def test_long_gap_cuts_the_recording(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    recording = read(frame(nominal).drop(index=range(5000, 5200)), tmp_path)
    assert len(recording.segments) == 2


def test_nan_run_is_cut_out_and_listed(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    data = frame(nominal)
    data.loc[4000:4400, "pressure_a"] = np.nan
    recording = read(data, tmp_path)
    assert len(recording.segments) == 2
    assert any("pressure_a is not a number in 401 samples" in note for note in recording.quality)


def test_frozen_sensor_is_left_out_and_listed(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    recording = read(frame(nominal).assign(pressure_b=5e6), tmp_path)
    assert "pressure_b" not in recording.channels
    assert any("pressure_b is frozen throughout" in note for note in recording.quality)


def test_clock_that_jumps_cuts_the_recording(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    data = frame(nominal)
    data.loc[6000:, "time"] += 30.0
    assert len(read(data, tmp_path).segments) == 2


def test_time_that_runs_backwards_is_refused(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    data = frame(nominal)
    data["time"] = data["time"].to_numpy()[::-1]
    with pytest.raises(InputError, match="does not run forward"):
        read(data, tmp_path)


def test_still_bench_is_refused(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    with pytest.raises(InputError, match="does not change"):
        read(frame(nominal).assign(piston_position=0.04), tmp_path)


def test_saturation_throughout_is_refused(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    with pytest.raises(InputError, match="saturated"):
        read(frame(nominal).assign(valve_current=0.05), tmp_path)


def test_too_short_recording_is_refused(tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    with pytest.raises(InputError, match="too short"):
        read(frame(nominal).iloc[:900], tmp_path)
