# SPDX-License-Identifier: Apache-2.0
"""Many recordings: each by itself, into one table; what cannot be diagnosed is named, and the rest is done."""

from __future__ import annotations

import csv
import os
import signal
from pathlib import Path
from threading import Thread
from time import sleep

import pytest

from hydro_bridge.bags.recording import BagWriter
from hydro_diagnosis import diagnose_many
from hydro_diagnosis.diagnose_many import find_recordings
from hydro_sim.model.bench import Bench
from tests.checks import status_of
from tests.segments import record


def table(study: Path) -> list[dict[str, str]]:
    """Rows of diagnoses.csv."""
    with (study / "diagnoses.csv").open(newline="", encoding="utf-8") as file:
        return [*csv.DictReader(file)]


def interrupt_after(study: Path, count: int) -> None:
    """Ctrl-C once so many results are stored, while the next recording is diagnosed."""
    while sum(file.read_text(encoding="utf-8").count("\n") for file in study.glob("found-*.jsonl")) < count:
        sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)


def test_a_folder_becomes_a_table_and_an_interrupted_command_goes_on(
    worn: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, study = tmp_path / "monday", tmp_path / "study"
    (folder / "late").mkdir(parents=True)
    (folder / "a.csv").write_bytes(worn[0].read_bytes())
    (folder / "broken.csv").write_text("<html></html>", encoding="utf-8")
    (folder / "late/b.csv").write_bytes(worn[1].read_bytes())
    (folder / "notes.docx").write_text("no recording", encoding="utf-8")
    Thread(target=interrupt_after, args=(study, 2), daemon=True).start()
    assert status_of(diagnose_many.main, folder, "--out", study, "--jobs", 1) == 130
    assert {row["recording"] for row in table(study)} == {"a.csv", "broken.csv"}
    before = (study / "reports/a.csv/report.html").stat().st_mtime_ns
    capfd.readouterr()
    assert status_of(diagnose_many.main, folder, "--out", study, "--jobs", 1) == 0
    assert (study / "reports/a.csv/report.html").stat().st_mtime_ns == before
    assert "broken.csv: refused" in capfd.readouterr().err
    rows = table(study)
    assert [*dict.fromkeys(row["recording"] for row in rows)] == ["a.csv", "broken.csv", "late/b.csv"]
    (broken,) = (row for row in rows if row["recording"] == "broken.csv")
    assert "web page" in broken["refused"] and not broken["verdict"]
    springs = [row for row in rows if row["cause"] == "spring_stiffness"]
    assert [row["recording"] for row in springs] == ["a.csv", "late/b.csv"]
    for row in springs:
        assert row["verdict"] == "explained" and row["parameter"] == "ratio"
        assert float(row["low"]) < 0.925 < float(row["high"])
    page = (study / "diagnoses.html").read_text(encoding="utf-8")
    for name in ("a.csv", "late/b.csv"):
        assert f'href="reports/{name}/report.html"' in page and (study / f"reports/{name}/report.html").is_file()
    assert page.count("spring_stiffness") == 2 and "web page" in page


def test_a_part_of_a_bag_is_a_recording_with_its_time(tmp_path: Path) -> None:
    states = record(Bench.nominal(), seed=0, seconds=22.0)
    with BagWriter(tmp_path / "day") as writer:
        writer.write_states(states)
    (tmp_path / "parts.txt").write_text(f"{tmp_path}/day#t=0,11\n{tmp_path}/day#t=11,\n", encoding="utf-8")
    study = tmp_path / "study"
    assert status_of(diagnose_many.main, f"@{tmp_path}/parts.txt", "--out", study, "--jobs", 1) == 0
    first, second = table(study)
    assert [first["recording"], second["recording"]] == ["day#t=0,11", "day#t=11,"]
    assert first["verdict"] == "no_mismatch" and first["cause"] == "" and first["begin"] < second["begin"]
    assert (study / "reports/day/11,/report.html").is_file()
    assert [*find_recordings([str(tmp_path / "day")])] == ["day"]
