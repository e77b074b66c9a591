# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.io import savemat

from hydro_core.signals import StateArray
from hydro_diagnosis.column_proposal import propose_sources
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import Columns
from hydro_diagnosis.io.table import RawTable, columns_of, read_table
from hydro_diagnosis.io.units import UNITS
from hydro_diagnosis.recording import InputError
from hydro_sim.model.bench import Bench

MAP = "time=clock[ms],piston_position=pos[mm]-40,pressure_a='p a [bar]'[bar],hydraulic_force=vir*gtau,load_force=0"
YAML = """
time: clock[ms]
piston_position: {column: pos, unit: mm, offset: -40}
pressure_a: {column: "p a [bar]", unit: bar}
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


@pytest.mark.parametrize("form", ["text", "yaml", "mapping"])
def test_every_form_of_a_map_gives_the_same_fields(form: str, tmp_path: Path) -> None:
    path = file(tmp_path)
    (tmp_path / "map.yaml").write_text(YAML.replace('"p a [bar]"', "out.p"))
    text = MAP.replace("'p a [bar]'", "out.p")
    given = {
        "text": text,
        "yaml": tmp_path / "map.yaml",
        "mapping": dict(part.split("=") for part in text.split(",")),
    }[form]
    same(read_table(path, ColumnMap.load(given)), TRUE)


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
        read_table(file(tmp_path), ColumnMap.load(given))  # type: ignore[arg-type]
    assert "\n" not in str(raised.value)


def test_map_without_a_time_corrects_what_carries_the_fields_names(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    pd.DataFrame({"time": [0, 1, 2], "load_force": [1, 2, 3], "pressure_a": [4, 5, 6], "pressure_b": [7, 8, 9]}).to_csv(
        path
    )
    columns = ColumnMap.load("load_force=load_force*-1,pressure_a=none")
    assert columns is not None and str(columns) == "load_force=load_force*-1,pressure_a=none"
    same(read_table(path, columns), {"time": [0, 1, 2], "load_force": [-1, -2, -3], "pressure_b": [7, 8, 9]})


def same(table: RawTable, true: dict[str, list[float]]) -> None:
    assert set(table.columns) | {"time"} == set(true)
    for name, values in true.items():
        np.testing.assert_allclose(
            table.time if name == "time" else table.columns[name], values, rtol=1e-12, atol=1e-15
        )


@pytest.mark.parametrize(
    ("hydraulic", "load"),
    [("Kraft Zylinder [N]", "Kraft Feder [kN]"), ("Fcyl", "Fspring"), ("Kolbenkraft [N]", "Kraft [N]")],
)
def test_two_forces_are_told_apart_by_what_they_act_on(hydraulic: str, load: str) -> None:
    time = np.arange(500) * 1e-3
    force = 200.0 * np.sin(6.0 * time)
    series = {"t": time, load: force / (1e3 if "kN" in load else 1.0), hydraulic: 1.1 * force}
    sources = propose_sources(Columns(series), Bench.nominal()).sources
    assert (sources["hydraulic_force"].column, sources["load_force"].column) == (hydraulic, load)


def test_forces_whose_names_say_nothing_are_told_apart_by_the_pressures() -> None:
    bench, time = Bench.nominal(), np.arange(2000) * 1e-3
    load = 200.0 * np.sin(6.0 * time)
    hydraulic = load + 40.0 * np.sign(np.cos(6.0 * time))
    series = {"t": time, "F1 [N]": load, "F2 [N]": hydraulic, "x [mm]": 40.0 + load / 20.0}
    pressures = {"p_a [bar]": 80.0 + 1e-5 * hydraulic / bench.piston_area, "p_b [bar]": np.full(2000, 80.0)}
    sources = propose_sources(Columns(series | pressures), bench).sources
    assert (sources["hydraulic_force"].column, sources["load_force"].column) == ("F2 [N]", "F1 [N]")


Array = npt.NDArray[np.float64]
FIELDS = ("piston_position", "pressure_a", "pressure_b", "load_force", "valve_current", "reference_force")


def columns(states: StateArray, units: Sequence[str], fields: Sequence[str] = FIELDS) -> list[Array]:
    """The time [unit] and the fields, each in its unit of the file, shape (n,)."""
    values = [np.arange(len(states)) * 1e-3, *(states[field] for field in fields)]
    return [one / UNITS[unit] for one, unit in zip(values, units, strict=True)]


def rows(values: Sequence[Array], separator: str, decimal: str = ".", first: Sequence[str] = ()) -> list[str]:
    """Lines of numbers; where the lines begin with a key, the first of `first`, then empty cells."""
    lines = [separator.join(repr(float(one)).replace(".", decimal) for one in row) for row in zip(*values, strict=True)]
    return [f"{first[0] if k == 0 else ''}{separator}{line}" for k, line in enumerate(lines)] if first else lines


def control_desk(states: StateArray) -> bytes:
    """ControlDesk 7.2: rows of keys, among them numbers; one raster; names of ports, told apart by their path."""
    units = ["s", "mm", "bar", "bar", "N", "mA", "N"]
    blocks = ["", "Position", "pA", "pB", "LoadCell", "ServoValve", "ForceRef"]
    ports = ["xAxis", *["In1"] * 6]
    keyed: dict[str, Sequence[object]] = {
        "descriptions": ["General", "", "Recording", "", "Measurement"],
        "": ["Author", "Lee", "Name", "exp1_002"],
        "trace_size": [len(states)] * 7,
        "trace_types": ["xAxis", *["yAxis"] * 6],
        "trace_names": ports,
        "trace_units": units,
        "devices": ["Platform"] * 7,
        "raster": ["HostService"] * 7,
        "description": ["실험", *["측정"] * 6],
        "displayidentifier": ports,
        "path": ["", *(f"Platform()://Model Root/{block}/In1" for block in blocks[1:])],
        "flags": [0, *[1] * 6],
        "min": [0, *[-1e3] * 6],
        "max": [0, *[1e3] * 6],
        "minWeak": [0] * 7,
        "maxWeak": [0] * 7,
    }
    head = [",".join([key, *map(str, cells)]) for key, cells in keyed.items()]
    return "\r\n".join([*head, *rows(columns(states, units), ",", first=["trace_values"])]).encode("cp949")


def numbered(states: StateArray) -> bytes:
    """Channels without names: units alone, and what the numbers are to each other."""
    fields = ("pressure_b", "piston_position", "load_force", "pressure_a", "valve_current", "hydraulic_force")
    units = ["s", "bar", "mm", "kN", "bar", "mA", "kN"]
    head = ["\t".join(f"CH{k}" for k in range(7)), "\t".join(units)]
    return "\n".join([*head, *rows(columns(states, units, fields), "\t")]).encode()


def twin_cat(states: StateArray) -> bytes:
    """TwinCAT Scope's export tool in Germany: pairs of key and value, and of milliseconds and value, per channel."""
    units = ["ms", "mm", "bar", "bar", "N", "mA", "N"]
    names = ["fPos", "fDruckA", "fDruckB", "fKraft", "fVentilstrom", "fKraftSoll"]
    keyed = {
        "Name": names, "SymbolComment": [""] * 6, "Data-Type": ["REAL64"] * 6, "SampleTime[ms]": ["1"] * 6,
        "VariableSize": ["8"] * 6, "SymbolBased": ["True"] * 6, "IndexGroup": ["16448"] * 6,
        "IndexOffset": ["328147"] * 6, "SymbolName": [f"MAIN.{name}" for name in names],
        "NetID": ["192.168.1.1.1.1"] * 6, "Port": ["851"] * 6, "Offset": ["0"] * 6, "ScaleFactor": ["1"] * 6,
        "BitMask": ["0xffffffffffffffff"] * 6, "Unit": units[1:], "Unit ScaleFactor": ["1"] * 6,
    }  # fmt: skip
    head = ["Name\tYT Scope Project", "File\tD:\\Messung\\p3.svdx", "Starttime of export\t133238090039920000\tMontag",
            "Endtime of export\t133238090079920000\tMontag", ""]  # fmt: skip
    head += ["\t".join(f"{key}\t{value}" for value in values) for key, values in keyed.items()]
    time, *rest = columns(states, units)
    return "\r\n".join(
        [*head, "", *rows([one for values in rest for one in (time, values)], "\t", ","), "EOF"]
    ).encode()


def lab_view(states: StateArray) -> bytes:
    """LabVIEW's measurement file without a column of times: its step stands in the header."""
    units = ["s", "mm", "bar", "bar", "N", "mA", "N"]
    names = ["Position", "Pressure A", "Pressure B", "Load cell", "Valve current", "Force reference"]
    count = len(names)
    keyed = {
        "Channels": ["6"], "Samples": [str(len(states))] * count, "Date": ["2019/07/22"] * count,
        "Time": ["17:18:18,938945770263671875"] * count, "Y_Unit_Label": units[1:], "X_Dimension": ["Time"] * count,
        "X0": ["0,0000000000000000E+0"] * count, "Delta_X": ["0,001000"] * count, "***End_of_Header***": [""],
    }  # fmt: skip
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t,",
            "Multi_Headings\tNo", "X_Columns\tNo", "Time_Pref\tRelative", "Operator\tEveline", "Date\t2019/07/22",
            "Time\t17:18:18,938945770263671875", "***End_of_Header***", ""]  # fmt: skip
    head += ["\t".join([key, *values]) for key, values in keyed.items()]
    return "\r\n".join(
        [*head, "\t".join(["X_Value", *names, "Comment"]), *rows(columns(states, units)[1:], "\t", ",", first=[""])]
    ).encode()


def inca(states: StateArray) -> bytes:
    """ETAS INCA's text: a row of types between names and quoted units; a tab ends each row."""
    units = ["s", "mm", "bar", "bar", "N", "A", "N"]
    names = ["time", "s_Kolben\\CAN:1", "p_A\\ADC:1", "p_B\\ADC:1", "F_Mess\\ADC:1", "I_Ventil\\ADC:1", "F_Soll\\CAN:1"]
    keyed = [names, ["f8"] * 7, [f'"{unit}"' for unit in units]]
    head = ["ETASAsciiItemFile\trecord\tCrLf\tTab", f"sampleCount\t{len(states):<15}", *map("\t".join, keyed)]
    return "\r\n".join(f"{row}\t" for row in [*head, *rows(columns(states, units), "\t")]).encode("cp1252")


def mts(states: StateArray) -> bytes:
    """MTS: a header, names and units before each block of a test."""
    units = ["s", "mm", "bar", "bar", "kN", "mA", "kN"]
    names = ["Running Time", "Axial Displacement", "Pressure A", "Pressure B", "Axial Force", "Servovalve Current",
             "Axial Force Command"]  # fmt: skip
    lines = rows(columns(states, units), "\t")
    result = ["MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A"]
    for k in range(0, len(lines), 1500):
        result += ["", f"Data Acquisition\t\t\t\t\t\tTime:\t{k * 1e-3}\tSec\t3/29/2016 1:54:32 PM", "\t".join(names),
                   "\t".join(units), *lines[k : k + 1500]]  # fmt: skip
    return "\r\n".join(result).encode()


def times_of_day(states: StateArray) -> bytes:
    """A PLC's log: dates and times, past midnight."""
    start, units = datetime(2026, 12, 31, 23, 59, 58), ["s", "mm", "bar", "bar", "N", "mA", "N"]
    names = ["Weg [mm]", "Druck A [bar]", "Druck B [bar]", "Kraft [N]", "Strom [mA]", "Sollwert [N]"]
    moments = (start + timedelta(milliseconds=k) for k in range(len(states)))
    lines = rows(columns(states, units)[1:], ";", ",")
    stamped = (f"{moment:%d.%m.%Y %H:%M:%S,%f};{line}" for moment, line in zip(moments, lines, strict=True))
    return "\n".join([";".join(["Datum/Uhrzeit", *names]), *stamped]).encode()


EXPORTS = {control_desk: "csv", numbered: "csv", twin_cat: "csv", lab_view: "lvm",
           inca: "ascii", mts: "dat", times_of_day: "csv"}  # fmt: skip
"""Writers of texts, and the ending of their files."""


@pytest.mark.parametrize("write", EXPORTS, ids=lambda write: write.__name__)
def test_the_map_that_inspect_proposes_reads_an_export_as_the_bench_was(
    write: Callable[[StateArray], bytes], tmp_path: Path, nominal: StateArray
) -> None:
    states = nominal[:4000]
    path = tmp_path / f"run.{EXPORTS[write]}"
    path.write_bytes(write(states))
    found = read_table(path, propose_sources(columns_of(path), Bench.nominal()))
    expected = set(FIELDS) if write is not numbered else {*FIELDS[:-1], "hydraulic_force"}
    assert set(found.columns) == expected
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


def test_a_matrix_without_names_and_units_is_mapped_by_the_equations_of_the_bench(
    tmp_path: Path, nominal: StateArray
) -> None:
    """In MATLAB's two formats, in any order and with any sensor but the pressures left out."""
    everything = ("load_force", "pressure_b", "valve_current", "hydraulic_force", "piston_position", "pressure_a",
                  "reference_force")  # fmt: skip
    cases = (
        (everything, ["s", "N", "bar", "mA", "N", "mm", "bar", "N"]),
        (everything[::-1], ["s", "N", "Pa", "m", "kN", "A", "Pa", "kN"]),
        ([field for field in everything if field != "hydraulic_force"], ["ms", "N", "MPa", "mA", "mm", "MPa", "N"]),
        ([field for field in everything if field != "load_force"], ["s", "bar", "mA", "N", "mm", "bar", "N"]),
    )
    for fields, units in cases:
        matrix = np.column_stack(columns(nominal, units, fields))
        savemat(tmp_path / "old.mat", {"data": matrix})
        with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
            file.create_dataset("data", data=matrix.T)
        for name in ("old.mat", "new.mat"):
            path = tmp_path / name
            found = read_table(path, propose_sources(columns_of(path), Bench.nominal()))
            assert set(found.columns) == set(fields)
            for field in fields:
                np.testing.assert_allclose(found.columns[field], nominal[field], rtol=1e-9, atol=1e-12, err_msg=field)
    larger = replace(Bench.nominal(), piston_area=2.0 * Bench.nominal().piston_area)
    assert set(propose_sources(columns_of(path), larger).sources) == {"time"}, (
        "another bench's numbers fulfil no equation"
    )


def test_a_double_rod_without_names_is_mapped_though_one_pressure_falls_as_the_other_rises() -> None:
    """No hydraulic force; the load cell is 4 % off and has noise, the reference leads it by 24 ms and has none."""
    bench = replace(Bench.nominal(), piston_area=8e-4, area_ratio=1.0, spring_stiffness=60e3, stroke=0.16)
    time, noise = 2e-3 * np.arange(6000), np.random.default_rng(1).normal(size=(6, 6000))

    def force(at: Array) -> Array:
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
    expected = {field: f"c{number}" for field, number in zip(units, (1, 2, 3, 4, 5, 6, 7), strict=True)}
    for named in (False, True):
        names = {f"c{k}": f"c{k} [{unit}]" for k, unit in enumerate((*units.values(), "°C"), 1)} if named else {}
        found = propose_sources(Columns({names.get(name, name): values for name, values in series.items()}), bench)
        assert {field: source.column for field, source in found.sources.items()} == {
            field: names.get(name, name) for field, name in expected.items()
        }
        assert {field: source.unit for field, source in found.sources.items()} == units


def test_temperatures_and_flows_are_no_pressures_and_positions(tmp_path: Path, nominal: StateArray) -> None:
    """Named and sized as if they were, in brackets behind the name or in a row of units."""
    states = nominal[:3000]
    names, units = ["t", "Chamber A", "q", "pB", "Kolbenweg"], ["s", "°C", "l/min", "bar", "Hz"]
    values = [1e-3 * np.arange(len(states)), 40.0 + states["piston_position"], 1e3 * states["valve_current"],
              1e-5 * states["pressure_b"], 1e3 * states["piston_position"]]  # fmt: skip
    path = tmp_path / "run.csv"
    brackets = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]
    for head in (brackets, names):
        row = [] if head == brackets else [",".join(units)]
        path.write_text("\n".join([",".join(head), *row, *rows(values, ",")]))
        assert set(propose_sources(columns_of(path), Bench.nominal()).sources) == {"time", "pressure_b"}
        with pytest.raises(InputError, match="is a temperature, in degC: no field is one"):
            read_table(path, ColumnMap.load(f"time='{head[0]}',pressure_a='{head[1]}'"))


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
    states = nominal[:4000]
    units = ["ms", "mm", "bar", "bar", "kN", "mA"]
    values = np.column_stack(columns(states, units, FIELDS[:-1]))
    values[np.arange(len(values)) % 5 != 0, 2:5] = np.nan
    cells = [",".join("" if np.isnan(one) else repr(float(one)) for one in row) for row in values]
    path = tmp_path / "two_rates.csv"
    path.write_text("\n".join(["t,x,pa,pb,f_load,i", *cells]))
    found = read_table(path, propose_sources(columns_of(path), Bench.nominal()))
    np.testing.assert_allclose(np.diff(found.time), 5e-3, atol=1e-9)
    assert set(found.columns) == set(FIELDS[:-1])
    for field in FIELDS[:-2]:
        np.testing.assert_allclose(found.columns[field], states[field][::5], rtol=1e-9, err_msg=field)
