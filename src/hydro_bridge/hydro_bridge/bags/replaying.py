# SPDX-License-Identifier: Apache-2.0
"""Timing and time stamps of replayed messages, without ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from pathlib import Path
from struct import Struct
from threading import Event

from hydro_bridge.bags.recording import messages
from hydro_bridge.settings import SettingsError

_STAMP = Struct("<iI")
_STAMPED = {
    "BenchState", "BoxInfo", "BoxLaw", "Correction", "Gains", "LawCommand", "LawState", "TrainingStatus",
    "DiagnosticArray",
}  # fmt: skip


def restamp(data: bytes, time_ns: int) -> bytes:
    """Return a serialized message with header (little-endian CDR) under a new stamp."""
    return data[:4] + _STAMP.pack(*divmod(time_ns, 1_000_000_000)) + data[12:]


class Replay:
    """Passes on recorded messages at their original intervals, each stamped with its due time.

    A consumer treats an old stamp as a stale sample.

    Parameters
    ----------
    path
        The recording.
    topics
        Topics to replay.
    publish
        Called with topic and bytes when a message is due.
    speed
        Recorded seconds per second, above 0.
    loop
        Start again at the end.
    """

    def __init__(
        self,
        path: Path,
        topics: Collection[str],
        publish: Callable[[str, bytes], None],
        *,
        speed: float = 1.0,
        loop: bool = False,
    ) -> None:
        if not speed > 0.0:
            raise SettingsError(f"speed is {speed:g}, it must be above 0")
        self._path, self._topics, self._publish = path, topics, publish
        self._speed, self._loop = speed, loop
        self.published = 0
        self.latest = 0.0
        """s, delay of the last message."""
        self._stopping = Event()

    def stop(self) -> None:
        """End `run`."""
        self._stopping.set()

    def run(self) -> None:
        """Replay until the end or `stop`; raises RecordingError."""
        while not self._stopping.is_set():
            self._once()
            if not self._loop:
                return

    def _once(self) -> None:
        first: int | None = None
        began, began_ns = time.monotonic(), time.time_ns()
        for topic, type_name, log_time, data in messages(self._path):
            if topic not in self._topics:
                continue
            first = log_time if first is None else first
            ahead = (log_time - first) / self._speed
            if self._wait(began + 1e-9 * ahead):
                return
            stamped = type_name.rpartition("/")[2] in _STAMPED
            self._publish(topic, restamp(data, began_ns + int(ahead)) if stamped else data)
            self.published += 1

    def _wait(self, due: float) -> bool:
        """Wait until `due` on the monotonic clock; True if `stop` was called meanwhile."""
        while (ahead := due - time.monotonic()) > 0.0:
            if ahead > 0.1:
                self._stopping.wait(0.1)
            else:
                time.sleep(ahead)
            if self._stopping.is_set():
                return True
        self.latest = -ahead
        return self._stopping.is_set()
