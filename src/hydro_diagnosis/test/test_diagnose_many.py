# SPDX-License-Identifier: Apache-2.0
"""Many recordings: each by itself, into tables; what cannot be diagnosed is named, and the rest is done."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import StateArray
from hydro_diagnosis import diagnose_many
from hydro_sim.model.bench import Bench


def ran(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["diagnose_many", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        diagnose_many.main()
    return int(ended.value.code or 0)


def test_a_folder_becomes_tables_and_only_what_is_missing_is_done(
    worn: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, study = tmp_path / "monday", tmp_path / "study"
    (folder / "late").mkdir(parents=True)
    for path, name in zip(worn[:2], ("a.csv", "late/b.csv"), strict=True):
        (folder / name).write_bytes(path.read_bytes())
    (folder / "broken.csv").write_text("<html></html>", encoding="utf-8")
    (folder / "notes.docx").write_text("no recording", encoding="utf-8")
    assert ran(monkeypatch, folder, "--out", study, "--jobs", 1) == 0
    assert "broken.csv: refused" in capfd.readouterr().err
    diagnoses = pd.read_parquet(study / "diagnoses.parquet").set_index("recording")
    parameters = pd.read_parquet(study / "parameters.parquet")
    assert list(diagnoses.index) == ["a.csv", "broken.csv", "late/b.csv"]
    assert diagnoses.verdict["a.csv"] == "explained" and "web page" in diagnoses.refused["broken.csv"]
    springs = parameters[parameters.cause == "spring_stiffness"]
    assert sorted(springs.recording) == ["a.csv", "late/b.csv"]
    assert (springs.low < 0.925).all() and (springs.high > 0.925).all() and set(springs.parameter) == {"ratio"}
    reports = [study / "reports" / name / "report.html" for name in ("a.csv", "late/b.csv")]
    before = [path.stat().st_mtime_ns for path in reports]
    (folder / "c.csv").write_bytes(worn[2].read_bytes())
    assert ran(monkeypatch, folder, "--out", study, "--jobs", 1) == 0
    assert [path.stat().st_mtime_ns for path in reports] == before
    assert len(pd.read_parquet(study / "diagnoses.parquet")) == 4


def test_where_nothing_is_a_sentence_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    assert ran(monkeypatch, tmp_path / "*.csv", "--out", tmp_path / "study") == 2
    assert "there is no recording" in capfd.readouterr().err
    assert not (tmp_path / "study").exists()


def test_each_part_of_a_long_bag_is_diagnosed_by_itself(
    tmp_path: Path, record: Callable[..., StateArray], monkeypatch: pytest.MonkeyPatch
) -> None:
    with BagWriter(tmp_path / "day") as writer:
        for k, stiffness in enumerate((20000.0, 18500.0)):
            states = record(replace(Bench.nominal(), spring_stiffness=stiffness), seed=k, seconds=11.0)
            states["time"] += 12.0 * k
            writer.write_states(states)
    assert ran(monkeypatch, tmp_path / "day", "--every", 12, "--out", tmp_path / "study", "--jobs", 1) == 0
    diagnoses = pd.read_parquet(tmp_path / "study/diagnoses.parquet")
    assert list(diagnoses.recording) == ["day#t=0,12", "day#t=12,"]
    assert list(map(list, diagnoses.causes)) == [[], ["spring_stiffness"]]
    assert (diagnoses.begin[1] - diagnoses.begin[0]).total_seconds() == 12.0
    assert (tmp_path / "study/reports/day/12,/report.html").is_file()
