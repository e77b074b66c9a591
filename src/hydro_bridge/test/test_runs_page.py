# SPDX-License-Identifier: Apache-2.0
"""The front page of all runs."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from hydro_bridge.viewer.runs import ORDERS, list_runs, refresh_index, write_index


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    folder = tmp_path / "runs"
    for name in ("old & <bold>", "found", "broken", "nothing", "tuesday"):
        (folder / name).mkdir(parents=True)
    events = [{"kind": "episode", "force_rmse": 20.0}, {"kind": "episode", "force_rmse": 12.34},
              {"kind": "exam", "score": 0.4, "best": True}, {"kind": "exam", "score": 0.3, "best": False},
              {"kind": "end", "sentence": "Ended by Ctrl-C."}]  # fmt: skip
    (folder / "old & <bold>" / "run.json").write_text(json.dumps({"events": events}))
    (folder / "old & <bold>" / "tracking.png").write_bytes(b"")
    (folder / "old & <bold>" / "bag").mkdir()
    (folder / "old & <bold>" / "bag" / "metadata.yaml").write_text("")
    report = {"verdict": "partly_explained", "effects": [{"id": "spring_stiffness"}]}
    (folder / "found" / "report.json").write_text(json.dumps(report))
    (folder / "found" / "report.html").write_text("")
    (folder / "broken" / "run.json").write_text("{")
    (folder / "tuesday" / "metadata.yaml").write_text("")
    (folder / "tuesday.html").write_text("")
    for age, name in enumerate(("found", "broken", "tuesday", "old & <bold>")):
        for path in (*(folder / name).iterdir(), folder / name):
            os.utime(path, (1e9 - age, 1e9 - age))
    return folder


def test_each_run_is_told_with_its_summary_the_newest_first(runs: Path) -> None:
    found = {entry.name: entry for entry in list_runs(runs)}
    assert list(found) == ["found", "broken", "tuesday", "old & <bold>"]
    assert found["found"].summary == "partly explained: spring stiffness"
    assert found["found"].pages == ("found/report.html",)
    assert found["old & <bold>"].summary == "2 episodes, the last one with an RMSE of 12.3 N. Ended by Ctrl-C."
    assert found["old & <bold>"].recordings == ("old & <bold>/bag",)
    assert found["tuesday"].kind == "recording"
    assert found["tuesday"].pages == ("tuesday.html",) and not found["tuesday"].recordings
    assert min(found.values(), key=ORDERS["score"]).name == "old & <bold>"
    assert found["old & <bold>"].score == 0.4 and found["broken"].score is None
    assert found["broken"].kind == "training" and not found["broken"].summary


def test_names_are_escaped_and_addresses_lead_to_files(runs: Path) -> None:
    page = write_index(runs).read_text()
    assert "old &amp; &lt;bold&gt;" in page and "<bold>" not in page
    assert 'src="old%20%26%20%3Cbold%3E/tracking.png"' in page


def test_a_page_of_somebody_else_is_left_alone(runs: Path) -> None:
    (runs / "index.html").write_text("the site")
    refresh_index(runs / "found")
    with pytest.raises(FileExistsError, match="another page than one of runs"):
        write_index(runs)
    assert (runs / "index.html").read_text() == "the site"
