# SPDX-License-Identifier: Apache-2.0
"""Whether a run of the main job went as a first run must: `python -m tests.main_job RUN`; one sentence, status 0 or 1.

To its end: no stop, no rollback, and every file there.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

FILES = ("config.yaml", "policy.safetensors", "checkpoints/latest/learner.safetensors", "bag/metadata.yaml",
         "evaluation.json", "tracking.png", "log.txt")  # fmt: skip
UNWANTED = ("stop", "override", "uncovered")
"""Kinds of events; a stop is a policy that was rolled back."""


def complaint(run: Path) -> str:
    """What is wrong with the run in this folder; empty if nothing is."""
    try:
        events = json.loads((run / "run.json").read_text())["events"]
    except (OSError, ValueError, KeyError) as error:
        return f"{run} holds no record of a run: {error}"
    for event in events:
        if event["kind"] in UNWANTED:
            return f"{event['kind']} at {event['time']}: {event.get('sentence', 'without a word')}"
    ends = [event for event in events if event["kind"] == "end"]
    if not ends or not ends[-1]["complete"]:
        return "the run did not come to its end"
    if events[-1]["kind"] != "digest" or len(events[-1]["run_digest"]) != 64:
        return "the run has no digest"
    missing = [name for name in FILES if not (run / name).exists()]
    return f"missing: {', '.join(missing)}" if missing else ""


def main() -> int:
    """Entry point."""
    run = Path(sys.argv[1])
    wrong = complaint(run)
    print(f"main job: {wrong}" if wrong else f"main job: {run.name} came to its end, no stop, no rollback, all files")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
