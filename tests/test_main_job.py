# SPDX-License-Identifier: Apache-2.0
"""CI's verdict on a run of the main job."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.main_job import FILES, complaint

START = {"kind": "start", "time": "12:00"}
END = {"kind": "end", "time": "12:05", "complete": True}
STOP = {"kind": "stop", "time": "12:03", "sentence": "policy stopped: chattering"}


def test_a_run_is_good_that_came_to_its_end_without_a_stop_and_with_all_files(tmp_path: Path) -> None:
    def told(*events: dict[str, Any]) -> str:
        (tmp_path / "run.json").write_text(json.dumps({"events": events}))
        return complaint(tmp_path)

    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert told(START, END) == ""
    assert "stop at 12:03: policy stopped: chattering" in told(START, STOP, END)
    for events in ((START, END | {"complete": False}), (START,), ()):
        assert "did not come to its end" in told(*events)
    (tmp_path / "tracking.png").unlink()
    assert told(START, END) == "missing: tracking.png"
