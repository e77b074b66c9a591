# SPDX-License-Identifier: Apache-2.0
"""CI's verdict on a run of the main job."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.main_job import FILES, complaint

START = {"kind": "start", "time": "12:00"}
END = {"kind": "end", "time": "12:05", "complete": True}
STOP = {"kind": "stop", "time": "12:03", "sentence": "policy stopped: chattering"}


def made(run: Path, *events: dict[str, Any]) -> Path:
    for name in FILES:
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        (run / name).touch()
    (run / "run.json").write_text(json.dumps({"events": events}))
    return run


def test_a_run_without_a_stop_is_good(tmp_path: Path) -> None:
    assert complaint(made(tmp_path, START, END)) == ""


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ((START, STOP, END), "stop at 12:03: policy stopped: chattering"),
        ((START, END | {"complete": False}), "did not come to its end"),
        ((START,), "did not come to its end"),
        ((), "did not come to its end"),
    ],
)
def test_a_run_that_was_stopped_or_cut_short_is_not(events: tuple[Any, ...], said: str, tmp_path: Path) -> None:
    assert said in complaint(made(tmp_path, *events))


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    (made(tmp_path, START, END) / "tracking.png").unlink()
    assert complaint(tmp_path) == "missing: tracking.png"
    assert "no record" in complaint(tmp_path / "nowhere")
