# SPDX-License-Identifier: Apache-2.0
"""Recording of a running graph, without ROS: bytes written as received, counted, flushed twice a second."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from struct import unpack_from

from hydro_bridge.bags.reader import STATE_TOPIC
from hydro_bridge.bags.types import RecordingError, TopicQos
from hydro_bridge.bags.writer import BagWriter
from hydro_bridge.serial.stream import LinkCounts, SequenceTracker

FLUSH_PERIOD = 0.5
"""s: longest loss through `kill -9`; at worst twice that on a slow disk."""


def code_version() -> str:
    """Return `git describe` of the running sources, or the package's version."""
    here = Path(__file__).resolve().parent
    try:
        command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--tags"]
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        try:
            return version("hydro_bridge")
        except PackageNotFoundError:
            return "unknown"


def sequence_of(data: bytes) -> int:
    """Return `sequence`, the field after the header, of a serialized BenchState (little-endian CDR)."""
    (length,) = unpack_from("<I", data, 12)
    return int(unpack_from("<I", data, 4 + -(-(12 + length) // 4) * 4)[0])


class RecordingRun:
    """A recording in progress and its counts.

    Parameters
    ----------
    folder
        Created here; must not exist.
    metadata, attachments
        As for `BagWriter`; the version of the code is added.
    """

    def __init__(self, folder: Path, metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> None:
        whole = {"code_version": code_version(), **metadata}
        self.writer = BagWriter(folder, metadata=whole, attachments=attachments)
        self.messages: dict[str, int] = {}
        self.bytes = 0
        self.counts = LinkCounts()
        """Lost, duplicate and reordered samples of /hydro/state."""
        self._tracker = SequenceTracker(self.counts)

    def add_topic(self, topic: str, type_name: str, qos: TopicQos) -> None:
        """Announce a topic."""
        self.writer.add_topic(topic, type_name, qos)
        self.messages[topic] = 0

    def take(self, topic: str, data: bytes, time_ns: int) -> None:
        """Record one message."""
        self.writer.write(topic, data, time_ns)
        self.messages[topic] += 1
        self.bytes += len(data)
        if topic == STATE_TOPIC:
            self._tracker.accept(sequence_of(data))

    def summary(self) -> str:
        """Summarise the recording in one sentence."""
        topics = ", ".join(f"{count} {topic}" for topic, count in self.messages.items() if count) or "no messages"
        counts = self.counts
        return (
            f"{self.writer.folder}: {topics}; of /hydro/state {counts.lost} lost, {counts.duplicates} duplicate, "
            f"{counts.reordered} late"
        )


def parse_pairs(pairs: list[str]) -> dict[str, str]:
    """Parse ``key=value`` words into a mapping; raises RecordingError for a word without ``=``."""
    for pair in pairs:
        if "=" not in pair:
            raise RecordingError(f"--metadata {pair}: key=value is meant")
    return {key: value for key, _, value in (pair.partition("=") for pair in pairs)}


def read_attachments(paths: list[Path]) -> dict[str, bytes]:
    """Read files into a mapping by name; raises RecordingError for one that cannot be read."""
    try:
        return {path.name: path.read_bytes() for path in paths}
    except OSError as error:
        raise RecordingError(f"--attach {error.filename}: {error.strerror}") from None
