# SPDX-License-Identifier: Apache-2.0
"""Writer of recordings: a rosbag2 folder with metadata.yaml (version 9) and one .mcap, without ROS.

Requirements of the readers and the effect of `kill -9`: recordings.md.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import yaml
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from hydro_bridge.bags.cdr import STATE_TOPIC, STATE_TYPE, encode_states
from hydro_bridge.bags.types import RecordingError, TopicQos, definition
from hydro_core.signals import StateArray

VERSION = 9
UNFINISHED_MARKER = "recording was not finished"
"""Value of `hydro` in the custom_data of metadata.yaml while the recording is in progress."""


@dataclass(kw_only=True)
class TopicEntry:
    """A topic in metadata.yaml."""

    type_name: str
    encoding: str = "cdr"
    profiles: list[Any]
    """Offered quality of service, as rosbag2 writes it."""
    type_hash: str
    channel: int = 0
    count: int = 0

    @classmethod
    def of_channel(cls, channel: Channel, schema: Schema | None) -> TopicEntry:
        """Return the entry of a channel of any writer."""
        profiles = channel.metadata.get("offered_qos_profiles", "")
        return cls(
            type_name=schema.name if schema else "",
            encoding=channel.message_encoding,
            profiles=[TopicQos.from_rosbag2(profiles).as_rosbag2()],
            type_hash=channel.metadata.get("topic_type_hash", ""),
        )


def try_lock(file: BinaryIO) -> bool:
    """Try to lock an .mcap file for writing or repair; False: another process holds the lock.

    The lock is released when the last descriptor of the file is closed, even by a kill.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


class BagWriter(AbstractContextManager["BagWriter"]):
    """A recording in progress; use as context manager, or call `close`.

    `folder`: created here; must not exist. `metadata`: run's parameters, code version, digests: MCAP metadata record
    `hydro`, and custom_data of metadata.yaml. `attachments`: files to attach, by name, for instance bench.yaml. Raises
    RecordingError: the folder exists, or cannot be created.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise RecordingError(f"{self.folder} exists already; a recording is never overwritten") from None
        except OSError as error:
            raise RecordingError(f"{self.folder} cannot be made: {error.strerror}") from None
        self.path = self.folder / f"{self.folder.name}_0.mcap"
        self._metadata = dict(metadata or {})
        self._topics: dict[str, TopicEntry] = {}
        self._schemas: dict[str, int] = {}
        self._span = (2**63 - 1, 0)
        self._file = self.path.open("wb")
        try_lock(self._file)  # while it is written
        self._writer = Writer(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(profile="ros2", library="hydro_bridge")
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, 0, name, "text/plain" if name.endswith(".yaml") else "", data)
        if self._metadata:
            self._writer.add_metadata("hydro", self._metadata)
        self._write_metadata_yaml({"hydro": UNFINISHED_MARKER})
        self.flush()

    def add_topic(self, topic: str, type_name: str, qos: TopicQos | None = None) -> None:
        """Register a topic of type `package/msg/Type`, once, before its first message; raises UnknownTypeError."""
        qos = qos or TopicQos()
        known = definition(type_name)
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", known.text.encode())
        profiles = yaml.safe_dump([qos.as_rosbag2()], sort_keys=False)
        channel = self._writer.register_channel(
            topic,
            "cdr",
            self._schemas[type_name],
            {"offered_qos_profiles": profiles, "topic_type_hash": known.type_hash},
        )
        self._topics[topic] = TopicEntry(
            type_name=type_name, profiles=[qos.as_rosbag2()], type_hash=known.type_hash, channel=channel
        )
        self._write_metadata_yaml({"hydro": UNFINISHED_MARKER})

    def write(self, topic: str, data: bytes, time_ns: int) -> None:
        """Add one serialized message (CDR) at log time `time_ns`."""
        known = self._topics[topic]
        self._writer.add_message(known.channel, time_ns, data, time_ns, known.count & 0xFFFFFFFF)
        known.count += 1
        self._span = (min(self._span[0], time_ns), max(self._span[1], time_ns))

    def write_states(self, states: StateArray) -> None:
        """Add `STATE_DTYPE` records as BenchState messages, logged at their own times."""
        if STATE_TOPIC not in self._topics:
            self.add_topic(STATE_TOPIC, STATE_TYPE, TopicQos(reliability="best_effort", depth=50))
        rows = encode_states(states)
        size, stream = rows.shape[1], rows.tobytes()
        for row, time_ns in enumerate(np.rint(states["time"] * 1e9).astype(np.int64).tolist()):
            self.write(STATE_TOPIC, stream[row * size : (row + 1) * size], time_ns)

    def flush(self) -> None:
        """Flush everything written so far to the operating system, so that it survives a `kill -9` of this process."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write indexes, statistics and the final metadata.yaml."""
        if self._file.closed:
            return
        text = yaml.safe_dump(self._information(self._metadata), sort_keys=False)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()
        self._write_metadata_yaml(self._metadata)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_metadata_yaml(self, custom: Mapping[str, str]) -> None:
        scratch = self.folder / ".metadata.yaml"
        content = {"rosbag2_bagfile_information": self._information(custom)}
        scratch.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        os.replace(scratch, self.folder / "metadata.yaml")

    def _information(self, custom: Mapping[str, str]) -> dict[str, object]:
        count = sum(topic.count for topic in self._topics.values())
        start, end = self._span if count else (0, 0)
        return bag_metadata(self._topics, [(self.path.name, start, end, count)], custom)


def bag_metadata(
    topics: Mapping[str, TopicEntry], files: Sequence[tuple[str, int, int, int]], custom: Mapping[str, str]
) -> dict[str, object]:
    """Return the content of metadata.yaml with all keys of version 9: rosbag2 throws on a missing one.

    `files`: name, first and last log time [ns] and number of messages of each.
    """

    def times(start: int, end: int) -> dict[str, dict[str, int]]:
        return {"starting_time": {"nanoseconds_since_epoch": start}, "duration": {"nanoseconds": end - start}}

    listed = [
        {
            "topic_metadata": {
                "name": name,
                "type": topic.type_name,
                "serialization_format": topic.encoding,
                "offered_qos_profiles": topic.profiles,
                "type_description_hash": topic.type_hash,
            },
            "message_count": topic.count,
        }
        for name, topic in topics.items()
    ]
    told = [file for file in files if file[3]] or [(*file[:1], 0, 0, 0) for file in files]
    start, end = min(file[1] for file in told), max(file[2] for file in told)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **times(start, end),
        "message_count": sum(file[3] for file in files),
        "topics_with_message_count": listed,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file[0] for file in files],
        "files": [
            {"path": name, **times(*((begin, end) if count else (0, 0))), "message_count": count}
            for name, begin, end, count in files
        ],
        "custom_data": dict(custom) if custom else None,
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
    }


def code_version() -> str:
    """Return `git describe` of the running sources, or the package's version."""
    try:
        command = ["git", "-C", str(Path(__file__).resolve().parent), "describe", "--always", "--dirty", "--tags"]
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        try:
            return version("hydro_bridge")
        except PackageNotFoundError:
            return "unknown"
