# SPDX-License-Identifier: Apache-2.0
"""Sequential access to the files of a recording: the bytes of each channel and their decoding into tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.records import Channel
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hydro_bridge.bags.cdr import FixedLayout, NotFixedError, fixed_layout
from hydro_bridge.bags.files import mcap_files
from hydro_bridge.bags.mcap_scan import McapScan, Span
from hydro_bridge.bags.schema import UnknownTypeError, definition
from hydro_bridge.bags.types import RecordingError

Table = npt.NDArray[np.void]
"""Structured array of one topic: `time` [s], then the message's fields."""


@dataclass
class BagSource:
    """The files of one recording, read one after the other."""

    path: Path
    scans: list[McapScan] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _layouts: dict[tuple[str, str], FixedLayout | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        files, self.notes = mcap_files(self.path)
        self.scans = [McapScan(path) for path in files]

    def spans(self) -> Iterator[tuple[McapScan, Channel, bytes, Span]]:
        """Yield each channel's messages in each block of each file; raises RecordingError."""
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

    def type_of(self, scan: McapScan, channel: Channel) -> tuple[str, str]:
        """Return name and ros2msg text of a channel's type; raises RecordingError."""
        schema = scan.schemas.get(channel.schema_id)
        if schema is None or channel.message_encoding != "cdr":
            raise RecordingError(f"{scan.path}: {channel.topic} has no type or is not CDR")
        try:
            text = schema.data.decode() if schema.encoding == "ros2msg" else definition(schema.name).text
        except (UnknownTypeError, UnicodeDecodeError):
            raise RecordingError(f"{scan.path}: the definition of {schema.name} cannot be read") from None
        return schema.name, text

    def layout(self, scan: McapScan, channel: Channel) -> FixedLayout | None:
        """Return the layout of a channel's type, None if it is not numbers only; raises RecordingError."""
        name, text = self.type_of(scan, channel)
        if (name, text) not in self._layouts:
            try:
                self._layouts[name, text] = fixed_layout(text, name)
            except NotFixedError:
                self._layouts[name, text] = None
            except Exception as error:
                raise RecordingError(f"{scan.path}: the definition of {name} cannot be read: {error}") from None
        return self._layouts[name, text]


class MessageDecoder:
    """Decoder of messages of any type into objects; a topic's type is that of its first channel."""

    def __init__(self, source: BagSource) -> None:
        self._source, self._store = source, get_typestore(Stores.EMPTY)
        self._known: set[str] = set()

    def objects(self, scan: McapScan, channel: Channel, block: bytes, span: Span) -> Iterator[tuple[float, Any]]:
        """Yield log time [s] and message of one channel in one block; raises RecordingError."""
        name, text = self._source.type_of(scan, channel)
        if name not in self._known:
            self._store.register(
                {
                    kind: fields
                    for kind, fields in get_types_from_msg(text, name).items()
                    if kind not in self._store.types
                }
            )
            self._known.add(name)
        places = zip(span.starts.tolist(), span.sizes.tolist(), span.log_times.tolist(), strict=True)
        for start, size, time_ns in places:
            yield 1e-9 * time_ns, self._store.deserialize_cdr(block[start : start + size], name)


def decode_span(path: Path, topic: str, layout: FixedLayout, block: bytes, span: Span) -> Table:
    """Return the table of one channel's messages in one block; raises RecordingError."""
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
