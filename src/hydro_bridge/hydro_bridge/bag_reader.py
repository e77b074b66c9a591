# SPDX-License-Identifier: Apache-2.0
"""Reads recordings into arrays by field name: a rosbag2 folder or a single .mcap, ours or by any other writer.

`read_bag` gives everything, `stream_bag` one topic piece by piece in bounded memory, `messages` the bytes as recorded.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.records import Channel

from hydro_bridge.bag_files import mcap_files
from hydro_bridge.bag_writer import RecordingError, TopicQos
from hydro_bridge.cdr import STATE_TYPE, FixedLayout, NotFixedError, fixed_layout
from hydro_bridge.mcap_scan import McapScan, Span
from hydro_bridge.schema import UnknownTypeError, definition
from hydro_bridge.signals import STATE_DTYPE, StateArray

Table = npt.NDArray[np.void]
"""Structured array of one topic: `time` [s], then the message's fields."""
STATE_TOPIC = "/hydro/state"


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One recording in memory."""

    path: Path
    topics: dict[str, str]
    """Type of each topic that has messages."""
    qos: dict[str, TopicQos]
    """Quality of service that each of them was offered with."""
    tables: dict[str, Table]
    """Array of each topic that is numbers only."""
    metadata: dict[str, dict[str, str]]
    """MCAP metadata records; `hydro` holds the run's parameters, code version and digests."""
    attachments: dict[str, bytes]
    """Files that travel along, for instance bench.yaml."""
    notes: tuple[str, ...]
    """What the reader had to put up with, a sentence each; empty for a whole recording."""

    def __getitem__(self, topic: str) -> Table:
        """Array of a topic; raises RecordingError if there is none."""
        if topic not in self.tables:
            raise RecordingError(_no_topic(self.path, topic, self.topics))
        return self.tables[topic]

    @cached_property
    def state(self) -> StateArray:
        """/hydro/state as `STATE_DTYPE` records; raises RecordingError if it is missing or of another type."""
        return as_states(self[STATE_TOPIC], self.path)


@dataclass
class _Column:
    """A table that grows."""

    table: Table
    count: int = 0

    def extend(self, piece: Table) -> None:
        if self.count + len(piece) > len(self.table):
            grown = np.empty(max(2 * len(self.table), self.count + len(piece)), self.table.dtype)
            grown[: self.count] = self.table[: self.count]
            self.table = grown
        self.table[self.count : self.count + len(piece)] = piece
        self.count += len(piece)


@dataclass
class _Source:
    """The files of one recording, read one after the other."""

    path: Path
    scans: list[McapScan] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _layouts: dict[tuple[str, bytes], FixedLayout | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        files, self.notes = mcap_files(self.path)
        self.scans = [McapScan(path) for path in files]

    def spans(self) -> Iterator[tuple[McapScan, Channel, bytes, Span]]:
        for scan in self.scans:
            for block, spans in scan.blocks():
                for number, span in spans.items():
                    if number not in scan.channels:
                        raise RecordingError(f"{scan.path} has messages on a channel that it does not declare")
                    yield scan, scan.channels[number], block, span
            if not scan.finished:
                self.notes.append(
                    f"{scan.path.name} was not finished (its recorder was killed?): read up to where it ends"
                )

    def layout(self, scan: McapScan, channel: Channel) -> FixedLayout | None:
        """Layout of a channel's type; None if it is not numbers only."""
        schema = scan.schemas.get(channel.schema_id)
        if schema is None or channel.message_encoding != "cdr":
            raise RecordingError(f"{scan.path}: {channel.topic} has no type or is not CDR")
        key = (schema.name, schema.data)
        if key not in self._layouts:
            try:
                text = schema.data.decode() if schema.encoding == "ros2msg" else definition(schema.name).text
                self._layouts[key] = fixed_layout(text, schema.name)
            except (NotFixedError, UnknownTypeError):
                self._layouts[key] = None
            except Exception as error:
                raise RecordingError(f"{scan.path}: the definition of {schema.name} cannot be read: {error}") from None
        return self._layouts[key]


def read_bag(path: Path | str, topics: Collection[str] | None = None) -> Recording:
    """Read a recording into arrays.

    Parameters
    ----------
    path
        A rosbag2 folder or an .mcap file.
    topics
        Which topics to read; all by default.

    Raises
    ------
    RecordingError
        Nothing there, damaged, or a topic in `topics` has no messages.
    """
    source = _Source(Path(path))
    types: dict[str, str] = {}
    qos: dict[str, TopicQos] = {}
    columns: dict[str, _Column] = {}
    for scan, channel, block, span in source.spans():
        if channel.topic not in types:
            types[channel.topic] = scan.schemas[channel.schema_id].name if channel.schema_id in scan.schemas else ""
            qos[channel.topic] = TopicQos.from_rosbag2(channel.metadata.get("offered_qos_profiles", ""))
        if topics is not None and channel.topic not in topics:
            continue
        layout = source.layout(scan, channel)
        if layout is not None:
            piece = _decode(scan.path, channel.topic, layout, block, span)
            columns.setdefault(channel.topic, _Column(np.empty(0, piece.dtype))).extend(piece)
    for topic in topics or ():
        if topic not in types:
            raise RecordingError(_no_topic(source.path, topic, types))
    return Recording(
        path=source.path,
        topics=types,
        qos=qos,
        tables={topic: column.table[: column.count] for topic, column in columns.items()},
        metadata={name: record for scan in source.scans for name, record in scan.metadata.items()},
        attachments={name: data for scan in source.scans for name, data in scan.attachments.items()},
        notes=tuple(source.notes),
    )


def stream_bag(path: Path | str, topic: str = STATE_TOPIC) -> Iterator[Table]:
    """Arrays of one topic, one per block of the file (about a second, at most a megabyte); errors as `read_bag`."""
    source = _Source(Path(path))
    found = False
    for scan, channel, block, span in source.spans():
        if channel.topic == topic:
            layout = source.layout(scan, channel)
            if layout is None:
                raise RecordingError(f"{scan.path}: {topic} is not numbers only")
            found = True
            piece = _decode(scan.path, topic, layout, block, span)
            yield as_states(piece, scan.path) if topic == STATE_TOPIC else piece
    if not found:
        topics = {channel.topic for scan in source.scans for channel in scan.channels.values()}
        raise RecordingError(_no_topic(source.path, topic, topics))


def messages(path: Path | str) -> Iterator[tuple[str, str, int, bytes]]:
    """Topic, type, log time [ns] and bytes of every message, by log time within a block; errors as `read_bag`."""
    spans: list[tuple[int, int, str, str, int]] = []
    source, last = _Source(Path(path)), b""
    for scan, channel, block, span in source.spans():
        if block is not last:
            yield from _ordered(last, spans)
            spans, last = [], block
        type_name = scan.schemas[channel.schema_id].name
        columns = zip(span.log_times.tolist(), span.starts.tolist(), span.sizes.tolist(), strict=True)
        spans += [(time, start, channel.topic, type_name, size) for time, start, size in columns]
    yield from _ordered(last, spans)


def as_states(table: Table, path: Path) -> StateArray:
    """`STATE_DTYPE` records from a table that has its fields; raises RecordingError for another type."""
    if table.dtype == STATE_DTYPE:
        return table
    missing = [name for name in STATE_DTYPE.names or () if name not in (table.dtype.names or ())]
    if missing:
        raise RecordingError(f"{path}: {STATE_TOPIC} is no {STATE_TYPE}: it has no {', '.join(missing)}")
    states = np.empty(len(table), STATE_DTYPE)
    for name in STATE_DTYPE.names or ():
        states[name] = table[name]
    return states


def _ordered(block: bytes, spans: list[tuple[int, int, str, str, int]]) -> Iterator[tuple[str, str, int, bytes]]:
    for time, start, topic, type_name, size in sorted(spans):
        yield topic, type_name, time, block[start : start + size]


def _decode(path: Path, topic: str, layout: FixedLayout, block: bytes, span: Span) -> Table:
    buffer = np.frombuffer(block, np.uint8)
    out = np.empty(len(span.starts), layout.table)
    for size in np.unique(span.sizes):
        part = span.sizes == size
        rows = np.lib.stride_tricks.sliding_window_view(buffer, int(size))[span.starts[part]]
        try:
            out[part] = layout.decode(rows, span.log_times[part])
        except ValueError as error:
            raise RecordingError(f"{path}: a message of {topic} cannot be read: {error}") from None
    return out


def _no_topic(path: Path, topic: str, topics: Collection[str]) -> str:
    return f"{path} has no messages on {topic}; there is {', '.join(sorted(topics)) or 'nothing'}"
