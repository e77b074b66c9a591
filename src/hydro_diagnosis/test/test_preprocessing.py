# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a recording is mended, cut out or refused, and listed; long ones are read in bounded memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader

from hydro_bridge.bags.recording import BagWriter, stream_bag
from hydro_core.signals import STATE_FIELDS, StateArray, Waveform
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import RawTable, columns_of, read_table
from hydro_diagnosis.preprocessing import loading
from hydro_diagnosis.preprocessing.box_clock import MAX_SAMPLES_PER_ROW
from hydro_diagnosis.preprocessing.loading import check_bag, load_dataset
from hydro_diagnosis.preprocessing.quality import check_recording, frozen_encoder, sampling_grid, uneven
from hydro_diagnosis.recording import InputError, Recording
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.stages import naming
from hydro_diagnosis.stages.reading import DiagnosisInput
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from tests.segments import claim, frame, record

BENCH = Bench.nominal()
Change = Callable[[pd.DataFrame], pd.DataFrame]


def read(data: pd.DataFrame, folder: Path) -> Recording:
    data.to_csv(folder / "run.csv", index=False)
    return check_recording(read_table(folder / "run.csv"), BENCH)


def stands(data: pd.DataFrame, begin: int = 5000, end: int = 8000) -> pd.DataFrame:
    data.loc[begin:end, "piston_position"] = data.loc[begin, "piston_position"]
    return data


def without_numbers(data: pd.DataFrame) -> pd.DataFrame:
    data.loc[4000:4400, "pressure_a"] = np.nan
    return data


FROZEN, TO_THE_END = "piston_position is frozen in 3001 samples", "piston_position is frozen in 3000 samples"
DAMAGED: tuple[tuple[str, int, Change], ...] = (
    ("2 missing samples were bridged", 1, lambda data: data.drop(index=[3000, 3001])),
    ("200 samples are missing, the first after 4.999 s", 2, lambda data: data.drop(index=range(5000, 5200))),
    ("pressure_a has no number in 401 samples, the first at 4.", 2, without_numbers),
    ("pressure_b is frozen throughout", 1, lambda data: data.assign(pressure_b=5e6)),
    # a frozen encoder: its position comes back, or the force or the speed goes on to the end
    (FROZEN, 2, stands),
    (FROZEN, 2, lambda data: stands(data).drop(columns=["load_force", "piston_velocity"])),
    (TO_THE_END, 1, lambda data: stands(data, 9000, len(data)).drop(columns=["piston_velocity"])),
    (TO_THE_END, 1, lambda data: stands(data, 9000, len(data)).drop(columns=["load_force"])),
)
"""What is said, the pieces that are left, and what was done to a recording."""


@pytest.mark.parametrize(("said", "pieces", "change"), DAMAGED)
def test_what_is_damaged_is_bridged_cut_out_or_left_out_and_listed(
    said: str, pieces: int, change: Change, tmp_path: Path, nominal: StateArray
) -> None:
    recording = read(change(frame(nominal)), tmp_path)
    assert len(recording.segments) == pieces
    assert any(said in note for note in recording.quality), recording.quality
    assert ("pressure_b" in recording.segments[0].channels) == ("pressure_b" not in said)


UNUSABLE: dict[str, Change] = {
    "does not run forward": lambda data: data.assign(time=data["time"].to_numpy()[::-1]),
    "does not change": lambda data: data.assign(piston_position=0.04),
    "saturated": lambda data: data.assign(valve_current=0.05),
    "BenchState": lambda data: data[["time"]].assign(foo=0.0),
    "empty": lambda data: data.iloc[:0, :0],
}


@pytest.mark.parametrize("said", UNUSABLE)
def test_what_cannot_be_used_is_refused_with_its_reason(said: str, tmp_path: Path, nominal: StateArray) -> None:
    with pytest.raises(InputError, match=said):
        read(UNUSABLE[said](frame(nominal)), tmp_path)


@pytest.mark.parametrize(
    "waveform, amplitude", [(Waveform.HOLD, 0.0), (Waveform.SINE, 30.0), (Waveform.SMOOTH_STEP, 250.0)]
)
def test_piston_that_stands_is_no_frozen_encoder(waveform: Waveform, amplitude: float) -> None:
    """Dry friction holds it at every reversal; at rest a coarse encoder repeats itself for seconds."""
    stuck = replace(BENCH, effects=(claim("friction_coulomb", 25.0).to_mapping(),))
    states = record(stuck, 5, 6.0, waveform, amplitude, offset=20.0, frequency=0.5)
    columns = {name: states[name].copy() for name in ("piston_position", "piston_velocity", "load_force")}
    for quantum in (1e-6, 5e-6, 5e-5):
        columns["piston_position"] = quantum * np.round(states["piston_position"] / quantum)
        if waveform != Waveform.SINE:
            assert np.count_nonzero(np.diff(columns["piston_position"]) == 0.0) > 500  # else this shows nothing
        assert not frozen_encoder(columns, 1e-3, BENCH).any()


def logged(states: StateArray, rows: object = slice(None), time: np.ndarray | None = None) -> Recording:
    """What a logger makes of a run whose rows it takes, without the box's count."""
    columns = {name: states[name][rows].copy() for name in STATE_FIELDS}
    stamps = (states["time"] if time is None else time)[rows].copy()
    return check_recording(RawTable("run", stamps, None, columns), BENCH)


def largest_mean_square(recording: Recording) -> float:
    """Of the residuals without a claim, over the noise's."""
    problem = Problem(recording.segments, BENCH)
    return max(problem.mean_squares(problem.residual(())).values())


@pytest.mark.parametrize("late", [0, 1])
def test_fast_logger_gives_the_rows_at_the_box_s_milliseconds(nominal: StateArray, late: int) -> None:
    fine = np.arange(4 * len(nominal) - 4)
    columns = {name: np.interp(fine / 4.0, np.arange(len(nominal)), nominal[name]) for name in STATE_FIELDS}
    columns["valve_current"] = nominal["valve_current"][fine // 4]
    table = RawTable("run", 2.5e-4 * fine[late:], None, {name: one[late:] for name, one in columns.items()})
    (segment,) = check_recording(table, BENCH).segments
    assert segment.step == 1e-3 and segment.half_rows is None
    assert np.allclose(segment.channels["piston_position"], nominal["piston_position"][late : len(segment) + late])


@pytest.mark.parametrize("spacing", [2, 5, 20])
def test_slow_clean_recordings_are_noise(nominal: StateArray, spacing: int) -> None:
    """Without the doubt of missing rows the chambers at 200 Hz are at 4 times the noise's mean square."""
    recording = logged(nominal, slice(None, None, spacing))
    model, between = Problem(recording.segments, BENCH).models[0], min(spacing, MAX_SAMPLES_PER_ROW)
    assert model.spacing == between and model.step == pytest.approx(1e-3 * spacing / between)
    assert largest_mean_square(recording) < 1.35


@pytest.mark.parametrize(("spacing", "shown"), [(1, True), (5, True), (10, False)])
def test_what_a_ringing_between_slow_rows_mimics_is_not_judged(
    spacing: int, shown: bool, tmp_path: Path, nominal: StateArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mass rings at 87 Hz: 200 rows a second show it; in 100 it is as slow as 13 Hz, and so it is in 50."""
    tried: list[Problem] = []
    monkeypatch.setattr(naming, "best_closure", lambda problem, *_: tried.append(problem))
    frame(nominal)[::spacing].to_csv(tmp_path / "run.csv", index=False)
    inputs = DiagnosisInput(recordings=[tmp_path / "run.csv"], holdout=[], bench=BENCH, model=None, columns=None,
                        without=[], estimate=[], as_wired=True)  # fmt: skip
    prepared = inputs.prepare(lambda text: None)
    assert prepared.problem.aliased_resonance == pytest.approx(0.0 if shown else 86.5, abs=0.5)
    assert (
        any("the mass rings on the oil at 86.5 Hz" in note for note in prepared.report_fields["data_quality"]) != shown
    )
    labels = {effect.label for effect in prepared.candidates}
    assert ({"bulk_modulus", "dead_volume:a", "moving_mass", "sensor_lag:pressure_a"} <= labels) == shown
    assert {"sensor_lag:load_force", "friction_coulomb", "valve_deadband"} <= labels
    remains: Any = SimpleNamespace(
        problem=prepared.problem, holdout=None, holdout_report={}, simulations={}, curve=None, by_curve=None,
        assessment=SimpleNamespace(remainder=(SimpleNamespace(equation="load"),), fit=None),
    )  # fmt: skip
    naming.model_remainder(remains, prepared, Search(prepared.problem, []))
    assert bool(tried) == shown


def test_lost_rows_and_their_neighbours_are_not_judged(nominal: StateArray) -> None:
    kept = np.random.default_rng(1).uniform(size=len(nominal)) > 0.03
    kept[[0, -1]] = True
    recording = logged(nominal, kept)
    (segment,) = recording.segments
    assert any("missing samples were bridged" in note for note in recording.quality)
    np.testing.assert_array_equal(segment.measured, kept)
    rows = segment.evaluated_rows(300, len(segment) - 20, 5, 6)
    assert len(rows) > 800 and np.min(np.diff(rows)) >= 5
    assert np.min(np.abs(rows[:, None] - np.flatnonzero(~kept))) > 6
    assert largest_mean_square(recording) < 1.35


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
    assert any("as the samples are: they were interpolated" in note for note in recording.quality)
    channels = recording.segments[0].channels
    assert "valve_current" not in channels
    true = nominal["piston_position"][53:-53]
    as_stamped = np.std(columns["piston_position"][50:-50] - true)
    assert np.std(channels["piston_position"][50:-50] - true) < 0.2 * as_stamped


# -- what is fitted, what is checked on, and long recordings ----------------------------------------------------------


def tripped(recording: Path, folder: Path, moving: float) -> Path:
    """The recording, as it would be had the box tripped after `moving` s: the piston stands from then on."""
    data = pd.read_csv(recording)
    stands = data["time"] > data["time"].iloc[0] + moving
    data.loc[stands, "piston_position"] = place = data.loc[~stands, "piston_position"].iloc[-1]
    noise = np.random.default_rng(7).normal(0.0, 0.6, stands.sum())
    data.loc[stands, "load_force"] = BENCH.spring_stiffness * (place - BENCH.spring_rest_position) + noise
    data.loc[stands, ["piston_velocity", "valve_current"]] = 0.0
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


def test_one_short_stroke_is_too_little_and_its_motion_is_told(tmp_path: Path) -> None:
    """Its rate is noted; that is no sign of a box that trips, nor does a part held out make its motion none."""
    time = np.arange(0.0, 1.1, 1.0 / 1500.0)
    columns = {"time": time, "piston_position": 0.01 + 0.05 * time, "hydraulic_force": 20.0 + np.sin(40.0 * time)}
    pd.DataFrame(columns).to_csv(tmp_path / "stroke.csv", index=False)
    with pytest.raises(
        InputError, match=r"moves for 1\.0 s .*too little to be diagnosed; record 20 s of motion or more$"
    ):
        load_dataset([tmp_path / "stroke.csv"], [], BENCH)


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
    twice, same = "run0 and run0 hold the same", "run1 and wednesday hold the same"
    for fitted, held, said in ((worn[:2], worn[:1], twice), (worn[:2], [copy], same), ([worn[1], copy], [], same)):
        with pytest.raises(InputError, match=said):
            load_dataset(fitted, held, BENCH)


def test_runs_under_one_command_are_no_copies(worn: list[Path], tmp_path: Path) -> None:
    """The force is computed from the command, and repeats; the position does not."""
    again, noise = pd.read_csv(worn[0]), np.random.default_rng(1).standard_normal
    again["piston_position"] += 1e-6 * noise(len(again))
    paths = [tmp_path / f"{name}.csv" for name in ("first", "second")]
    for path, run in zip(paths, (pd.read_csv(worn[0]), again), strict=True):
        run[["time", "hydraulic_force", "piston_position"]].to_csv(path, index=False)
    fitted, held, _ = load_dataset(paths, [], BENCH)
    assert {one.recording for one in (*fitted, *held)} == {"first", "second"}


@pytest.mark.parametrize(("every", "said"), [(1, "windows of 100 s"), (3, "too many rows are missing")])
def test_windows_of_a_slow_logger_have_rows_to_evaluate(every: int, said: str, tmp_path: Path) -> None:
    """A row a second; where every third is missing, none is left whose neighbours are there."""
    rng, time = np.random.default_rng(0), np.arange(4000.0)
    position = 0.04 + 0.03 * np.sin(0.01 * time) + 1e-6 * rng.standard_normal(len(time))
    force = 10.0 * np.sign(np.cos(0.01 * time)) + rng.standard_normal(len(time))
    kept = time % every > 0.0 if every > 1 else time >= 0.0
    data = pd.DataFrame({"time": time, "piston_position": position, "hydraulic_force": force})[kept]
    data.to_csv(tmp_path / "slow.csv", index=False)
    inputs = DiagnosisInput(
        recordings=[tmp_path / "slow.csv"], holdout=(), bench={"moving_mass": 1.0}, model=None, columns=None,
        without=(), estimate=(), as_wired=True,
    )  # fmt: skip
    try:
        notes = inputs.prepare(lambda text: None).report_fields["data_quality"]
    except InputError as error:
        notes = [str(error)]
    assert any(said in note for note in notes), notes


def bag(folder: Path, seconds: float) -> Path:
    """A run of the nominal truth: a slow sine, a pause, large steps, a small sine, and so on."""
    drives = 3 * (("sine", 280.0, 1.5), ("hold", 0.0, 1.0), ("smooth_step", 250.0, 1.0), ("sine", 60.0, 0.5))
    segments = [
        Segment(seconds=seconds / len(drives), waveform=kind, amplitude=size, frequency=frequency, kp=60.0, ki=10.0)
        for kind, size, frequency in drives
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
    monkeypatch.setattr(loading, "STRETCH_SAMPLES", 7_001)
    monkeypatch.setattr(loading, "MAX_WHOLE_STRETCHES", 9)
    again = check_bag(path, BENCH)
    assert again.quality == whole.quality
    assert [one.start for one in again.segments] == [one.start for one in whole.segments]
    for one, other in zip(again.segments, whole.segments, strict=True):
        for name, values in other.channels.items():
            np.testing.assert_array_equal(one.channels[name], values)


def test_a_bag_that_was_cut_off_says_so(minute: tuple[Path, Recording], tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(next(minute[0].glob("*.mcap")).read_bytes()[:2_000_000])
    assert "cut.mcap was not finished" in check_bag(cut, BENCH).quality[0]
    assert "cut.mcap was not finished" in columns_of(cut).notes[0]


@pytest.mark.parametrize("chunk", [0, 9])
def test_one_damaged_block_is_a_gap_and_a_note(chunk: int, minute: tuple[Path, Recording], tmp_path: Path) -> None:
    path, whole = tmp_path / "run.mcap", next(minute[0].glob("*.mcap"))
    with whole.open("rb") as stream:
        chunks = sorted(make_reader(stream).get_summary().chunk_indexes, key=lambda one: one.chunk_start_offset)
    data = bytearray(whole.read_bytes())
    data[chunks[chunk].chunk_start_offset + chunks[chunk].chunk_length // 2] ^= 0x10
    path.write_bytes(data)
    found = check_bag(path, BENCH)
    assert found.quality[0] == "run.mcap: run.mcap is damaged: 1 of its blocks could not be read"
    assert minute[1].seconds - 8.0 < found.seconds < minute[1].seconds - 0.5
    assert columns_of(path).notes[0] in found.quality[0]


def test_windows_of_a_long_bag_are_what_it_holds(
    minute: tuple[Path, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, whole = minute
    monkeypatch.setattr(loading, "STRETCH_SAMPLES", 5_000)
    monkeypatch.setattr(loading, "WINDOW_TIME", 2.0)
    kept = check_bag(path, BENCH)
    assert len(kept.segments) == 15
    assert sum(one.start >= 40.0 for one in kept.segments) == 5
    assert "the 15 most informative windows of 2 s were kept" in kept.quality[-1]
    long = whole.segments[0]
    for one in kept.segments:
        begin = round((one.start - long.start) / long.step)
        np.testing.assert_array_equal(one.channels["pressure_a"], long.channels["pressure_a"][begin : begin + len(one)])
        assert one.channels["pressure_a"].base is None  # no view that holds a stretch in memory


@pytest.mark.parametrize(("memory", "reads"), [(256e6, 1), (0.0, 2)])
def test_hypotheses_share_one_reading_of_what_fits_into_memory(
    memory: float, reads: int, minute: tuple[Path, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, whole = minute
    begun = list[Path]()
    monkeypatch.setattr(loading, "CACHE_BYTES_MAX", memory)
    monkeypatch.setattr(loading, "stream_bag", lambda path, **how: begun.append(path) or stream_bag(path, **how))
    reader = loading.RecordingReader()
    turned = ColumnMap.load({"load_force": {"column": "load_force", "scale": -1.0}})
    as_wired, repaired = (check_bag(path, BENCH, one, reader=reader) for one in (None, turned))
    assert len(begun) == reads
    for one, other, right in zip(as_wired.segments, repaired.segments, whole.segments, strict=True):
        np.testing.assert_array_equal(one.channels["load_force"], right.channels["load_force"])
        np.testing.assert_array_equal(other.channels["load_force"], -right.channels["load_force"])


@pytest.mark.study
def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    """15 min are 113 MB of numbers; held are a stretch, its check and the windows."""
    path = bag(tmp_path, 900.0)
    tracemalloc.start()
    fitted, held, notes = load_dataset([path], [], BENCH)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 90e6
    assert sum(map(len, fitted)) == 100_000 and sum(map(len, held)) == 50_000
    assert any("of 900 s the 15 most informative windows" in note for note in notes)
