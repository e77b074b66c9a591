# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from hydro_bridge.signals import StateArray
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import Columns
from hydro_diagnosis.io.table import RawTable, columns_of, read_table
from hydro_diagnosis.listing import improbable, proposed
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.recording import InputError
from hydro_sim.model.bench import Bench

Frame = Callable[[StateArray], pd.DataFrame]
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


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mat"])
def test_formats_agree_to_the_bit(suffix: str, tmp_path: Path, nominal: StateArray, frame: Frame) -> None:
    data = frame(nominal)
    path = tmp_path / f"run{suffix}"
    if suffix == ".csv":
        data.to_csv(path, index=False)
    elif suffix == ".parquet":
        data.to_parquet(path)
    else:
        savemat(path, {name: data[name].to_numpy()[:, None] for name in data})
    segment = checked(read_table(path), Bench.nominal()).segments[0]
    np.testing.assert_array_equal(segment.channels["pressure_a"], nominal["pressure_a"])
    np.testing.assert_array_equal(segment.channels["valve_current"], nominal["valve_current"])


def test_matrices_and_structs_become_columns(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    signals = [{"values": np.arange(5.0)}, {"values": np.ones((2, 5))}]
    savemat(path, {"out": {"time": np.arange(5.0)[:, None], "signals": np.array(signals, dtype=object)}})
    columns = "time=out.time,valve_current=out.signals.0.values,pressure_a=out.signals.1.values.1"
    table = read_table(path, ColumnMap.load(columns))
    np.testing.assert_array_equal(table.columns["valve_current"], np.arange(5.0))
    np.testing.assert_array_equal(table.columns["pressure_a"], np.ones(5))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("time=t,load_force=vir", "run.mat: there is no column named 't'; there are clock, pos, vir, out.p"),
        ("time=clok,load_force=vir", "did you mean 'clock'"),
        ("time=clock,load_force=vir*gtua", "no single number named 'gtua' .did you mean 'gtau'"),
        (
            "time=clock,piston_positon=pos",
            "'piston_positon' is not a field of a recording, did you mean 'piston_position'",
        ),
        ("time=clock,foo=pos", "there are time, hydraulic_force"),
        ("time=clock,load_force=vir[furlong]", "unit 'furlong' is unknown; there are s, ms"),
        ("time=clock,load_force", "'load_force' is not FIELD=COLUMN"),
        ("time=clock,load_force=vir**2", "cannot be read from '\\*\\*2' on"),
        ("time=3,load_force=vir", "the time cannot be a constant"),
        ("load_force=vir", "no column is the time"),
        (
            {"time": {"column": "clock", "factor": 2}},
            "'factor' is unknown; there are column, unit, scale, offset, delay",
        ),
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


def test_inspect_lists_columns_and_what_they_may_be(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    columns = {"Time": [0, 1], "load_force": [1, 2], "Piston_Position": [1, 2], "foo": ["a", "b"]}
    pressures = {"pressure_a": [1e6, 2e6], "pressure_b": [2e6, 1e6], "p_S [bar]": [138, 142]}
    pd.DataFrame({**columns, **pressures}).to_csv(path)
    command = [sys.executable, "-m", "hydro_diagnosis.listing", str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = {line.split()[1]: line.split() for line in ended.stdout.splitlines() if line.startswith("run.csv")}
    assert rows["Time"][-1] == "time?" and rows["load_force"][-1] == "load_force"
    assert rows["Piston_Position"][-1] == "piston_position?"
    assert "foo" in rows
    assert "the bench file's supply_pressure is 1.4e+07 Pa" in ended.stdout


def test_inspect_says_which_numbers_the_bench_cannot_have(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    pd.DataFrame({"t": np.arange(100) / 1e3, "pA": np.full(100, 60.0), "x": np.full(100, 0.04)}).to_csv(path)
    given = cast(ColumnMap, ColumnMap.load("time=t,pressure_a=pA[kPa],piston_position=x"))
    found = improbable(path, columns_of(path), given, Bench.nominal())
    assert len(found) == 1 and found[0].startswith("pressure_a has numbers") and "in bar, not kPa" in found[0]


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
    sources = proposed(Columns(series), Bench.nominal()).sources
    assert (sources["hydraulic_force"].column, sources["load_force"].column) == (hydraulic, load)


def test_forces_whose_names_say_nothing_are_told_apart_by_the_pressures() -> None:
    bench, time = Bench.nominal(), np.arange(2000) * 1e-3
    load = 200.0 * np.sin(6.0 * time)
    hydraulic = load + 40.0 * np.sign(np.cos(6.0 * time))
    series = {"t": time, "F1 [N]": load, "F2 [N]": hydraulic, "x [mm]": 40.0 + load / 20.0}
    pressures = {"p_a [bar]": 80.0 + 1e-5 * hydraulic / bench.piston_area, "p_b [bar]": np.full(2000, 80.0)}
    sources = proposed(Columns(series | pressures), bench).sources
    assert (sources["hydraulic_force"].column, sources["load_force"].column) == ("F2 [N]", "F1 [N]")
