# SPDX-License-Identifier: Apache-2.0
"""run.json: the events of a run, for people and programs, rewritten atomically at each event.

    {"events": [{"time": ISO 8601, "kind": KIND, "sentence": ..., further numbers by name}, ...]}

KIND is one of `start`, `episode`, `exam`, `stop`, `override`, `end`. A resumed run appends to the previous events.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

from hydro_bridge.files.atomic import write_whole


class RunRecord:
    """Appends events; saves them to `path` if given.

    Parameters
    ----------
    path
        run.json; None: in memory only.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._writer = ThreadPoolExecutor(max_workers=1)  # a busy disk must not delay gains
        self._written: Future[None] = Future()
        self._written.set_result(None)
        self.events: list[dict[str, Any]] = []
        if path is not None and path.exists():
            try:
                self.events = list(json.loads(path.read_text(encoding="utf-8"))["events"])
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(f"{path} is no record of a run ({error}): move it away to begin another") from error

    def add(self, kind: str, sentence: str = "", **numbers: Any) -> None:
        """Add an event at the present time; non-finite values become null."""
        event = {"time": datetime.now().astimezone().isoformat(timespec="milliseconds"), "kind": kind}
        if sentence:
            event["sentence"] = sentence
        self.events.append(event | {key: _plain(value) for key, value in numbers.items()})
        if self._path is not None:
            if self._written.done():
                self._written.result()  # raises a write error
            self._written = self._writer.submit(_write, self._path, tuple(self.events))

    def of(self, kind: str) -> list[dict[str, Any]]:
        """Return all events of a kind."""
        return [event for event in self.events if event["kind"] == kind]

    def flush(self) -> None:
        """Wait until everything is on disk; so does the end of the process.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        self._written.result()


def _write(path: Path, events: Sequence[Mapping[str, Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)  # the folder may have been deleted
    write_whole(path, (json.dumps({"events": events}, indent=1) + "\n").encode())


def _plain(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
