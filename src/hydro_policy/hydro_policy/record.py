# SPDX-License-Identifier: Apache-2.0
"""run.json: what happened in a run, for people and programs, rewritten whole at each event.

    {"events": [{"time": ISO 8601, "kind": KIND, "sentence": ..., further numbers by name}, ...]}

KIND is one of `start`, `episode`, `exam`, `stop`, `override`, `end`. A resumed run appends to what happened before.
"""

from __future__ import annotations

import json
import math
from datetime import datetime
from pathlib import Path
from typing import Any


class RunRecord:
    """Appends events; keeps them in `path` if there is one.

    Parameters
    ----------
    path
        run.json; None: in memory only.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self.events: list[dict[str, Any]] = []
        if path is not None and path.exists():
            self.events = json.loads(path.read_text(encoding="utf-8"))["events"]

    def add(self, kind: str, sentence: str = "", **numbers: Any) -> None:
        """Add an event, now; what is not finite becomes null."""
        event = {"time": datetime.now().astimezone().isoformat(timespec="milliseconds"), "kind": kind}
        if sentence:
            event["sentence"] = sentence
        self.events.append(event | {key: _plain(value) for key, value in numbers.items()})
        self._write()

    def of(self, kind: str) -> list[dict[str, Any]]:
        """All events of a kind."""
        return [event for event in self.events if event["kind"] == kind]

    def _write(self) -> None:
        if self._path is not None:
            partial = self._path.with_name(self._path.name + ".partial")
            partial.write_text(json.dumps({"events": self.events}, indent=1) + "\n", encoding="utf-8")
            partial.replace(self._path)


def _plain(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
