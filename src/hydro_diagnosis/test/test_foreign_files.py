# SPDX-License-Identifier: Apache-2.0
"""What users of loggers ran into, one small file each with its right answer: read so, or refused in so many words."""

from __future__ import annotations

import gzip
import re
import resource
import struct
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from io import BytesIO, TextIOWrapper
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from hydro_core.signals import FloatArray
from hydro_diagnosis import inspect_command
from hydro_diagnosis.column_matching import propose_sources
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import Columns
from hydro_diagnosis.io.raster import own_rows
from hydro_diagnosis.io.table import RawTable, columns_of, read_table, table_of
from hydro_diagnosis.preprocessing.loading import load_dataset
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.recording import InputError
from hydro_sim.model.bench import Bench
from tests.checks import status_of

N = 400
K = np.arange(N)
T = 1e-3 * K
F = 900.0 * np.sin(0.02 * K) + 0.5
"""N."""
X = 40.0 + 12.0 * np.sin(0.02 * K)
"""mm."""
BENCH = Bench.nominal()
Cells = Sequence[str] | FloatArray


def lines(head: str, *columns: Cells, sign: str = ",", form: str = "{:.6f}") -> str:
    """A text table: a header, then rows; numbers are written by `form`."""
    cells = [[one if isinstance(one, str) else form.format(one) for one in column] for column in columns]
    return "\n".join([*([head] if head else []), *(sign.join(row) for row in zip(*cells, strict=True))]) + "\n"


def quoted(values: FloatArray, signs: str = ",.") -> list[str]:
    """Numbers with thousands, by their signs for thousands and decimals."""
    return [f'"{f"{one:,.3f}".translate(str.maketrans(",.", signs))}"' for one in values]


def german(values: FloatArray, form: str = "{:,.3f}") -> list[str]:
    return [form.format(one).translate(str.maketrans(",.", ".,")) for one in values]


def hms(at: float, sign: str) -> str:
    ms = round(1e3 * at)
    return f"{ms // 3600000:02d}:{ms // 60000 % 60:02d}:{ms // 1000 % 60:02d}{sign}{ms % 1000:03d}"


HEAD = "time,load_force,piston_position [mm]"
BIG = 5.0 * F
SERIAL = 45000.0 + (36000.0 + T) / 86400.0
PLACE = {"piston_position": 1e-3 * X}
TWO_MS = {"time": 2.0 * T, "load_force": F}


def table(*columns: Cells) -> str:
    """Time, force and position, of which the first are given."""
    return lines(HEAD, *columns, *(T, F, X)[len(columns) :])


def stamped(stamp: Callable[[float], str]) -> str:
    return table([stamp(36000.0 + one) for one in T])


def europe(force: Sequence[str], times: Sequence[str] = ()) -> str:
    """The same between semicolons and by decimal commas."""
    return lines(HEAD.replace(",", ";"), times or german(T), force, german(X), sign=";")


TEXT_SUFFIXES: dict[str, tuple[str, dict[str, FloatArray]]] = {
    # kind 4: thousands and decimal signs
    "thousands, quoted": (table(T, quoted(BIG)), {"load_force": BIG}),
    "thousands in the time": (table(quoted(999.8 + T)), {"time": 999.8 + T}),
    "German thousands": (europe(german(BIG)), {"load_force": BIG}),
    "Swiss thousands": (table(T, quoted(BIG, "'.")), {"load_force": BIG}),
    "narrow spaces": (europe(quoted(BIG, "\u202f,")), {"load_force": BIG}),
    "Indian groups": (table(T, [f'"1,23,{400 + k % 99}.5"' for k in K]), {"hydraulic_force": 123400.5 + K % 99}),
    "whole thousands in a German file": (europe(german(np.round(BIG), "{:,.0f}")), {"load_force": np.round(BIG)}),
    "points among decimal commas": (europe([f"{one:.6f}" for one in F]), {"load_force": F}),
    "true minus signs": (table(T, [f"{one:.6f}".replace("-", "\u2212") for one in F]), {"load_force": F}),
    "decimal commas between blanks": (
        lines("# time load_force x_mm", *(german(one, "{:.6f}") for one in (T, F, X)), sign=" "),
        {"load_force": F} | PLACE),
    "three decimals and nothing else": (lines("time;load_force", K, 2000.0 + X, sign=";", form="{:.3f}"),
                                        {"load_force": 2000.0 + X}),
    "exponents of Fortran": (
        lines("", T, F, X, sign=" ", form="{:.9E}").replace("E", "D"), {"load_force": F} | PLACE),
    # kind 8: separators, times, names
    "numpy.savetxt": (lines("", T, F, X, sign=" ", form="{:.18e}"), {"time": T, "load_force": F} | PLACE),
    "blanks at both ends": (lines("", [""] * N, T, F, X, [""] * N, sign="  "), {"time": T} | PLACE),
    "names between commas above blanks": (
        lines("#time(s),Pos(in),Force(lbf)", T, X / 25.4, F / 4.4482216152605, sign="  ", form="{:.9f}"),
        {"load_force": F} | PLACE),
    "bars between the columns": (table().replace(",", "|"), {"load_force": F}),
    "Excel serial days": (table([f"{one:.11f}" for one in SERIAL]), {"time": T}),
    "Excel's clock alone": (table([f"{one % 1.0:.12f}" for one in SERIAL]), {"time": T}),
    "MATLAB's datenum": (table([f"{one + 693960.0:.11f}" for one in SERIAL]), {"time": T}),
    "milliseconds behind a colon": (stamped(lambda at: hms(at, ":")), {"time": T}),
    "milliseconds behind a comma": (europe(german(F), [hms(36000.0 + one, ",") for one in T]), {"time": T}),
    "dates with a colon": (stamped(lambda at: f"2024-05-01 {hms(at, ':')}"), {"time": T}),
    "halves of days": (table([f"5/1/2024 10:00:{one:06.3f} AM" for one in T]), {"time": T}),
    "ISO 8601 with a zone": (stamped(lambda at: f"2024-05-01T{hms(at, '.')}+02:00"), {"time": T}),
    "minutes and seconds": (table([hms(3599.8 + one, ".")[3:] for one in T]), {"time": T}),
    "CamelCase": (
        lines("Name,JibPaCyl,JibPbCyl,JibPistonPosition,JibXRef", 10.0 * K, X, 2.0 * X, 1e-3 * X, 1e-3 * X),
        {"pressure_a": 1e5 * X, "pressure_b": 2e5 * X, "time": 10.0 * T} | PLACE),
    "CamelCase with units": (
        lines("RunTime [ms],CylinderForce [kN],RodPosition [mm]", K, 1e-3 * F, X),
        {"time": T, "hydraulic_force": F} | PLACE),
    "a column without a number": (
        lines("time,load_force,Spare,piston_position [mm]", T, F, ["nan"] * N, X), {"load_force": F}),
    # kind 5: what the header says of time
    "a scope's increment": (
        "X,F_load,x,Start,Increment,\nSequence,N,mm,0.0e+00,2.0e-03\n" + lines("", K, F, X, [""] * N, [""] * N),
        TWO_MS),
    "a sample rate": ("Sample rate [Hz];500\n" + lines("load_force;x [mm]", F, X, sign=";"), TWO_MS),
    "a sample interval": ("Sample Interval,2 ms\n" + lines("load_force,x [mm]", F, X), TWO_MS),
    "a rate in words": ("Sampling rate: 500 Hz\n" + lines("load_force\tx [mm]", F, X, sign="\t"), TWO_MS),
    "a count named time": ("dt,0.002\n" + table([str(k) for k in K]), TWO_MS),
    "started again, with a header": (
        lines(HEAD, T[:200], F[:200], X[:200]) + lines(HEAD, 5.0 + T[200:], F[200:], X[200:]),
        {"time": np.r_[T[:200], 5.0 + T[200:]], "load_force": F}),
    # kind 10: clocks of coarse ticks
    "ticks of 15.6 ms": (table(np.floor(T / 0.015625) * 0.015625), {"time": T}),
    "whole seconds": (table([hms(36000.0 + one // 0.1, ".")[:8] for one in T]), {"time": 10.0 * T}),
    "ticks of 10 ms": (table(np.floor(100.0 * T) / 100.0), {"time": T}),
    # kind 9: a stated unit is the unit
    "kip": (lines("t,force (kip)", T, F / 4448.2216152605, form="{:.12f}"), {"load_force": F}),
    "micronewton": (lines("t,load_force [uN]", T, 1e6 * F), {"load_force": F}),
    "kilopond": (lines("t,Kraft [kp]", T, F / 9.80665, form="{:.9f}"), {"load_force": F}),
    "kp/cm²": (lines("t,x [mm],pA [kp/cm²]", T, X, 2.0 * X), {"pressure_a": 98066.5 * 2.0 * X}),
    "mm_s": (lines("t,pos_mm,vel_mm_s", T, X, F), {"piston_velocity": 1e-3 * F} | PLACE),
    "current_A": (lines("t,pos_mm,current_A", T, X, F), {"valve_current": F}),
    "in and strokes": (lines("Zeit in ms,Kraft in kN,Weg / mm", K, 1e-3 * F, X), {"load_force": F, "time": T} | PLACE),
    "PSI in capitals": (lines("t,x [mm],PA [PSI]", T, X, 1e3 + X), {"pressure_a": 6894.757293168361 * (1e3 + X)}),
}  # fmt: skip
"""Text, and what its proposed map must read; times are compared from the first on."""


def as_proposed(path: Path) -> RawTable:
    found = columns_of(path)
    return table_of(path, found, propose_sources(found, BENCH))


def holds(table: RawTable, answer: Mapping[str, FloatArray], within: float = 1e-5) -> None:
    for field, values in answer.items():
        read = table.time - table.time[0] if field == "time" else table.columns[field]
        wanted, size = (values - values[0], 1.0) if field == "time" else (values, float(np.nanmax(np.abs(values))))
        np.testing.assert_allclose(read, wanted, rtol=0.0, atol=within * size, err_msg=field)


@pytest.mark.parametrize("case", TEXT_SUFFIXES)
def test_a_text_is_read_as_a_person_reads_it(case: str, tmp_path: Path) -> None:
    text, answer = TEXT_SUFFIXES[case]
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    unnamed = ColumnMap.load("time='column 0',load_force='column 1',piston_position='column 2'[mm]")
    named = "column 0" not in columns_of(path).series
    holds(as_proposed(path) if named else read_table(path, unnamed), answer)


def spoilt(values: FloatArray, at: int, cell: str) -> list[str]:
    return [cell if k == at else f"{one:.3f}" for k, one in enumerate(values)]


FORCE = "time=time,load_force="
REFUSED: dict[str, tuple[str, str, str]] = {
    # kind 4
    "a word among numbers": (table(T, spoilt(F, 7, "OVL")), "", r"'OVL' in line 9 of 'load_force' is not a number"),
    "a number with a unit in one row": (table(T, spoilt(F, 70, "12.5 N")), "", "'12.5 N' in line 72"),
    "a time that is none": (table(spoilt(T, 30, "late")), "", "'late' in line 32 of 'time'"),
    "two decimal signs in a column": (
        europe([f"{one:.2f}".replace(".", ",."[k % 2]) for k, one in enumerate(F)]), "",
        r"in line \d+ of 'load_force' is not a number"),
    "a column of texts": (table(T, [f"{one:.2f} N" for one in F]), FORCE + "load_force", "holds no numbers"),
    "thousands or decimals": (
        lines("t\tload_force", [str(k) for k in K], [f"{k % 9}.{100 + k}" if k % 9 else "512" for k in K], sign="\t"),
        "time=t,load_force=load_force", r"'1.101' in line 3 of 'load_force' is not a number as"),
    "commas that are both": (
        lines("time,load_force", [f"0,{k:03d}" for k in K], [f"1,{k}" for k in K]), "",
        "line 2 has 4 cells under half as many names: write decimal points"),
    "a hole between blanks": (
        lines("", T, F, X, sign=" ").replace(f" {X[50]:.6f}", "", 1), "", "line 51 has fewer numbers"),
    # kind 9
    "a force in V": (
        lines("time,load_force [V]", T, F), FORCE + "'load_force [V]'",
        r"'load_force \[V\]' is in V, load_force is a force.*load_force='load_force \[V\]'\*0.001"),
    "a torque as a force": (lines("time,M [Nm]", T, F), FORCE + "'M [Nm]'", "is in N[*]m, load_force is a force"),
    "pounds": (
        lines("time,Force (lbs)", T, F), FORCE + "'Force (lbs)'",
        r"is in lbs, load_force is a force: give a factor to SI"),
    "rad": (lines("time,angle_rad", T, F), "time=time,piston_position=angle_rad", "is in rad, piston_position is a"),
    "a unit nobody knows": (lines("time,F [digits]", T, F), FORCE + "'F [digits]'", "is in digits, load_force is a"),
    "bar for a force": (table(), FORCE + "load_force[bar]", "bar is a unit of pressure: give a factor"),
    # kind 10
    "ticks that miss rows": (
        lines(HEAD, np.floor(np.r_[T[:100], T[180:]] / 0.02) * 0.02, F[:320], X[:320]), "",
        r"is too coarse to tell when each row was taken.*time=row\*0.001"),
    "no time": (
        lines("load_force,piston_position [mm]", F, X), "load_force=load_force",
        r"count even rows, as by --columns \"time=row\*0.001"),
}  # fmt: skip
"""Text, map, and the sentence."""


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused_with_the_cell_or_the_step_that_helps(case: str, tmp_path: Path) -> None:
    text, given, said = REFUSED[case]
    (tmp_path / "run.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said) as raised:
        read_table(tmp_path / "run.csv", ColumnMap.load(given or None))
    assert "\n" not in str(raised.value)


def test_an_mdf_file_says_which_samples_are_invalid_and_that_it_was_started_again(tmp_path: Path) -> None:
    """Every seventh force is marked as invalid; the second group was recorded after a pause."""
    from asammdf import MDF, Signal

    invalid, times = K % 7 == 3, np.r_[T[:250], 3.0 + T[:150]]
    force = np.where(invalid, 1e6, F)
    with MDF(version="4.10") as file:
        for part in (slice(0, 250), slice(250, N)):
            marked = Signal(force[part], times[part], name="F_load", unit="N", invalidation_bits=invalid[part])
            file.append([marked, Signal(X[part], times[part], name="x", unit="mm")])
        file.save(tmp_path / "run.mf4")
    found = as_proposed(tmp_path / "run.mf4")
    holds(found, {"time": times, "load_force": np.where(invalid, np.nan, F)} | PLACE)
    assert any("samples of 'F_load' are marked as invalid" in note for note in found.notes)
    assert any("joined by their times" in note for note in found.notes)


@pytest.mark.parametrize(("late", "again"), [(0.012, 0.0), (0.0, 5.0), (0.0, 0.25), (0.0504, 0.0)])
def test_tdms_channels_begin_when_they_say_so(late: float, again: float, tmp_path: Path) -> None:
    """12 ms late, stopped and started again 5 s later, written in two segments, and a fraction of a sample late."""

    def channel(name: str, part: slice, begin: float) -> ChannelObject:
        start = np.datetime64("2024-05-01T10:00:00", "us") + np.timedelta64(round(1e6 * begin), "us")
        properties = {"wf_start_time": start, "wf_increment": 1e-3, "wf_start_offset": 0.0}
        return ChannelObject("card", name, F[part], properties=properties)

    parts = [(slice(0, 250), 0.0), (slice(250, N), again)] if again else [(slice(0, N), 0.0)]
    with TdmsWriter(tmp_path / "run.tdms") as writer:
        for part, begin in parts:
            writer.write_segment([channel("F_load", part, begin + late), channel("x", part, begin)])
    found = columns_of(tmp_path / "run.tdms")
    times = found.series[found.clocks["F_load"]] - found.series[found.clocks["x"]][0]
    np.testing.assert_allclose(times, late + np.r_[T[:250], again + T[:150]] if again else late + T, atol=1e-9)


def test_a_frame_of_pandas_is_read_with_its_index_dates_and_texts(tmp_path: Path) -> None:
    stamps = pd.Timestamp("2024-05-01 10:00") + pd.to_timedelta(T, unit="s")
    frames = {
        "index": pd.DataFrame({"load_force": F}, index=pd.Index(T, name="t")),
        "unnamed": pd.DataFrame({"load_force": F}, index=T),
        "dates": pd.DataFrame({"load_force": F}, index=stamps),
        "durations": pd.DataFrame({"load_force": F, "time": pd.to_timedelta(T, unit="s")}),
        "zone": pd.DataFrame({"load_force": F, "timestamp": stamps.tz_localize("Europe/Berlin")}),
        "texts": pd.DataFrame({"load_force": [f"{one:,.6f}" for one in F], "time": T}),
        "nullable": pd.DataFrame({"load_force": pd.array(F, dtype="Float64"), "time": T}),
    }
    for name, frame in frames.items():
        frame.to_parquet(tmp_path / f"{name}.parquet")
        holds(as_proposed(tmp_path / f"{name}.parquet"), {"time": T, "load_force": F}, 1e-6)


def test_a_step_among_the_attributes_makes_the_times(tmp_path: Path) -> None:
    steps = {"dt": 0.002, "wf_increment": 0.002, "sample_rate": 500.0, "Sampling frequency [kHz]": 0.5}
    for key, value in steps.items():
        with h5py.File(tmp_path / "run.h5", "w") as file:
            file["load_force"], file["x_mm"] = F, X
            file.attrs[key] = value
        holds(as_proposed(tmp_path / "run.h5"), TWO_MS | PLACE)


def opaque(name: str) -> bytes:
    """A .mat file of version 7 with one object of a MATLAB class, as MATLAB writes a timetable."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    numbers += element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    body = element(6, struct.pack("<II", 17, 0)) + element(1, name.encode()) + element(1, b"MCOS")
    body += element(1, b"timetable") + element(14, numbers)
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + element(14, body)


def test_objects_of_matlab_are_called_so(tmp_path: Path) -> None:
    (tmp_path / "v7.mat").write_bytes(opaque("TT"))
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        item = file.create_dataset("TT", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype=np.uint32))
        item.attrs["MATLAB_class"], item.attrs["MATLAB_object_decode"] = np.bytes_("timetable"), np.int32(3)
    for name in ("v7", "v73"):
        with pytest.raises(InputError, match="timetable2table"):
            columns_of(tmp_path / f"{name}.mat")


def advised(sentence: str) -> str:
    """The map that a sentence advises."""
    found = re.search(r'--columns "([^"]+)"', sentence)
    assert found, sentence
    return found[1]


def test_rows_without_a_time_can_be_counted(tmp_path: Path) -> None:
    savemat(tmp_path / "rate.mat", {"fs": 500.0, "load_force": F})
    with pytest.raises(InputError, match=r"time=row\*0\.001") as raised:
        read_table(tmp_path / "rate.mat")
    advice = advised(str(raised.value)).replace("*0.001", "/fs")
    holds(read_table(tmp_path / "rate.mat", ColumnMap.load(advice)), TWO_MS)


def test_inspect_writes_no_map_that_diagnose_refuses_and_its_advice_helps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, written = tmp_path / "run.csv", tmp_path / "map.yaml"
    path.write_text(lines("F_load [N],x [mm],i_valve [V]", F, X, 2.0 * np.cos(K)))
    assert status_of(inspect_command.main, path, "--write", written) == 2 and not written.exists()
    shown, said = capsys.readouterr()
    assert "`inspect" not in said
    assert "'i_valve [V]' may be the valve_current, but is in V" in shown
    factor = re.search(r"as in (valve_current=\S+ \S+)", shown)
    assert factor is not None
    both = f"{advised(said)},{factor[1]}"
    assert status_of(inspect_command.main, path, "--columns", both, "--write", written) == 0
    holds(read_table(path, ColumnMap.load(written)), {"time": T, "load_force": F, "valve_current": 2e-3 * np.cos(K)})


def test_what_is_printed_survives_a_terminal_of_latin_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.csv").write_text(lines("time,Öl Δ [N],load_force", T, F, F), encoding="utf-8")
    terminal = TextIOWrapper(BytesIO(), encoding="latin-1")
    monkeypatch.setattr("sys.stdout", terminal)
    assert status_of(inspect_command.main, tmp_path / "run.csv") == 0
    terminal.flush()
    assert "Öl ?" in terminal.buffer.getvalue().decode("latin-1")


def test_bags_of_other_formats_are_told_with_what_makes_them_readable(tmp_path: Path) -> None:
    (tmp_path / "one.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "two.db3").write_bytes(b"SQLite format 3\0")
    for name, source in {"one.bag": tmp_path / "one.bag", "two.db3": tmp_path}.items():
        with pytest.raises(InputError, match=f"rosbags-convert --src {source} .*--dst-storage mcap"):
            read_table(tmp_path / name)


def test_a_lone_force_is_the_springs_only_where_it_goes_with_the_position() -> None:
    spring = BENCH.spring_stiffness * (1e-3 * X - BENCH.spring_rest_position)
    for force, field in ((spring, "load_force"), (400.0 * np.sign(np.cos(0.02 * K)), "hydraulic_force")):
        found = propose_sources(Columns({"t [s]": T, "x [mm]": X, "Force [N]": force}), BENCH).sources
        assert found[field].column == "Force [N]" and len(found) == 3


def test_a_position_out_of_the_stroke_is_called_so() -> None:
    time = 1e-3 * np.arange(6000)
    place, force = 0.13 * np.sin(2.0 * time), 900.0 * np.sign(np.cos(2.0 * time))
    table = RawTable("run", time, None, {"piston_position": place, "hydraulic_force": force})
    with pytest.raises(InputError, match=r"piston_position runs from -130 to 130 mm.*stroke of the bench.*80 mm"):
        check_recording(table, BENCH)
    larger = replace(BENCH, stroke=0.4)
    with pytest.raises(InputError, match=r"from -130 to 130 mm.*the column's unit or zero"):
        check_recording(table, larger)
    table.columns["piston_position"] = place + 0.2
    assert check_recording(table, larger).segments


def test_a_channel_that_was_dropped_for_its_clock_is_named_with_the_clock_that_keeps_it(tmp_path: Path) -> None:
    fast, slow = 5e-3 * np.arange(1000), 1e-2 * np.arange(500)
    noise, path = np.random.default_rng(1).normal(size=(2, 1000)), tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["a/time"], file["b/time"] = fast, slow
        file["a/pA_bar"], file["a/pB_bar"] = 80.0 + np.sin(6.0 * fast) + noise[0], 80.0 - np.sin(6.0 * fast) + noise[1]
        file["b/x_mm"] = 40.0 + 12.0 * np.sin(6.0 * slow)
    text = "time=a.time,pressure_a=a.pA_bar,pressure_b=a.pB_bar,piston_position=b.x_mm"
    with pytest.raises(InputError, match=r"lacking is piston_position.*piston_position is sampled 100 times") as raised:
        load_dataset([path], [], BENCH, ColumnMap.load(text))
    advice = re.search(r"--columns time='(\S+)' brings", str(raised.value))
    assert advice is not None
    kept = read_table(path, ColumnMap.load(text.replace("a.time", advice[1]))).columns["piston_position"]
    np.testing.assert_allclose(kept, 0.04 + 0.012 * np.sin(6.0 * slow))


ROWS = table().splitlines()
LATER = lines("load_force [kN],time,piston_position [mm]", 1e-3 * F, T, X, form="{:.9f}").splitlines()
NAMED = [ROWS[0].replace("force", "force [N]"), *ROWS[1:]]
ODD: dict[str, tuple[list[str], int, str]] = {
    "401 remarks": ([*ROWS[:201], *[f"# event {k}" for k in range(401)], *ROWS[201:]], N,
                    "401 lines hold words: their neighbours were joined .from line 202 on: '# event 0'"),
    "words in as many cells": ([*ROWS[:201], "pump,off,again", *ROWS[201:]], N, "1 lines hold words.*line 202"),
    "other columns and units": ([*NAMED[:201], LATER[0], *LATER[201:]], N, "goes on in kN: it was converted to N"),
    "a column more in the second part": (
        [*ROWS[:201], f"new,{ROWS[0]}", *[f"7,{row}" for row in ROWS[201:]]], N, "new: in some of the parts only"),
    "remarks between all rows": (
        [ROWS[0], *[line for row in ROWS[1:] for line in (row, "# one, two")]], N, "400 lines hold"),
    "longer rows": ([*ROWS[:201], *[f"{row},7" for row in ROWS[201:211]], *ROWS[211:]], N - 10,
                    "10 lines have more cells than the 3 of their header.*from line 202 on"),
    "a quote that stays open": ([*ROWS[:201], ROWS[201].replace(",", ',"', 1), *ROWS[202:]], N - 1,
                                "1 lines open a quote that nothing closes.*line 202"),
    "a huge cell": ([f"{row},{'y' * 140_000 if k == 9 else ''}" for k, row in enumerate(ROWS)], N, ""),
    "a footer": ([*ROWS, "Max,900,52", "# end"], N, "2 lines hold words.*line 402 on: 'Max,900,52'"),
    "line breaks in names": (["# run 1", '"time\n[s]","load_force\n\n[N]","piston_position\n[mm]"', *ROWS[1:]], N, ""),
}  # fmt: skip
"""Lines of a text, rows that are read, and the note."""


@pytest.mark.parametrize("case", ODD)
def test_every_line_of_a_text_is_read_or_counted_and_named(case: str, tmp_path: Path) -> None:
    text, count, said = ODD[case]
    (tmp_path / "run.csv").write_text("\n".join(text) + "\n")
    found = as_proposed(tmp_path / "run.csv")
    rows = np.rint(1e3 * found.time).astype(int)
    assert len(rows) == count and re.search(said, "; ".join(found.notes))
    np.testing.assert_allclose(found.columns["load_force"], F[rows], atol=1e-5)
    np.testing.assert_allclose(found.columns["piston_position"], 1e-3 * X[rows], atol=1e-8)


@pytest.mark.parametrize("cut", [1, 4, 8, 11, 20])
@pytest.mark.parametrize("form", ["{:.6f}", "{}"])
def test_a_number_that_the_end_of_the_file_cuts_is_not_believed(cut: int, form: str, tmp_path: Path) -> None:
    """Numbers of equal length, and of any; a file that lacks nothing but its last line break is read whole."""
    rows = lines(HEAD.replace(" [mm]", ""), T, BIG.round(3), 1e3 * X.round(7), form=form)
    (tmp_path / "run.csv").write_text(rows[:-cut])
    found = as_proposed(tmp_path / "run.csv")
    kept = N if cut == 1 else N - 1
    assert len(found.time) == kept and any("line 401" in note for note in found.notes) == (cut > 1)
    np.testing.assert_allclose(found.columns["load_force"], BIG[:kept].round(3), atol=1e-6)


def test_a_map_adds_a_multiple_of_another_column(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(lines("time,F,p_b [bar]", T, F, X))
    found = read_table(tmp_path / "run.csv", ColumnMap.load("time=time,load_force='p_b [bar]'*-49+F"))
    np.testing.assert_allclose(found.columns["load_force"], F - 49.0 * X, atol=1e-3)
    with pytest.raises(InputError, match="no single number named 'G'"):
        read_table(tmp_path / "run.csv", ColumnMap.load("time=time,load_force=F+G"))


LONG = 1e-3 * np.arange(6000)
NOISY = np.random.default_rng(3).normal(size=6000) + 900.0 * np.sin(9.0 * LONG)


@pytest.mark.parametrize("every", [2, 5, 20])
@pytest.mark.parametrize("fill", ["held", "straight lines", "rows alone"])
def test_values_filled_in_between_samples_are_not_samples(every: int, fill: str, tmp_path: Path) -> None:
    """A slower position goes on by a spline, or sets the rows of all; a slower cell is left out, with what keeps it."""
    at = np.arange(6000) // every * every
    filled = {"held": lambda one: one[at], "straight lines": lambda one: np.interp(LONG, LONG[::every], one[::every]),
              "rows alone": lambda one: np.where(at == np.arange(6000), one, np.nan)}[fill]  # fmt: skip
    place = 0.04 + 1e-5 * NOISY
    for field in ("piston_position", "load_force"):
        columns = {"time": LONG, "piston_position": place, "load_force": NOISY, "hydraulic_force": NOISY[::-1]}
        columns[field] = filled(columns[field])
        frame = pd.DataFrame(columns).drop(index=range(3001, 3009))  # lost
        frame.round(9).to_csv(tmp_path / "run.csv", index=False)
        found = as_proposed(tmp_path / "run.csv")
        assert any(note.startswith(f"{field} ") and "own" in note for note in found.notes)
        if field == "load_force":
            assert field not in found.columns
            advice = (
                next(note for note in found.notes if "--columns" in note).split("--columns ")[1].split(" brings")[0]
            )
            text = f"{advice},piston_position=piston_position,load_force=load_force"
            found = read_table(tmp_path / "run.csv", ColumnMap.load(text))
        rows = np.rint(1e3 * found.time).astype(int)
        splined = field == "piston_position" and every <= 10
        assert len(rows) > 0.95 * 6000 / (1 if splined else every) and (splined or np.all(rows % every == 0))
        np.testing.assert_allclose(found.columns["load_force"], NOISY[rows], atol=1e-6)
        own = rows % every == 0
        np.testing.assert_allclose(found.columns["piston_position"][own], place[rows[own]], atol=1e-8)


def test_scales_and_missing_values_that_a_file_states_are_applied_or_asked_for(tmp_path: Path) -> None:
    counts = np.rint(10.0 * F).astype(np.int16)
    counts[5] = -32768
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time"], file["load_force"], file["hydraulic_force"] = T, counts, F
        file["load_force"].attrs.update({"scale_factor": 0.1, "add_offset": 3.0, "_FillValue": np.int16(-32768)})
        file["hydraulic_force"].attrs["gain"] = 2.0
    with pytest.raises(InputError, match=r"states 'gain' = 2.*hydraulic_force='hydraulic_force'\[UNIT\]\*2 if not"):
        read_table(tmp_path / "run.h5")
    found = read_table(tmp_path / "run.h5", ColumnMap.load("hydraulic_force=hydraulic_force[N]*2")).columns
    np.testing.assert_allclose(found["hydraulic_force"], 2.0 * F)
    np.testing.assert_allclose(found["load_force"], np.where(K == 5, np.nan, 0.1 * counts + 3.0))
    channel = ChannelObject("a", "load_force", F, properties={
        "wf_increment": 1e-3, "NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Quadratic"})  # fmt: skip
    with TdmsWriter(tmp_path / "run.tdms") as writer:
        writer.write_segment([channel])
    with pytest.raises(InputError, match="is to be scaled by 'Quadratic', which npTDMS does not"):
        read_table(tmp_path / "run.tdms")


def test_a_text_among_the_values_of_an_mdf_channel_costs_these_alone(tmp_path: Path) -> None:
    from asammdf import MDF, Signal

    raw, conversion = np.arange(N, dtype=np.uint16), {"val_0": 7, "text_0": b"SNA", "default": b""}
    with MDF(version="4.10") as file:
        file.append([Signal(raw, T, name="load_force", unit="N", conversion=conversion)])
        file.save(tmp_path / "run.mf4")
    (tmp_path / "run.mf4").rename(tmp_path / "run.csv")  # by its first bytes
    found = read_table(tmp_path / "run.csv", ColumnMap.load("load_force=load_force"))
    np.testing.assert_array_equal(found.columns["load_force"], np.where(K == 7, np.nan, K))
    assert any("1 samples of 'load_force' are texts ('SNA')" in note for note in found.notes)


def test_a_struct_array_of_matlab_is_named_by_its_texts(tmp_path: Path) -> None:
    signals = [{"name": "load_force", "data": F, "unit": "N"}, {"name": "t", "data": T, "unit": "s"}]
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        for key in ("name", "data", "unit"):
            values = [one[key] for one in signals]
            parts = [[*map(ord, one)] if isinstance(one, str) else one for one in values]
            kinds = [("char", np.uint16) if isinstance(one, str) else ("double", float) for one in values]
            for k, (part, (kind, dtype)) in enumerate(zip(parts, kinds, strict=True)):
                file[f"#refs#/{key}{k}"] = np.array(part, dtype=dtype)[None, :]
                file[f"#refs#/{key}{k}"].attrs["MATLAB_class"] = np.bytes_(kind)
            refs = np.array([[file[f"#refs#/{key}{k}"].ref] for k in range(2)], dtype=h5py.ref_dtype)
            file.create_dataset(f"sig/{key}", data=refs)
    savemat(tmp_path / "v7.mat", {"sig": np.array(signals, dtype=object)})
    for name in ("v73", "v7"):
        holds(as_proposed(tmp_path / f"{name}.mat"), {"time": T, "load_force": F})


def test_the_same_start_in_every_segment_of_a_tdms_file_is_no_restart(tmp_path: Path) -> None:
    said = {"wf_start_time": np.datetime64("2024-05-01T10:00:00", "us"), "wf_increment": 1e-3}
    with TdmsWriter(tmp_path / "run.tdms") as writer:
        for begin in range(0, N, 100):
            writer.write_segment([ChannelObject("a", "load_force", F[begin : begin + 100], properties=said)])
    holds(read_table(tmp_path / "run.tdms", ColumnMap.load("load_force=load_force")), {"time": T, "load_force": F})


def bomb(path: Path) -> None:
    with gzip.open(path, "wb") as file:
        for _ in range(200):
            file.write(b"0.001,0\n" * 131072)


def declared(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name in ("time", "load_force"):
            file.create_dataset(name, shape=(2_000_000_000,), chunks=(1000,), dtype="f8")
        file["load_force"][0] = 1.0


def zipped(path: Path, *names: str) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, table())


OTHERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a.csv.gz": (bomb, "more than half of the free memory"),
    "b.h5": (declared, "more than half of the free memory"),
    "c.raw": (lambda path: path.write_bytes(b"|CF,2,1,1;|CK,1,3,1,1;" + bytes(99)), "imc FAMOS: export it from FAMOS"),
    "d.tdm": (lambda path: path.write_text('<?xml version="1.0"?>\n<usi:tdm version="1.0">'), "DIAdem.*as TDMS"),
    "e.csv": (lambda path: zipped(path, "xl/workbook.xml"), "a spreadsheet: save its table as CSV"),
    "f.zip": (lambda path: zipped(path, "a.csv", "b.csv"), "holds 2 files, not one"),
    "g.bin": (lambda path: path.write_bytes(bytes(range(256)) * 9), "no format that is read here: export it as"),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_what_unpacks_to_too_much_or_is_of_another_format_is_one_sentence(name: str, tmp_path: Path) -> None:
    write, said = OTHERS[name]
    write(tmp_path / name)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=said) as raised:
        read_table(tmp_path / name)
    assert "\n" not in str(raised.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300e3  # kB


def test_packed_files_are_read_by_what_is_in_them(tmp_path: Path) -> None:
    zipped(tmp_path / "run.zip", "there/run.csv")
    (tmp_path / "run.gz").write_bytes(gzip.compress(table().encode()))
    (tmp_path / "run.mat").write_text(table())
    for name in ("run.zip", "run.gz", "run.mat"):
        holds(as_proposed(tmp_path / name), {"time": T, "load_force": F} | PLACE)


def test_a_command_of_few_steps_or_ramps_is_no_slower_channel() -> None:
    time = 1e-3 * np.arange(12_000)
    steps = 50.0 * np.sign(np.sin(0.5 * np.pi * time + 0.1))
    ramps = np.clip(100.0 * np.sin(0.5 * np.pi * np.rint(10.0 * time) / 10.0), -50.0, 50.0)
    straight = np.interp(time, time[::500], ramps[::500])
    assert [len(own_rows(time, one)[0]) for one in (steps, straight)] == [0, 0]
