# SPDX-License-Identifier: Apache-2.0
"""Writer of recordings: a rosbag2 folder with metadata.yaml (version 9) and one .mcap, without ROS.

Requirements of the readers and the effect of `kill -9`: recordings.md.
"""

from __future__ import annotations

import os
import subprocess
from collections import Counter
from collections.abc import Mapping
from contextlib import AbstractContextManager
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from hydro_bridge.bags import RecordingError
from hydro_bridge.bags.cdr import STATE_TOPIC, STATE_TYPE, definition, encode_states
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import StateArray


class BagWriter(AbstractContextManager["BagWriter"]):
    """A recording in progress; use as context manager, or call `close`.

    `folder`: created here; must not exist. `metadata`: run's parameters, code version, digests: MCAP metadata record
    `hydro`, and custom_data of metadata.yaml. `attachments`: files to attach, by name, for instance bench.yaml. Raises
    RecordingError: the folder exists, or cannot be created.
    """

    def __init__(
        self, folder: Path | str, *, metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:  # fmt: skip
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise RecordingError(f"{self.folder} exists already: name a new folder") from None
        except OSError as error:
            raise RecordingError(f"{self.folder} cannot be made: {error.strerror}") from None
        self.path = self.folder / f"{self.folder.name}_0.mcap"
        self._custom, self._channels, self._schemas = dict[str, str](), dict[str, Channel](), dict[str, Schema]()
        self._counts, self._span = Counter[str](), (2**63 - 1, 0)
        self._file = self.path.open("wb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(profile="ros2", library="hydro_bridge")
        for name, data in (attachments or {}).items():
            self.attach(name, data)
        if metadata:
            self.add_metadata("hydro", metadata)
        self._write_metadata_yaml({"hydro": "recording was not finished"})
        self.flush()

    def attach(self, name: str, data: bytes) -> None:
        """Attach a file."""
        self._writer.add_attachment(0, 0, name, "text/plain" if name.endswith(".yaml") else "", data)

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Add an MCAP metadata record; `hydro` becomes custom_data of metadata.yaml, too."""
        self._writer.add_metadata(name, dict(record))
        if name == "hydro":
            self._custom |= record

    def add_topic(
        self, topic: str, type_name: str, *, depth: int = 10, reliable: bool = True, latched: bool = False
    ) -> None:
        """Register a topic whose type has a `definition` and that keeps `depth` messages, before its first message."""
        known, forever = definition(type_name), QosTime(9223372036, 854775807)
        reliability = QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT
        durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
        alive = QosLiveliness.AUTOMATIC
        qos = Qos(QosHistory.KEEP_LAST, depth, reliability, durability, forever, forever, alive, forever, False)
        profiles = yaml.safe_dump(dump_qos_v9([qos]), sort_keys=False)
        metadata = {"offered_qos_profiles": profiles, "topic_type_hash": known["type_hash"]}
        schema = Schema(id=0, name=type_name, encoding="ros2msg", data=known["text"].encode())
        self.add_channel(Channel(id=0, topic=topic, message_encoding="cdr", schema_id=0, metadata=metadata), schema)

    def add_channel(self, channel: Channel, schema: Schema) -> None:
        """Register a channel of another recording, if its topic has none; raises RecordingError: of another type."""
        topic, name = channel.topic, schema.name
        if topic in self._channels:
            if self._schemas[topic].name != name:
                raise RecordingError(f"{topic} has messages of two types: move their files apart")
            return
        known = next((one.id for one in self._schemas.values() if one.name == name), None)
        number = self._writer.register_schema(name, schema.encoding, schema.data) if known is None else known
        place = self._writer.register_channel(topic, channel.message_encoding, number, channel.metadata)
        self._schemas[topic], self._channels[topic] = replace(schema, id=number), replace(channel, id=place)

    def write(
        self, topic: str, data: bytes, time_ns: int, publish_time_ns: int | None = None, sequence: int | None = None
    ) -> None:
        """Add one serialized message at log time `time_ns`; by default published then, and numbered by its topic."""
        published = time_ns if publish_time_ns is None else publish_time_ns
        number = self._counts[topic] & 0xFFFFFFFF if sequence is None else sequence
        self._writer.add_message(self._channels[topic].id, time_ns, data, published, number)
        self._counts[topic] += 1
        self._span = (min(self._span[0], time_ns), max(self._span[1], time_ns))

    def write_states(self, states: StateArray) -> None:
        """Add `STATE_DTYPE` records as BenchState messages, logged at their own times."""
        if STATE_TOPIC not in self._channels:
            self.add_topic(STATE_TOPIC, STATE_TYPE, depth=50, reliable=False)
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
        text = yaml.safe_dump(self._information(self._custom), sort_keys=False)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()
        self._write_metadata_yaml(self._custom)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_metadata_yaml(self, custom: Mapping[str, str]) -> None:
        content = {"rosbag2_bagfile_information": self._information(custom)}
        write_atomic(self.folder / "metadata.yaml", yaml.safe_dump(content, sort_keys=False).encode())

    def _information(self, custom: Mapping[str, str]) -> dict[str, object]:
        """Return the content of metadata.yaml with all keys of version 9: rosbag2 throws on a missing one."""
        start, end = self._span if self._counts else (0, 0)
        topics = [
            {"topic_metadata": {
                "name": topic, "type": self._schemas[topic].name, "serialization_format": channel.message_encoding,
                "offered_qos_profiles": dump_qos_v9(parse_qos(channel.metadata.get("offered_qos_profiles", ""))),
                "type_description_hash": channel.metadata.get("topic_type_hash", "")},
             "message_count": self._counts[topic]}
            for topic, channel in self._channels.items()
        ]  # fmt: skip
        information = {"starting_time": {"nanoseconds_since_epoch": start}, "duration": {"nanoseconds": end - start},
                       "message_count": self._counts.total()}  # fmt: skip
        name, ros_distro = self.path.name, os.environ.get("ROS_DISTRO", "jazzy")
        files = [{"path": name, **deepcopy(information)}]  # YAML would write a second mention as an alias
        return {"version": 9, "storage_identifier": "mcap", **information, "topics_with_message_count": topics,
                "compression_format": "", "compression_mode": "", "relative_file_paths": [name], "files": files,
                "custom_data": dict(custom) or None, "ros_distro": ros_distro}  # fmt: skip


def code_version() -> str:
    """Return `git describe` of the running sources, or "unknown"."""
    command = ["git", "-C", str(Path(__file__).resolve().parent), "describe", "--always", "--dirty", "--tags"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
