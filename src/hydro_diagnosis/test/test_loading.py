# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader

from hydro_bridge.bags.recording import BagWriter
from hydro_core.cli.console import Table
from hydro_diagnosis.inspect_command import COLUMNS, listed
from hydro_diagnosis.io.table import columns_of, read_table
from hydro_diagnosis.preprocessing import loading, streaming
from hydro_diagnosis.preprocessing.loading import load_dataset
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.preprocessing.streaming import read_bag_within
from hydro_diagnosis.recording import InputError, Recording
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()


def tripped(recording: Path, folder: Path, moving: float) -> Path:
    """The recording, as it would be had the box tripped after `moving` s: the piston stands from then on."""
    data = pd.read_csv(recording)
    stands = data["time"] > data["time"].iloc[0] + moving
    data.loc[stands, "piston_position"] = data.loc[~stands, "piston_position"].iloc[-1]
    data.loc[stands, "valve_current"] = 0.0
    rest = BENCH.spring_stiffness * (data["piston_position"].iloc[-1] - BENCH.spring_rest_position)
    noise = np.random.default_rng(7).normal(0.0, 0.6, stands.sum())
    data.loc[stands, "load_force"] = rest + noise
    data.loc[stands, "piston_velocity"] = 0.0
    path = folder / f"tripped_{recording.stem}.csv"
    data.to_csv(path, index=False)
    return path


def test_too_little_motion_is_refused_and_the_remedy_is_named(worn: list[Path], tmp_path: Path) -> None:
    short = [tripped(recording, tmp_path, 1.2) for recording in worn[:2]]
    with pytest.raises(InputError, match=r"piston moves for 2\.\d s.*lower gains.*give the box.*valve_nominal_flow"):
        load_dataset(short, [worn[2]], BENCH)
    pd.read_csv(worn[0])[:2700].to_csv(tmp_path / "begun.csv", index=False)
    with pytest.raises(InputError, match=r"too little to be diagnosed; record 20 s of motion or more$"):
        load_dataset([tmp_path / "begun.csv"], [worn[2]], BENCH)


def test_held_out_recording_that_shows_nothing_is_replaced_and_listed(worn: list[Path], tmp_path: Path) -> None:
    still = tripped(worn[2], tmp_path, 0.0)
    fitted, held, notes = load_dataset(worn[:2], [still], BENCH)
    assert {one.recording for one in fitted} == {"run0"}
    assert {one.recording for one in held} == {"run1"}
    assert any(still.stem in note and "left out" in note for note in notes)
    assert any("run1 was held back" in note for note in notes)


def test_copies_are_refused_under_another_name_or_in_another_format_too(worn: list[Path], tmp_path: Path) -> None:
    copy = tmp_path / "wednesday.parquet"
    pd.read_csv(worn[1]).to_parquet(copy)
    twice, same = "run0 was given twice: what is checked on must not be fitted", "run1 and wednesday hold the same"
    for fitted, held, said in ((worn[:2], worn[:1], twice), (worn[:2], [copy], same), ([worn[1], copy], [], same)):
        with pytest.raises(InputError, match=said):
            load_dataset(fitted, held, BENCH)


MOTION = 3 * (("sine", 280.0, 1.5), ("hold", 0.0, 1.0), ("smooth_step", 250.0, 1.0), ("sine", 60.0, 0.5))
"""Waveforms with amplitude [N] and frequency [Hz]: a slow sine, a pause, large steps, and so on."""


def bag(folder: Path, seconds: float, kinds: Sequence[tuple[str, float, float]] = MOTION) -> Path:
    """A run of the nominal truth under references by turns."""
    segments = [
        Segment(seconds=seconds / len(kinds), waveform=kind, amplitude=amplitude, frequency=frequency, kp=60.0, ki=10.0)
        for kind, amplitude, frequency in kinds
    ]
    with BagWriter(folder / "bag") as writer:
        writer.write_states(record_offline(truth_from_mapping({"profile": "nominal"}), segments, seed=3).states)
    return folder / "bag"


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    path = bag(tmp_path_factory.mktemp("minute"), 60.0)
    return path, check_recording(read_table(path), BENCH)


def test_bag_read_in_stretches_is_the_bag(minute: tuple[Path, Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    path, whole = minute
    monkeypatch.setattr(streaming, "STRETCH", 7_001)
    monkeypatch.setattr(streaming, "WHOLE", 9)
    again = read_bag_within(path, BENCH)
    assert again.quality == whole.quality
    assert [one.start for one in again.segments] == [one.start for one in whole.segments]
    for one, other in zip(again.segments, whole.segments, strict=True):
        for name, values in other.channels.items():
            np.testing.assert_array_equal(one.channels[name], values)


def test_a_bag_that_was_cut_off_says_so(minute: tuple[Path, Recording], tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(next(minute[0].glob("*.mcap")).read_bytes()[:2_000_000])
    assert "cut.mcap was not finished" in read_bag_within(cut, BENCH).quality[0]
    assert "cut.mcap was not finished" in columns_of(cut).notes[0]


@pytest.mark.parametrize("chunk", [0, 9])
def test_one_damaged_block_of_a_bag_is_a_gap_and_a_note(
    chunk: int, minute: tuple[Path, Recording], tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    data = bytearray(next(minute[0].glob("*.mcap")).read_bytes())
    with next(minute[0].glob("*.mcap")).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    one = sorted(summary.chunk_indexes, key=lambda one: one.chunk_start_offset)[chunk]
    data[one.chunk_start_offset + one.chunk_length // 2] ^= 0x10
    path.write_bytes(data)
    found = read_bag_within(path, BENCH)
    assert found.quality[0] == "run.mcap: run.mcap is damaged: 1 of its blocks could not be read"
    assert minute[1].seconds - 8.0 < found.seconds < minute[1].seconds - 0.5
    assert columns_of(path).notes[0] in found.quality[0]


def test_a_thinned_bag_is_listed_as_the_whole_one(minute: tuple[Path, Recording]) -> None:
    path, rows = minute[0], []
    whole, thin = columns_of(path), columns_of(path, 7_000)
    for name, values in whole.series.items():
        np.testing.assert_array_equal(thin.series[name], values[::8])
    for found in (whole, thin):
        listed(path, found, None, table := Table(COLUMNS), BENCH)
        rows.append(table.rows)
    for one, other in zip(*rows, strict=True):
        assert other == {**one, "shape": other["shape"], "rate": pytest.approx(one["rate"], rel=1e-3)}


def test_windows_of_a_long_bag_are_what_it_holds(
    minute: tuple[Path, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, whole = minute
    monkeypatch.setattr(streaming, "STRETCH", 5_000)
    monkeypatch.setattr(streaming, "WINDOW", 2.0)
    kept = read_bag_within(path, BENCH)
    assert len(kept.segments) == 15
    assert sum(one.start >= 40.0 for one in kept.segments) == 5
    assert "15 windows of 2 s were kept" in kept.quality[-1]
    long = whole.segments[0]
    for one in kept.segments:
        begin = round((one.start - long.start) / long.step)
        np.testing.assert_array_equal(one.channels["pressure_a"], long.channels["pressure_a"][begin : begin + len(one)])
        assert one.channels["pressure_a"].base is None  # no view that holds a stretch in memory


@pytest.mark.study
def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    """15 min are 113 MB of numbers; held are a stretch, its check and the windows."""
    path = bag(tmp_path, 900.0)
    tracemalloc.start()
    fitted, held, notes = loading.load_dataset([path], [], BENCH)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 90e6
    assert sum(map(len, fitted)) == 100_000 and sum(map(len, held)) == 50_000
    assert any("of 900 s 15 windows" in note for note in notes)
