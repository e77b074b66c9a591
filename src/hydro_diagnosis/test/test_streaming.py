# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_bridge.cli.console import Table
from hydro_diagnosis.io.table import columns_of, read_table
from hydro_diagnosis.listing import COLUMNS, listed
from hydro_diagnosis.preprocessing import loading, streaming
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.preprocessing.streaming import read_bag_within
from hydro_diagnosis.recording import Recording, UnusableRecordingError
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()


def bag(folder: Path, seconds: float) -> Path:
    """A run of the truth plant: a slow sine, a pause, large steps, and so on."""
    kinds = [("sine", 280.0, 1.5), ("hold", 0.0, 1.0), ("smooth_step", 250.0, 1.0), ("sine", 60.0, 0.5)]
    segments = [
        {"seconds": seconds / 12, "waveform": kind, "amplitude": amplitude, "frequency": frequency, "kp": 60, "ki": 10}
        for kind, amplitude, frequency in kinds * 3
    ]
    (folder / "schedule.yaml").write_text(yaml.safe_dump({"segments": segments}))
    (folder / "truth.yaml").write_text(yaml.safe_dump({"profile": "nominal"}))
    command = ["ros2", "run", "hydro_sim", "emulator", "--offline", "--out", str(folder / "bag"), "--seed", "3"]
    command += ["--truth", str(folder / "truth.yaml"), "--schedule", str(folder / "schedule.yaml")]
    subprocess.run([*command, "--seconds", str(seconds)], check=True, stdout=subprocess.DEVNULL)
    return folder / "bag"


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    path = bag(tmp_path_factory.mktemp("minute"), 60.0)
    return path, checked(read_table(path), BENCH)


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
    assert len(kept.segments) == streaming.FITTED + streaming.HELD
    assert sum(one.start >= 40.0 for one in kept.segments) == streaming.HELD
    assert "15 windows of 2 s were kept" in kept.quality[-1]
    long = whole.segments[0]
    for one in kept.segments:
        begin = round((one.start - long.start) / long.step)
        np.testing.assert_array_equal(one.channels["pressure_a"], long.channels["pressure_a"][begin : begin + len(one)])
        assert one.channels["pressure_a"].base is None  # no view that holds a stretch in memory


def test_long_bag_in_which_nothing_moves_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "s.yaml").write_text(
        yaml.safe_dump({"segments": [{"seconds": 12, "waveform": "hold", "amplitude": 0}]})
    )
    command = ["ros2", "run", "hydro_sim", "emulator", "--offline", "--out", str(tmp_path / "bag"), "--seconds", "12"]
    (tmp_path / "t.yaml").write_text(yaml.safe_dump({"profile": "nominal"}))
    command += ["--schedule", str(tmp_path / "s.yaml"), "--truth", str(tmp_path / "t.yaml")]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    monkeypatch.setattr(streaming, "STRETCH", 2_000)
    monkeypatch.setattr(streaming, "WHOLE", 3)
    with pytest.raises(UnusableRecordingError, match="too short to be diagnosed"):
        read_bag_within(tmp_path / "bag", BENCH)


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
