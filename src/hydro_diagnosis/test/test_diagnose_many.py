# SPDX-License-Identifier: Apache-2.0
"""Many recordings: each by itself, into tables; what cannot be diagnosed is named, and the rest is done."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hydro_bridge.bags.recording import BagWriter, read_bag
from hydro_core.signals import FloatArray
from hydro_diagnosis import diagnose_many, trends
from hydro_diagnosis.change_points import fit_trend
from hydro_diagnosis.diagnose_many import split_bag, write_study
from hydro_sim.model.bench import Bench
from tests.checks import status_of
from tests.segments import record


def test_a_folder_becomes_tables_and_only_what_is_missing_is_done(
    worn: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, study = tmp_path / "monday", tmp_path / "study"
    (folder / "late").mkdir(parents=True)
    (folder / "a.csv").write_bytes(worn[0].read_bytes())
    (folder / "broken.csv").write_text("<html></html>", encoding="utf-8")
    (folder / "notes.docx").write_text("no recording", encoding="utf-8")
    assert status_of(diagnose_many.main, folder, "--out", study, "--jobs", 1) == 0
    assert "broken.csv: refused" in capfd.readouterr().err
    before = (study / "reports/a.csv/report.html").stat().st_mtime_ns
    (folder / "late/b.csv").write_bytes(worn[1].read_bytes())
    assert status_of(diagnose_many.main, folder, "--out", study, "--jobs", 1) == 0
    assert (study / "reports/a.csv/report.html").stat().st_mtime_ns == before
    assert (study / "reports/late/b.csv/report.html").is_file()
    diagnoses = pd.read_parquet(study / "diagnoses.parquet").set_index("recording")
    parameters = pd.read_parquet(study / "parameters.parquet")
    assert list(diagnoses.index) == ["a.csv", "broken.csv", "late/b.csv"]
    assert diagnoses.verdict["a.csv"] == "explained" and "web page" in diagnoses.refused["broken.csv"]
    springs = parameters[parameters.cause == "spring_stiffness"]
    assert sorted(springs.recording) == ["a.csv", "late/b.csv"]
    assert (springs.low < 0.925).all() and (springs.high > 0.925).all() and set(springs.parameter) == {"ratio"}


def test_each_part_of_a_long_bag_is_diagnosed_by_itself(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "day") as writer:
        for k, stiffness in enumerate((20000.0, 18500.0)):
            states = record(replace(Bench.nominal(), spring_stiffness=stiffness), seed=k, seconds=11.0)
            states["time"] += 12.0 * k
            writer.write_states(states)
    assert status_of(diagnose_many.main, tmp_path / "day", "--every", 12, "--out", tmp_path / "study", "--jobs", 1) == 0
    diagnoses = pd.read_parquet(tmp_path / "study/diagnoses.parquet")
    assert list(diagnoses.recording) == ["day#t=0,12", "day#t=12,"]
    assert list(map(list, diagnoses.causes)) == [[], ["spring_stiffness"]]
    assert (diagnoses.begin[1] - diagnoses.begin[0]).total_seconds() == 12.0
    assert (tmp_path / "study/reports/day/12,/report.html").is_file()


def test_no_part_reaches_across_a_gap_or_a_set_clock(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    states = record(Bench.nominal(), seed=0, seconds=8.0)
    states["time"] += 1e9
    begin = float(states["time"][0])
    states["time"][:3] = 0.0  # three samples before the clock was set, then 300 days later the rest
    states["time"][4000:] += 300 * 86400.0
    with BagWriter(tmp_path / "day") as writer:
        writer.write_states(states)
    found = [part.partition("#t=")[2] for part in split_bag("day", tmp_path / "day", 2.0)]
    assert len(found) == 5 and found[-1].endswith(",")
    for part, rows in zip(found, (3, 1997, 2000, 2000, 2000), strict=True):
        assert len(read_bag(f"{tmp_path / 'day'}#t={part}").state) == pytest.approx(rows, abs=4)
    assert float(found[1].partition(",")[0]) == pytest.approx(begin + 0.003, abs=5e-3)
    assert capsys.readouterr().err.count("no part of it") == 2


DAYS = 60


def study(folder: Path, leak: FloatArray) -> Path:
    """A recording a day; a leak below three standard deviations is not claimed."""
    rng, sd, found = np.random.default_rng(0), 2e-14, {}
    for day, true in enumerate(leak):
        value = float(true + np.sqrt(2.0) * sd * rng.standard_normal())
        begin = {"begin": round(86400e6 * (day + 20000))}
        number = {"cause": "leakage_internal", "options": "form=laminar", "parameter": "coefficient", "value": value,
                  "low": value - 1.96 * sd, "high": value + 1.96 * sd, "unit": "m3/s/Pa"}  # fmt: skip
        found[f"{day:02d}.mcap"] = {
            "diagnosis": {**begin, "verdict": "explained"},
            "parameters": [{**begin, **number}] if value > 3.0 * sd else [],
        }
    folder.mkdir()
    write_study(folder, found)
    return folder


def test_wear_raises_the_alarm_once_and_its_limit_is_dated(tmp_path: Path) -> None:
    leak = 2e-14 * np.maximum(np.arange(DAYS) - 30.0, 0.0)
    worn, well = study(tmp_path / "worn", leak), study(tmp_path / "well", 0.0 * leak + 1e-13)
    table, page = tmp_path / "t.json", tmp_path / "all.html"
    assert status_of(trends.main, well, "--new", 40) == 0
    assert status_of(trends.main, well, worn, "--new", 40, "--json", table, "--page", page) == trends.ALARM_EXIT_STATUS
    assert status_of(trends.main, worn, "--new", 1) == 0  # it was known the day before
    first, second = json.loads(table.read_text(encoding="utf-8"))["rows"]
    assert (first["bench"], second["since"]) == (str(worn), None)
    assert first["from"] <= str(np.datetime64(20030, "D")) <= first["to"]
    assert abs((np.datetime64(first["since"]) - np.datetime64(20030, "D")).astype(int)) <= 5
    assert "worn" in (shown := page.read_text(encoding="utf-8")) and shown.count("<svg") == 2
    limit = ("--limit", "leakage_internal.coefficient=8e-13", "--json", table)  # reached on day 70
    assert status_of(trends.main, worn, *limit, "--horizon", 5) == 0
    assert status_of(trends.main, worn, *limit, "--horizon", 30) == trends.ALARM_EXIT_STATUS
    (row,) = json.loads(table.read_text(encoding="utf-8"))["rows"]
    assert row["limit_first"] < str(np.datetime64(20070, "D")) < row["limit_last"]
    assert status_of(trends.main, worn, "--limit", "leek.coefficient=1") == 2


@pytest.mark.parametrize("scale", [1e-15, 1e6])  # a leak and a pressure
def test_wear_and_repair_are_both_dated_and_scatter_is_not(scale: float) -> None:
    rng, time = np.random.default_rng(1), np.arange(200.0)
    noise, sd = rng.standard_normal(200), np.full(200, 0.3)
    noise[::40] += 15.0  # wrong values
    worn = np.where((time >= 80) & (time < 140), 0.2 * (time - 80), 0.0)
    found, quiet = (fit_trend(time, scale * one, scale * sd) for one in (noise + worn, noise))
    assert found and quiet and not quiet.finding_count
    begin, repair = found.changes
    assert begin.earliest - 5 <= 80 <= begin.latest + 5 and repair.time == 140


def test_scatter_that_lasts_for_days_is_no_wear() -> None:
    time, told = np.arange(120.0), 0
    for seed in range(20):
        lasting, own = np.random.default_rng(seed).standard_normal((2, 120))
        for day in range(1, 120):
            lasting[day] = 0.7 * lasting[day - 1] + np.sqrt(1.0 - 0.7**2) * lasting[day]
        found = fit_trend(time, lasting + own, np.ones(120))
        told += found.finding_count if found else 0
    assert told <= 1


def test_the_manuals_queries_give_the_same_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study(tmp_path / "study", np.full(3, 1e-13))
    monkeypatch.chdir(tmp_path)
    page = next(Path(__file__).parents[3].glob("docs/manual/how-to/many_recordings.md")).read_text(encoding="utf-8")
    (queries,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(queries, names := {})
    frames = [names["by_pandas"], names["by_polars"].to_pandas(), names["by_duckdb"].df()]
    rows = [leaks.sort_values("recording").to_numpy().tolist() for leaks in frames]
    assert rows[0] == rows[1] == rows[2] and [len(row) for row in rows[0]] == [4, 4, 4]
