# SPDX-License-Identifier: Apache-2.0
"""The page that a training leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydro_bridge.pages import results_page
from hydro_policy.runs import report

EXAM = {"kind": "exam", "rmse": [3.5, 2.0], "score": 0.34, "best": True, "beaten": 2, "reference_rmse": [4.4, 11.0]}
EPISODE = {"kind": "episode", "return": -157.0, "force_rmse": 1.56}
EVENTS: list[dict[str, Any]] = [
    {"kind": "start", "time": "2026-11-21T04:53:45.186+00:00", "plant": "emulator", "start": None, "resumed": False},
    {**EXAM, "episode": 0},
    {**EPISODE, "episode": 1},
    {"kind": "stop", "time": "2026-11-21T04:55:00.000+00:00", "sentence": "policy stopped in episode 2: <chattering>"},
    {**EPISODE, "episode": 2, "force_rmse": 12.34},
    {**EXAM, "episode": 2, "best": False, "score": 0.5},
    {"kind": "end", "time": "2026-11-21T04:57:12.598+00:00", "complete": False},
]


def test_a_training_is_told_with_its_curve_examinations_and_stops(tmp_path: Path) -> None:
    curve = tmp_path / "learning.png"
    report.draw_curve(EVENTS, curve)
    assert curve.stat().st_size > 10_000
    page = results_page("Training", {}, report.sections(EVENTS, curve))
    assert "2 episodes, 1 rollbacks; the last one: 12.3 N RMSE while it explored." in page
    assert "&lt;chattering&gt;" in page and "it can be resumed" in page and "from new networks" in page
    assert page.count("<img") == 1
    rows = report.exam_table(EVENTS).rows
    assert [row["kept"] for row in rows] == ["yes", "no"] and rows[0]["rmse"] == "3.5, 2.0"
