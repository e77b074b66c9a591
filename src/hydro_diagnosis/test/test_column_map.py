# SPDX-License-Identifier: Apache-2.0
"""Column maps, and the map that is proposed for exports of loggers and for columns without names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from hydro_core.signals import FloatArray, StateArray
from hydro_diagnosis.column_matching import propose_sources
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import UNIT_FACTORS, Columns
from hydro_diagnosis.io.table import RawTable, columns_of, read_table
from hydro_diagnosis.recording import InputError
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
MAP = "time=clock[ms],piston_position=pos[mm]-40,pressure_a='out.p'[bar],hydraulic_force=vir*gtau,load_force=0"
YAML = """
time: clock[ms]
piston_position: {column: pos, unit: mm, offset: -40}
pressure_a: {column: out.p, unit: bar}
hydraulic_force: vir*gtau
load_force: 0
"""
TRUE = {
    "time": [0.0, 1e-3, 2e-3],
    "piston_position": [0.01, 0.0, -0.01],
    "pressure_a": [8e6, 8.1e6, 8.2e6],
    "hydraulic_force": [35.0, 70.0, -35.0],
    "load_force": [0.0, 0.0, 0.0],
}


def file(folder: Path) -> Path:
    path = folder / "run.mat"
    columns = {"clock": [0.0, 1.0, 2.0], "pos": [50.0, 40.0, 30.0], "vir": [1.0, 2.0, -1.0], "gtau": 35.0}
    savemat(path, {**columns, "note": "cold oil", "out": {"p": [80.0, 81.0, 82.0]}})
    return path


def same(table: RawTable, true: dict[str, list[float]]) -> None:
    found = {"time": table.time, **table.columns}
    assert set(found) == set(true)
    for name, values in true.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12, atol=1e-15)


def test_every_form_of_a_map_gives_the_same_fields(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(YAML)
    for given in (MAP, tmp_path / "map.yaml", dict(part.split("=") for part in MAP.split(","))):
        same(read_table(file(tmp_path), ColumnMap.load(given)), TRUE)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("time=t,load_force=vir", "run.mat: there is no column named 't'; there are clock, pos, vir, out.p"),
        ("time=clok,load_force=vir", "did you mean 'clock'"),
        ("time=clock,load_force=vir*gtua", "no single number named 'gtua' .did you mean 'gtau'"),
        ("time=clock,piston_positon=pos", "not a field of a recording, did you mean 'piston_position'"),
        ("time=clock,load_force=vir[qubit]", "unit 'qubit' is unknown; there are s, ms"),
        ("time=clock,load_force", "'load_force' is not FIELD=COLUMN"),
        ("time=clock,load_force=vir**2", "cannot be read from '\\*\\*2' on"),
        ("load_force=vir", "no column is the time"),
        ({"time": {"column": "clock", "factor": 2}}, "'factor' is unknown; there are column, unit, scale"),
        ({"time": "clock", "load_force": {"column": "vir", "scale": None}}, "scale None is not a number"),
        ({"time": "clock", "load_force": {"column": "vir", "delay": True}}, "delay True is not a number"),
    ],
)
def test_wrong_map_is_one_sentence_that_helps(given: object, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said) as raised:
        read_table(file(tmp_path), ColumnMap.load(given))
    assert "\n" not in str(raised.value)


def test_map_without_a_time_corrects_what_carries_the_fields_names(tmp_path: Path) -> None:
    content = {"time": [0, 1, 2], "load_force": [1, 2, 3], "pressure_a": [4, 5, 6], "pressure_b": [7, 8, 9]}
    pd.DataFrame(content).to_csv(tmp_path / "run.csv")
    columns = ColumnMap.load("load_force=load_force*-1,pressure_a=none")
    assert str(columns) == "load_force=load_force*-1,pressure_a=none"
    same(
        read_table(tmp_path / "run.csv", columns),
        {"time": [0, 1, 2], "load_force": [-1, -2, -3], "pressure_b": [7, 8, 9]},
    )


@pytest.mark.parametrize(
    ("hydraulic", "load"),
    [("Kraft Zylinder [N]", "Kraft Feder [kN]"), ("Fcyl", "Fspring"), ("Kolbenkraft [N]", "Kraft [N]")],
)
def test_two_forces_are_told_apart_by_what_they_act_on(hydraulic: str, load: str) -> None:
    time = np.arange(500) * 1e-3
    force = 200.0 * np.sin(6.0 * time)
    series = {"t": time, load: force / (1e3 if "kN" in load else 1.0), hydraulic: 1.1 * force}
    sources = propose_sources(Columns(series), BENCH).sources
    assert (sources["hydraulic_force"].column, sources["load_force"].column) == (hydraulic, load)


FIELDS = ("piston_position", "pressure_a", "pressure_b", "load_force", "valve_current", "reference_force")
NUMBERED = ("pressure_b", "piston_position", "load_force", "pressure_a", "valve_current", "hydraulic_force")
USUAL = ["s", "mm", "bar", "bar", "N", "mA", "N"]


def columns(states: StateArray, units: Sequence[str] = USUAL, fields: Sequence[str] = FIELDS) -> list[FloatArray]:
    """The time [unit] and the fields, each in its unit of the file, shape (n,)."""
    values = [np.arange(len(states)) * 1e-3, *(states[field] for field in fields)]
    return [one / UNIT_FACTORS[unit] for one, unit in zip(values, units, strict=True)]


def rows(values: Sequence[FloatArray], separator: str, decimal: str = ".") -> list[str]:
    """Lines of numbers; where there is none, the cell is empty."""
    table = np.column_stack(values)
    return [separator.join("" if x != x else repr(float(x)).replace(".", decimal) for x in row) for row in table]


def control_desk(states: StateArray) -> list[str]:
    """ControlDesk 7.2: rows of keys, among them numbers; one raster; names of ports, told apart by their path."""
    head = """descriptions,General,,Recording,,Measurement
,Author,Lee,Name,exp1_002
trace_size,4000,4000,4000,4000,4000,4000,4000
trace_names,xAxis,In1,In1,In1,In1,In1,In1
trace_units,s,mm,bar,bar,N,mA,N
description,실험,측정,측정,측정,측정,측정,측정
path,,M://Root/Position/In1,M://Root/pA/In1,M://Root/pB/In1,M://Root/LoadCell/In1,M://Root/Servo/In1,M://Root/Ref/In1
flags,0,1,1,1,1,1,1
min,0,-1000.0,-1000.0,-1000.0,-1000.0,-1000.0,-1000.0"""
    lines = rows(columns(states), ",")
    return [head, f"trace_values,{lines[0]}", *(f",{line}" for line in lines[1:])]


def numbered(states: StateArray) -> list[str]:
    """Channels without names: units alone, and what the numbers are to each other."""
    units = ["s", "bar", "mm", "kN", "bar", "mA", "kN"]
    return ["CH0\tCH1\tCH2\tCH3\tCH4\tCH5\tCH6", "\t".join(units), *rows(columns(states, units, NUMBERED), "\t")]


def twin_cat(states: StateArray) -> list[str]:
    """TwinCAT Scope's export tool in Germany: pairs of key and value, and of milliseconds and value, per channel."""
    names = ["fPos", "fDruckA", "fDruckB", "fKraft", "fVentilstrom", "fKraftSoll"]
    head = ["Name\tYT Scope Project", "Starttime of export\t133238090039920000\tMontag", ""]
    for key, values in {
        "Name": names, "Data-Type": 6 * ["REAL64"], "SampleTime[ms]": 6 * ["1"], "IndexOffset": 6 * ["328147"],
        "SymbolName": [f"MAIN.{name}" for name in names], "NetID": 6 * ["192.168.1.1.1.1"], "Unit": USUAL[1:],
    }.items():  # fmt: skip
        head.append("\t".join(f"{key}\t{value}" for value in values))
    time, *rest = columns(states, ["ms", *USUAL[1:]])
    return [*head, "", *rows([one for values in rest for one in (time, values)], "\t", ","), "EOF"]


def lab_view(states: StateArray) -> list[str]:
    """LabVIEW's measurement file without a column of times: its step stands in the header."""
    head = """LabVIEW Measurement
Decimal_Separator\t,
X_Columns\tNo
Time\t17:18:18,938945770263671875
***End_of_Header***

Channels\t6
Samples\t4000\t4000\t4000\t4000\t4000\t4000
Date\t2019/07/22\t2019/07/22\t2019/07/22\t2019/07/22\t2019/07/22\t2019/07/22
Y_Unit_Label\tmm\tbar\tbar\tN\tmA\tN
X0\t0,0000000000000000E+0\t0,0E+0\t0,0E+0\t0,0E+0\t0,0E+0\t0,0E+0
Delta_X\t0,001000\t0,001000\t0,001000\t0,001000\t0,001000\t0,001000
***End_of_Header***
X_Value\tPosition\tPressure A\tPressure B\tLoad cell\tValve current\tForce reference\tComment"""
    return [head, *(f"\t{line}" for line in rows(columns(states)[1:], "\t", ","))]


def inca(states: StateArray) -> list[str]:
    """ETAS INCA's text: a row of types between names and quoted units; a tab ends each row."""
    head = """ETASAsciiItemFile\trecord\tCrLf\tTab
sampleCount\t4000
time\ts_Kolben\\CAN:1\tp_A\\ADC:1\tp_B\\ADC:1\tF_Mess\\ADC:1\tI_Ventil\\ADC:1\tF_Soll\\CAN:1
f8\tf8\tf8\tf8\tf8\tf8\tf8
"s"\t"mm"\t"bar"\t"bar"\t"N"\t"A"\t"N\""""
    units = ["s", "mm", "bar", "bar", "N", "A", "N"]
    return [f"{row}\t" for row in [*head.splitlines(), *rows(columns(states, units), "\t")]]


def mts(states: StateArray) -> list[str]:
    """MTS: a header, names and units before each block of a test."""
    head = """
Data Acquisition\t\t\t\t\t\tTime:\t0.5\tSec\t3/29/2016 1:54:32 PM
Running Time\tAxial Displacement\tPressure A\tPressure B\tAxial Force\tServovalve Current\tAxial Force Command
s\tmm\tbar\tbar\tkN\tmA\tkN"""
    lines = rows(columns(states, ["s", "mm", "bar", "bar", "kN", "mA", "kN"]), "\t")
    return ["MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A", head, *lines[:1500], head, *lines[1500:3000], head, *lines[3000:]]


def times_of_day(states: StateArray) -> list[str]:
    """A PLC's log: dates and times, past midnight."""
    start = datetime(2026, 12, 31, 23, 59, 58)
    head = "Datum/Uhrzeit;Weg [mm];Druck A [bar];Druck B [bar];Kraft [N];Strom [mA];Sollwert [N]"
    stamped = enumerate(rows(columns(states)[1:], ";", ","))
    return [head, *(f"{start + timedelta(milliseconds=k):%d.%m.%Y %H:%M:%S,%f};{line}" for k, line in stamped)]


EXPORTS = {
    control_desk: ("csv", "cp949"), numbered: ("csv", "utf-8"), twin_cat: ("csv", "utf-8"), lab_view: ("lvm", "utf-8"),
    inca: ("ascii", "cp1252"), mts: ("dat", "utf-8"), times_of_day: ("csv", "utf-8"),
}  # fmt: skip
"""Writers of texts, the ending of their files and their encoding."""


@pytest.mark.parametrize("write", EXPORTS, ids=lambda write: write.__name__)
def test_the_map_that_inspect_proposes_reads_an_export_as_the_bench_was(
    write: Callable[[StateArray], list[str]], tmp_path: Path, nominal: StateArray
) -> None:
    states, (ending, encoding) = nominal[:4000], EXPORTS[write]
    path = tmp_path / f"run.{ending}"
    path.write_text("\n".join(write(states)), encoding=encoding, newline="\r\n")
    found = read_table(path, propose_sources(columns_of(path), BENCH))
    expected = NUMBERED if write is numbered else FIELDS
    assert set(found.columns) == set(expected)
    np.testing.assert_allclose(np.diff(found.time), 1e-3, atol=1e-9)
    for field in expected:
        np.testing.assert_allclose(found.columns[field], states[field], rtol=1e-9, atol=1e-12, err_msg=field)


def test_times_of_twelve_hours_go_on_over_a_cell_without_one_and_a_header_among_them(tmp_path: Path) -> None:
    clock = datetime(2026, 12, 31, 11, 59, 40)
    moments = [f"{clock + timedelta(seconds=k):%I:%M:%S,250 %p}" for k in range(60)]
    moments[7] = "--"
    lines = [f"{moment};{k};{-k};{2 * k},5" for k, moment in enumerate(moments)]
    head = "Time;F [N];p_a [bar];p_b [bar]"
    (tmp_path / "log.csv").write_text("\n".join([head, *lines[:40], head, *lines[40:]]))
    time, force, *_ = columns_of(tmp_path / "log.csv").series.values()
    told = np.isfinite(time)
    assert told.sum() == 59
    np.testing.assert_allclose((time - force)[told], 43180.25, rtol=0.0, atol=1e-9)


def test_a_matrix_without_names_is_mapped_by_the_bench_s_equations(tmp_path: Path, nominal: StateArray) -> None:
    """In MATLAB's two formats, in any order and with any sensor but the pressures left out."""
    everything = ["load_force", "pressure_b", "valve_current", "hydraulic_force", "piston_position", "pressure_a",
                  "reference_force"]  # fmt: skip
    cases = (
        (everything, ["s", "N", "bar", "mA", "N", "mm", "bar", "N"]),
        (everything[::-1], ["s", "N", "Pa", "m", "kN", "A", "Pa", "kN"]),
        ([field for field in everything if field != "hydraulic_force"], ["ms", "N", "MPa", "mA", "mm", "MPa", "N"]),
        (everything[1:], ["s", "bar", "mA", "N", "mm", "bar", "N"]),
    )
    old, new = tmp_path / "old.mat", tmp_path / "new.mat"
    for fields, units in cases:
        matrix = np.column_stack(columns(nominal, units, fields))
        savemat(old, {"data": matrix})
        with h5py.File(new, "w", userblock_size=512) as content:
            content.create_dataset("data", data=matrix.T)
        for path in (old, new):
            found = read_table(path, propose_sources(columns_of(path), BENCH))
            assert set(found.columns) == set(fields)
            for field in fields:
                np.testing.assert_allclose(found.columns[field], nominal[field], rtol=1e-9, atol=1e-12, err_msg=field)
    larger = replace(BENCH, piston_area=2.0 * BENCH.piston_area)
    proposed = propose_sources(columns_of(new), larger).sources
    assert set(proposed) == {"time"}, "another bench's numbers fulfil no equation"


def test_a_double_rod_without_names_is_mapped_though_one_pressure_falls_as_the_other_rises() -> None:
    """No hydraulic force; the load cell is 4 % off and has noise, the reference leads it by 24 ms and has none."""
    bench = replace(BENCH, piston_area=8e-4, area_ratio=1.0, spring_stiffness=60e3, stroke=0.16)
    time, noise = 2e-3 * np.arange(6000), np.random.default_rng(1).normal(size=(6, 6000))

    def force(at: FloatArray) -> FloatArray:
        return np.asarray(900.0 * np.sin(5.0 * at) + 500.0 * np.sin(17.0 * at))

    rate = np.gradient(force(time), time)
    pushed = (force(time) + 45.0 * np.sign(rate)) / (2.0 * bench.piston_area * 1e5)
    series = {
        "c1": 1e3 * time, "c2": 1e-3 * (1.04 * force(time) + 2.0 * noise[0]), "c3": 1e-3 * force(time + 0.024),
        "c4": 60.0 + pushed + 0.1 * noise[1], "c5": 60.0 - pushed + 0.1 * noise[2],
        "c6": 40.0 + force(time) / 60.0 + 1e-3 * noise[3], "c7": 1e-3 * rate + 0.01 * noise[4],
        "c8": 41.0 + 0.03 * time + 0.05 * noise[5],
    }  # fmt: skip
    units = {"time": "ms", "load_force": "kN", "reference_force": "kN", "pressure_a": "bar", "pressure_b": "bar",
             "piston_position": "mm", "valve_current": "mA"}  # fmt: skip
    with_units = [f"{name} [{unit}]" for name, unit in zip(series, (*units.values(), "°C"), strict=True)]
    for names in (list(series), with_units):
        found = propose_sources(Columns(dict(zip(names, series.values(), strict=True))), bench).sources
        assert {field: source.column for field, source in found.items()} == dict(zip(units, names, strict=False))
        assert {field: source.unit for field, source in found.items()} == units


def test_temperatures_and_flows_are_no_pressures_and_positions(tmp_path: Path, nominal: StateArray) -> None:
    """Named and sized as if they were, in brackets behind the name or in a row of units."""
    states = nominal[:3000]
    names, units = ["t", "Chamber A", "q", "pB", "Kolbenweg"], ["s", "°C", "l/min", "bar", "Hz"]
    values = [1e-3 * np.arange(len(states)), 40.0 + states["piston_position"], 1e3 * states["valve_current"],
              1e-5 * states["pressure_b"], 1e3 * states["piston_position"]]  # fmt: skip
    path = tmp_path / "run.csv"
    brackets = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]
    for head in ([brackets], [names, units]):
        path.write_text("\n".join([*map(",".join, head), *rows(values, ",")]))
        assert set(propose_sources(columns_of(path), BENCH).sources) == {"time", "pressure_b"}
        with pytest.raises(InputError, match="is in degC, pressure_a is a pressure: give a factor"):
            read_table(path, ColumnMap.load(f"time='{head[0][0]}',pressure_a='{head[0][1]}'"))


def test_texts_beside_a_matrix_name_its_columns(tmp_path: Path) -> None:
    matrix, names = np.arange(15.0).reshape(5, 3) ** 2, np.array(["t", "x", "pA"], dtype=object)
    signals = [{"values": matrix[:, k], "label": name, "dimensions": 1.0} for k, name in enumerate(names)]
    path = tmp_path / "log.mat"
    savemat(path, {"log": {"data": matrix, "colheaders": names, "units": np.array(["s", "mm", "bar"], dtype=object)},
                   "out": {"signals": np.array(signals, dtype=object)}, "note": "cold"})  # fmt: skip
    found = columns_of(path).series
    log, out = ["log.data.t [s]", "log.data.x [mm]", "log.data.pA [bar]"], "out.signals.{}.values.{}"
    assert list(found) == [*log, *(out.format(k, name) for k, name in enumerate(names))]
    np.testing.assert_array_equal(np.column_stack(list(found.values())), np.hstack([matrix, matrix]))


def test_milliseconds_without_a_unit_and_sensors_in_every_fifth_row_only(tmp_path: Path, nominal: StateArray) -> None:
    states, fields = nominal[:4000], FIELDS[:-1]
    values = columns(states, ["ms", "mm", "bar", "bar", "kN", "mA"], fields)
    for slow in values[2:5]:
        slow[np.arange(len(slow)) % 5 != 0] = np.nan
    path = tmp_path / "two_rates.csv"
    path.write_text("\n".join(["t,x,pa,pb,f_load,i", *rows(values, ",")]))
    found = read_table(path, propose_sources(columns_of(path), BENCH))
    np.testing.assert_allclose(np.diff(found.time), 5e-3, atol=1e-9)
    assert set(found.columns) == set(fields)
    for field in fields[:-1]:
        np.testing.assert_allclose(found.columns[field], states[field][::5], rtol=1e-9, err_msg=field)
