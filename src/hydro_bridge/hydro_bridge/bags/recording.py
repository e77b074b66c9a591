# SPDX-License-Identifier: Apache-2.0
"""Recordings as arrays by field name, from a rosbag2 folder or a single .mcap of any writer.

>>> states = read_bag("runs/tuesday").state          # doctest: +SKIP
>>> states["load_force"].mean(), count_gaps(states)  # doctest: +SKIP

`read_bag` returns everything, `stream_bag` one topic block by block in bounded memory, `read_messages` the messages of
a topic whose type is not numbers only.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.bags.cdr import STATE_TOPIC, STATE_TYPE
from hydro_bridge.bags.storage import Bag, TopicTable, missing_topic_error
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.bags.writer import BagWriter
from hydro_bridge.serial.stream import LinkCounts, SequenceTracker
from hydro_core.signals import STATE_DTYPE, StateArray

__all__ = [
    "STATE_TOPIC", "BagWriter", "Recording", "RecordingError", "as_states", "count_gaps", "read_messages",
    "read_bag", "stream_bag",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One recording in memory."""

    path: Path
    topics: dict[str, str]
    """Type of each topic that has messages."""
    tables: dict[str, TopicTable]
    """Table of each topic whose type has numeric fields only."""
    metadata: dict[str, dict[str, str]]
    """MCAP metadata records; `hydro` holds the run's parameters, code version and digests."""
    attachments: dict[str, bytes]
    """Attached files, for instance bench.yaml."""
    notes: tuple[str, ...]
    """A sentence on each file that is torn or damaged; empty for a complete recording."""

    def __getitem__(self, topic: str) -> TopicTable:
        """Return the array of a topic; raises RecordingError if there is none."""
        if topic not in self.tables:
            raise missing_topic_error(self.path, topic, self.topics)
        return self.tables[topic]

    @cached_property
    def state(self) -> StateArray:
        """/hydro/state as `STATE_DTYPE` records; raises RecordingError if it is missing or of another type."""
        return as_states(self[STATE_TOPIC], self.path)


def read_bag(path: Path | str, topics: Collection[str] | None = None, *, skip_damaged: bool = False) -> Recording:
    """Read a recording into memory.

    `path`: a rosbag2 folder, an .mcap file, or a part of one: `runs/day#t=3600,7200`. `topics`: those to read; None:
    all whose types have numeric fields only. `skip_damaged`: skip damaged chunks, with a note. Raises RecordingError:
    the recording is missing, damaged or not MCAP, or one of `topics` has no messages.
    """
    bag = Bag(path, skip_damaged=skip_damaged)
    types: dict[str, str] = {}
    parts: dict[str, list[TopicTable]] = {}
    for piece in bag.pieces():
        types.setdefault(piece.topic, piece.schema.name)
        if (topics is None or piece.topic in topics) and (table := piece.table()) is not None:
            parts.setdefault(piece.topic, []).append(table)
    for topic in topics or ():
        if topic not in types:
            raise missing_topic_error(bag.path, topic, types)
    return Recording(
        path=bag.path,
        topics=types,
        tables={topic: np.concatenate(tables) for topic, tables in parts.items()},
        metadata=bag.metadata,
        attachments=bag.attachments,
        notes=tuple(bag.notes),
    )


def stream_bag(
    path: Path | str, topic: str = STATE_TOPIC, notes: list[str] | None = None, *, skip_damaged: bool = False
) -> Iterator[TopicTable]:
    """Yield one topic as one array per block of the file (about a second, at most a megabyte); errors as `read_bag`.

    `notes`: receives `Recording.notes` once all is read.
    """
    bag = Bag(path, skip_damaged=skip_damaged)
    for piece in bag.pieces(topic):
        if (table := piece.table()) is None:
            raise RecordingError(f"{piece.path}: {topic} is not numbers only")
        yield as_states(table, piece.path) if topic == STATE_TOPIC else table
    if notes is not None:
        notes += bag.notes


def read_messages(path: Path | str, topic: str, *, skip_damaged: bool = False) -> Iterator[tuple[float, Any]]:
    """Yield log time [s] and message object of a topic of any type such as /diagnostics; errors as `read_bag`."""
    for piece in Bag(path, skip_damaged=skip_damaged).pieces(topic):
        yield from piece.messages()


def as_states(table: TopicTable, path: Path) -> StateArray:
    """Return `STATE_DTYPE` records from a table that has its fields; raises RecordingError for another type."""
    names = STATE_DTYPE.names or ()
    if missing := {*names} - {*(table.dtype.names or ())}:
        raise RecordingError(f"{path}: {STATE_TOPIC} is no {STATE_TYPE}: it has no {', '.join(sorted(missing))}")
    if table.dtype == STATE_DTYPE:
        return table
    states = np.empty(len(table), STATE_DTYPE)
    for name in names:
        states[name] = table[name]
    return states


def count_gaps(states: StateArray) -> LinkCounts:
    """Count lost, duplicate and reordered samples in `STATE_DTYPE` records, and restarts of the box."""
    tracker = SequenceTracker()
    for sequence in states["sequence"].tolist():
        tracker.accept(sequence)
    return tracker.counts
