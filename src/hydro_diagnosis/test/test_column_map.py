# SPDX-License-Identifier: Apache-2.0
"""Column maps, and the map that is proposed for exports of loggers and for columns without names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from hydro_core.signals import FloatArray, StateArray
from hydro_diagnosis.bench_parameters import parse_bench
from hydro_diagnosis.column_matching import propose_sources
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import Columns
from hydro_diagnosis.io.table import RawTable, columns_of, read_table
from hydro_diagnosis.io.units import UNIT_FACTORS
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


@pytest.mark.parametrize("name", ["I_term", "integrator", "u_i", "I-Anteil", "PI.I_part", "u_p"])
def test_a_part_of_a_controller_is_no_valve_current(name: str) -> None:
    time = 1e-3 * np.arange(1500)
    series = {"t": time, "x [mm]": 40.0 + 20.0 * np.sin(6.0 * time), name: 5e-3 * np.sin(6.0 * time)}
    assert set(propose_sources(Columns(series), BENCH).sources) == {"time", "piston_position"}


def test_references_stay_references_beside_the_signals() -> None:
    """Names of a scope of a crane; its valve command is relative, from -1 to 1."""
    time = 1e-2 * np.arange(1500)
    place = 0.03 + 0.02 * np.sin(time)
    speed, names = np.gradient(place, time), ("MainXRef", "MainPistonPosition", "MainXDotRef", "MainPistonVelocity")
    series = {"t": time, **dict(zip(names, (place + 1e-3, place, speed, speed), strict=True))}
    series |= {"JibXDotRef": 1.3 * speed, "MainU": 8.0 * speed}
    found = {field: one.column for field, one in propose_sources(Columns(series), BENCH).sources.items()}
    assert found == {"time": "t", "piston_position": "MainPistonPosition", "piston_velocity": "MainPistonVelocity",
                     "valve_current": "MainU"}  # fmt: skip


@pytest.mark.parametrize("bench", [BENCH, parse_bench({"moving_mass": 1.0}, frozenset())])
def test_lone_force_of_a_damper_is_no_force_of_a_spring(bench: Bench) -> None:
    time = 1e-2 * np.arange(3000)
    place = 0.04 + 0.01 * np.sin(time * (1.0 + 0.1 * time))
    load = 300.0 * np.sign(np.gradient(place))
    proposed = propose_sources(Columns({"t": time, "Stroke": place, "Load": load}), bench).sources
    assert proposed["hydraulic_force"].column == "Load" and "load_force" not in proposed


FIELDS = ("piston_position", "pressure_a", "pressure_b", "load_force", "valve_current", "reference_force")
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
    control_desk: ("csv", "cp949"), twin_cat: ("csv", "utf-8"), lab_view: ("lvm", "utf-8"),
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
    assert set(found.columns) == set(FIELDS)
    np.testing.assert_allclose(np.diff(found.time), 1e-3, atol=1e-9)
    for field in FIELDS:
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
