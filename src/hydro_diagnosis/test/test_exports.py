# SPDX-License-Identifier: Apache-2.0
"""Exports of other programs, as they name, space and encode their columns: `inspect` finds the whole map by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import pytest
from scipy.io import savemat

from hydro_bridge.signals import StateArray
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import UNITS
from hydro_diagnosis.io.table import columns_of, read_table
from hydro_diagnosis.listing import proposed
from hydro_diagnosis.recording import InputError
from hydro_sim.model.bench import Bench

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


def german(states: StateArray) -> bytes:
    units = ["s", "mm", "bar", "bar", "kN", "mA", "N"]
    names = ["Zeit", "Zylinderweg", "Druck A", "Druck B", "Kraftmessdose", "Ventilstrom", "Sollkraft"]
    head = ";".join(f"{name} [{unit}]" for name, unit in zip(names, units, strict=True))
    return "\r\n".join(["Prüfstand 3", "", head, *rows(columns(states, units), ";", ",")]).encode("cp1252")


def letters(states: StateArray) -> bytes:
    units = ["s", "m", "Pa", "Pa", "N", "A", "N"]
    return "\n".join(["t,y,pA,pB,F,u,Fset", *rows(columns(states, units), ",")]).encode()


def numbered(states: StateArray) -> bytes:
    """Channels without names: units alone, and what the numbers are to each other."""
    fields = ("pressure_b", "piston_position", "load_force", "pressure_a", "valve_current", "hydraulic_force")
    units = ["s", "bar", "mm", "kN", "bar", "mA", "kN"]
    head = ["\t".join(f"CH{k}" for k in range(7)), "\t".join(units)]
    return "\n".join([*head, *rows(columns(states, units, fields), "\t")]).encode()


EXPORTS = {f.__name__: f for f in (control_desk, german, letters, numbered)}


@pytest.mark.parametrize("name", EXPORTS)
def test_the_map_that_inspect_proposes_reads_an_export_as_the_bench_was(
    name: str, tmp_path: Path, nominal: StateArray
) -> None:
    states = nominal[:4000]
    path = tmp_path / f"{name}.csv"
    path.write_bytes(EXPORTS[name](states))
    found = read_table(path, proposed(columns_of(path), Bench.nominal()))
    expected = set(FIELDS) if name != "numbered" else {*FIELDS[:-1], "hydraulic_force"}
    assert set(found.columns) == expected
    np.testing.assert_allclose(np.diff(found.time), 1e-3, atol=1e-9)
    for field in expected:
        np.testing.assert_allclose(found.columns[field], states[field], rtol=1e-9, atol=1e-12, err_msg=field)


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
            found = read_table(path, proposed(columns_of(path), Bench.nominal()))
            assert set(found.columns) == set(fields)
            for field in fields:
                np.testing.assert_allclose(found.columns[field], nominal[field], rtol=1e-9, atol=1e-12, err_msg=field)
    larger = replace(Bench.nominal(), piston_area=2.0 * Bench.nominal().piston_area)
    assert set(proposed(columns_of(path), larger).sources) == {"time"}, "another bench's numbers fulfil no equation"


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
        assert set(proposed(columns_of(path), Bench.nominal()).sources) == {"time", "pressure_b"}
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
    found = read_table(path, proposed(columns_of(path), Bench.nominal()))
    np.testing.assert_allclose(np.diff(found.time), 5e-3, atol=1e-9)
    assert set(found.columns) == set(FIELDS[:-1])
    for field in FIELDS[:-2]:
        np.testing.assert_allclose(found.columns[field], states[field][::5], rtol=1e-9, err_msg=field)


def test_a_page_that_was_saved_as_a_table_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "download.csv"
    path.write_text("<!DOCTYPE html>\n<html><body>, 404, 1, 2</body></html>\n" + "<p>1,2,3</p>\n" * 40)
    with pytest.raises(InputError, match=r"download\.csv: it is a web page"):
        columns_of(path)
