# SPDX-License-Identifier: Apache-2.0
"""Recordings as arrays by field name, from a rosbag2 folder or a single .mcap of any writer; their check and repair.

>>> states = read_bag("runs/tuesday").state          # doctest: +SKIP
>>> states["load_force"].mean(), count_gaps(states)  # doctest: +SKIP

`read_bag` returns everything, `stream_bag` one topic block by block in bounded memory, `read_serialized` the bytes as
recorded, `read_messages` the messages of a topic whose type is not numbers only.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags.cdr import STATE_TOPIC, STATE_TYPE
from hydro_bridge.bags.storage import BagSource, TopicTable, decode_span
from hydro_bridge.bags.types import RecordingError, TopicQos
from hydro_bridge.bags.writer import BagWriter
from hydro_bridge.serial.stream import LinkCounts, SequenceTracker
from hydro_core.signals import STATE_DTYPE, StateArray

__all__ = [
    "STATE_TOPIC", "BagWriter", "Extent", "Recording", "RecordingError", "TopicQos", "as_states", "count_gaps",
    "read_serialized", "read_messages", "read_bag", "stream_bag",
]  # fmt: skip


@dataclass(frozen=True)
class Extent:
    """Count and range of a field's finite values, over all rows; the table keeps every `every`-th row only."""

    every: int
    count: int = 0
    """Number of finite values."""
    low: float = inf
    high: float = -inf

    def merge(self, values: npt.ArrayLike) -> Extent:
        """Return the extent extended by further values."""
        numbers = np.asarray(values, dtype=np.float64)
        finite = numbers[np.isfinite(numbers)]
        low, high = float(np.min(finite, initial=self.low)), float(np.max(finite, initial=self.high))
        return Extent(self.every, self.count + len(finite), low, high)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One recording in memory."""

    path: Path
    topics: dict[str, str]
    """Type of each topic that has messages."""
    qos: dict[str, TopicQos]
    """Offered quality of service of each topic."""
    tables: dict[str, TopicTable]
    """Table of each topic whose type has numeric fields only."""
    extents: dict[str, dict[str, Extent]]
    """Extent of each field of each table, if `read_bag` was called with `rows`."""
    metadata: dict[str, dict[str, str]]
    """MCAP metadata records; `hydro` holds the run's parameters, code version and digests."""
    attachments: dict[str, bytes]
    """Attached files, for instance bench.yaml."""
    notes: tuple[str, ...]
    """Irregularities that the reader tolerated, a sentence each; empty for a complete recording."""

    def __getitem__(self, topic: str) -> TopicTable:
        """Return the array of a topic; raises RecordingError if there is none."""
        if topic not in self.tables:
            there = ", ".join(sorted(self.topics)) or "nothing"
            raise RecordingError(f"{self.path} has no messages on {topic}; there is {there}")
        return self.tables[topic]

    @cached_property
    def state(self) -> StateArray:
        """/hydro/state as `STATE_DTYPE` records; raises RecordingError if it is missing or of another type."""
        return as_states(self[STATE_TOPIC], self.path)


@dataclass
class _Column:
    """Growing table, thinned out where `rows` is given."""

    table: TopicTable
    rows: int | None
    count: int = 0
    seen: int = 0
    every: int = 1
    extents: dict[str, Extent] = field(default_factory=dict)

    def extend(self, piece: TopicTable) -> None:
        if self.rows is not None:
            for name in piece.dtype.names or ():
                self.extents[name] = self.extents.get(name, Extent(1)).merge(piece[name])
            first, self.seen = -self.seen % self.every, self.seen + len(piece)
            piece = piece[first :: self.every]
        if self.count + len(piece) > len(self.table):
            grown = np.empty(max(2 * len(self.table), self.count + len(piece)), self.table.dtype)
            grown[: self.count] = self.table[: self.count]
            self.table = grown
        self.table[self.count : self.count + len(piece)] = piece
        self.count += len(piece)
        while self.rows is not None and self.count >= 2 * self.rows:
            kept = self.table[: self.count : 2].copy()
            self.count, self.every = len(kept), 2 * self.every
            self.table[: self.count] = kept


def read_bag(
    path: Path | str, topics: Collection[str] | None = None, rows: int | None = None, *, skip_damaged: bool = False
) -> Recording:
    """Read a recording into arrays.

    `path`: a rosbag2 folder or an .mcap file. `topics`: topics to read; all by default. `rows`: longer tables are
    decimated to fewer than twice as many rows. `skip_damaged`: damaged blocks are skipped, with a note. Raises
    RecordingError: nothing there, damaged, or a topic in `topics` has no messages.
    """
    source = BagSource(Path(path), skip_damaged)
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
            piece = decode_span(scan.path, channel.topic, layout, block, span)
            columns.setdefault(channel.topic, _Column(np.empty(0, piece.dtype), rows)).extend(piece)
    for topic in topics or ():
        if topic not in types:
            raise source.missing_topic_error(topic, types)
    return Recording(
        path=source.path,
        topics=types,
        qos=qos,
        tables={topic: column.table[: column.count] for topic, column in columns.items()},
        extents={
            topic: {name: replace(one, every=column.every) for name, one in column.extents.items()}
            for topic, column in columns.items()
        },
        metadata={name: record for scan in source.scans for name, record in scan.metadata.items()},
        attachments={name: data for scan in source.scans for name, data in scan.attachments.items()},
        notes=tuple(source.notes),
    )


def stream_bag(
    path: Path | str, topic: str = STATE_TOPIC, notes: list[str] | None = None, *, skip_damaged: bool = False
) -> Iterator[TopicTable]:
    """Yield one topic as one array per block of the file (about a second, at most a megabyte); errors as `read_bag`.

    `notes`: receives the tolerated irregularities (`Recording.notes`) once all is read.
    """
    source = BagSource(Path(path), skip_damaged)
    for scan, channel, block, span in source.spans(topic):
        layout = source.layout(scan, channel)
        if layout is None:
            raise RecordingError(f"{scan.path}: {topic} is not numbers only")
        piece = decode_span(scan.path, topic, layout, block, span)
        yield as_states(piece, scan.path) if topic == STATE_TOPIC else piece
    if notes is not None:
        notes += source.notes


def read_serialized(path: Path | str) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, log time [ns] and bytes of each message, by log time within a block; errors as `read_bag`."""
    spans: list[tuple[int, int, str, str, int]] = []
    source, last = BagSource(Path(path)), b""

    def ordered() -> Iterator[tuple[str, str, int, bytes]]:
        for time, start, topic, type_name, size in sorted(spans):
            yield topic, type_name, time, last[start : start + size]

    for scan, channel, block, span in source.spans():
        if block is not last:
            yield from ordered()
            spans, last = [], block
        type_name = scan.schemas[channel.schema_id].name
        columns = zip(span.log_times.tolist(), span.starts.tolist(), span.sizes.tolist(), strict=True)
        spans += [(time, start, channel.topic, type_name, size) for time, start, size in columns]
    yield from ordered()


def read_messages(path: Path | str, topic: str, *, skip_damaged: bool = False) -> Iterator[tuple[float, Any]]:
    """Yield log time [s] and message object of a topic of any type such as /diagnostics; errors as `read_bag`."""
    source = BagSource(Path(path), skip_damaged)
    for scan, channel, block, span in source.spans(topic):
        yield from source.messages(scan, channel, block, span)


def as_states(table: TopicTable, path: Path) -> StateArray:
    """Return `STATE_DTYPE` records from a table that has its fields; raises RecordingError for another type."""
    if table.dtype == STATE_DTYPE:
        return table
    missing = [name for name in STATE_DTYPE.names or () if name not in (table.dtype.names or ())]
    if missing:
        raise RecordingError(f"{path}: {STATE_TOPIC} is no {STATE_TYPE}: it has no {', '.join(missing)}")
    states = np.empty(len(table), STATE_DTYPE)
    for name in STATE_DTYPE.names or ():
        states[name] = table[name]
    return states


def count_gaps(states: StateArray) -> LinkCounts:
    """Count lost, duplicate and reordered samples in `STATE_DTYPE` records, and restarts of the box."""
    tracker = SequenceTracker()
    for sequence in states["sequence"].tolist():
        tracker.accept(sequence)
    return tracker.counts
