# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import gc
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from hydro_core.signals import StateArray
from hydro_diagnosis.column_matching import propose_sources
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import columns_of, read_columns, read_table
from hydro_diagnosis.recording import RECORDING_SUFFIXES, InputError
from hydro_sim.model.bench import Bench
from tests import loggers
from tests.checks import ran


@pytest.mark.parametrize("name", loggers.FORMATS)
def test_every_format_holds_what_the_bag_holds(name: str, tmp_path: Path, nominal: StateArray) -> None:
    short, (write, text) = nominal[:4000], loggers.FORMATS[name]
    path = write(tmp_path, short)
    table = read_table(path, ColumnMap.load(text) if text else propose_sources(columns_of(path), Bench.nominal()))
    assert len(table.time) == len(short)
    assert set(table.columns) == {field for field, _, _ in loggers.CHANNELS.values()}
    np.testing.assert_allclose(np.diff(table.time), 1e-3, rtol=1e-3)
    for field, values in table.columns.items():
        np.testing.assert_allclose(values, short[field], rtol=1e-12, atol=1e-15, err_msg=field)
    assert any("/valve" in note and "carry no time" in note for note in table.notes) == (write is loggers.topics)


def test_proposed_map_of_control_desk_is_ready_to_use(tmp_path: Path, nominal: StateArray) -> None:
    path = loggers.control_desk_csv(tmp_path, nominal[:3000])
    command = (sys.executable, "-m", "hydro_diagnosis.inspect_command", path, "--write", tmp_path / "map.yaml")
    shown = ran(*command, check=True).stdout.splitlines()
    (row,) = (line for line in shown if "Model Root/pA/Out1" in line and "pressure_a?" in line)
    assert row.split()[-1] == "pressure_a?" and " bar " in row and " 1000 " in row
    assert any(level in row for level in "▁▂▃▄▅▆▇█")
    assert " 10 " in next(line for line in shown if "T_oil" in line)
    line = next(line for line in shown if "proposed, to be checked" in line)
    for text in (tmp_path / "map.yaml", line.split('--columns "')[1].rstrip('"')):
        pressure = read_table(path, ColumnMap.load(text)).columns["pressure_a"]
        np.testing.assert_allclose(pressure, nominal["pressure_a"][:3000], rtol=1e-12)


def test_current_of_a_faster_clock_is_averaged_about_the_sample_of_each_row(tmp_path: Path) -> None:
    time, fast = np.arange(0.0, 1.0, 2e-3), np.arange(0.0, 1.0, 1e-3)
    path = tmp_path / "two.h5"
    with h5py.File(path, "w") as file:
        file["a/time"], file["a/x"], file["a/p"] = time, np.sin(time), np.cos(time)
        file["b/time"], file["b/i"], file["b/f"] = fast, np.arange(len(fast), dtype=float), np.sin(fast)
    columns = "time=a.time,piston_position=a.x,pressure_a=a.p,valve_current=b.i,load_force=b.f"
    table = read_table(path, ColumnMap.load(columns))
    np.testing.assert_allclose(table.columns["valve_current"][1:-1], 2.0 * np.arange(1, len(time) - 1))
    np.testing.assert_allclose(table.columns["load_force"], np.sin(time), atol=1e-12)
    assert any(note.startswith("valve_current was recorded by the clock 'b.time'") for note in table.notes)


def test_mdf_without_its_library_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    ")
    with pytest.raises(InputError, match=r"asammdf, which is not installed: `python -m pip install asammdf"):
        read_columns(tmp_path / "a.mf4")


@pytest.mark.parametrize("suffix", RECORDING_SUFFIXES)
def test_file_that_is_something_else_is_one_sentence(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"odd{suffix}"
    for content in (b"", b"\x00\x01garbage" * 40, b"words and more words\nwithout a number\n"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"odd{suffix}: .") as raised:
            read_columns(path)
        assert "\n" not in str(raised.value)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("write", [loggers.tdms, loggers.mdf])
def test_a_file_that_was_cut_off_is_read_as_far_as_it_goes_or_one_sentence(
    write: loggers.Write, tmp_path: Path, nominal: StateArray, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, nominal[:1000])
    content = path.read_bytes()
    for share in (0.05, 0.3, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        try:
            assert any("cut off" in note for note in columns_of(path).notes)
        except InputError as error:
            assert "\n" not in str(error)
    gc.collect()
    assert capfd.readouterr() == ("", "")


def test_parts_of_one_recording_are_joined_in_time_and_told_of_else(tmp_path: Path) -> None:
    head, path = "Bench 4;run 1\nt [ms];x [mm]\n", tmp_path / "a.csv"
    parts = ["".join(f"{k},0;{k * k / 100:.2f}\n".replace(".", ",") for k in range(a, a + 50)) for a in (0, 50)]
    for between in (head, head.split("\n", 1)[1], "# event\n"):
        path.write_text(head + parts[0] + between + parts[1] + "end\n")
        found = read_columns(path)
        time, place = found.series.values()
        np.testing.assert_allclose(time, np.arange(100))
        np.testing.assert_allclose(place, np.arange(100) ** 2 / 100)
        assert "joined" in found.notes[0] and not found.clocks
    path.write_text(head + parts[1] + head + parts[0])
    found = read_columns(path)
    assert len(found.series) == 4 and "the time begins again" in found.notes[0]
