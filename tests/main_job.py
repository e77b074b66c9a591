# SPDX-License-Identifier: Apache-2.0
"""Whether a run of the main job came to its end, no stop, no rollback, all files: `python -m tests.main_job RUN`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

FILES = ("config.yaml", "policy.safetensors", "checkpoints/latest/learner.safetensors", "bag/metadata.yaml",
         "evaluation.json", "tracking.png", "log.txt")  # fmt: skip
UNWANTED = ("stop", "override", "uncovered")
"""Kinds of events; a stop is a policy that was rolled back."""


def check(run: Path) -> None:
    events = json.loads((run / "run.json").read_text())["events"]
    unwanted = [event for event in events if event["kind"] in UNWANTED]
    assert not unwanted, unwanted
    ends = [event["complete"] for event in events if event["kind"] == "end"]
    assert ends[-1:] == [True], "the run did not come to its end"
    assert events[-1]["kind"] == "digest" and len(events[-1]["run_digest"]) == 64, "the run has no digest"
    missing = [name for name in FILES if not (run / name).exists()]
    assert not missing, missing
    print(f"main job: {run.name} came to its end, no stop, no rollback, all files")


if __name__ == "__main__":
    check(Path(sys.argv[1]))
