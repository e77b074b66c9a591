# SPDX-License-Identifier: Apache-2.0
"""Sequential access to the files of a recording: the messages of each channel in each chunk, and their decoding.

A file is read in one pass that needs neither index nor summary, with the checksum of every chunk: complete and torn
files, and parts of them, are read alike. Chunks outside of a part are not unpacked.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from io import SEEK_END, BytesIO
from math import inf
from pathlib import Path
from struct import Struct
from struct import error as struct_error
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from hydro_bridge.bags.cdr import NotFixedError, fixed_layout
from hydro_bridge.bags.location import mcap_files, split_location
from hydro_bridge.bags.types import RecordingError

TopicTable = npt.NDArray[np.void]
"""Structured array of one topic: `time` [s], then the message's fields."""
MESSAGE_HEAD = np.dtype([
    ("opcode", "u1"), ("length", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<i8"),
    ("publish_time", "<i8"),
])  # fmt: skip
"""Bytes before the data of a message; times in ns."""
_RECORD_HEAD, _BLOCK_HEAD, _MAGIC = Struct("<BQ"), Struct("<BQH"), b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class Piece:
    """Messages of one channel in one block of a file."""

    path: Path
    topic: str
    channel: Channel
    schema: Schema
    block: bytes
    starts: npt.NDArray[np.int64]
    """Offset of each serialized message in the block."""
    sizes: npt.NDArray[np.int64]
    heads: npt.NDArray[np.void]
    """`MESSAGE_HEAD` of each message."""

    def table(self) -> TopicTable | None:
        """Return the messages as a table, None if not all fields of their type are numbers; raises RecordingError."""
        if self.schema.encoding != "ros2msg" or self.channel.message_encoding != "cdr":
            return None
        try:
            layout = fixed_layout(self.schema.name, self.schema.data.decode())
            out = np.empty(len(self.starts), layout.table)
            for size in np.unique(self.sizes):
                part = self.sizes == size
                out[part] = layout.decode(_rows(self.block, int(size), self.starts[part]), self.heads["log_time"][part])
        except NotFixedError:
            return None
        except Exception as error:  # a broken definition raises errors of rosbags' parser
            raise self._error(error) from None
        return out

    def serialized(self) -> Iterator[tuple[int, bytes]]:
        """Yield log time [ns] and bytes of each message."""
        places = zip(self.heads["log_time"].tolist(), self.starts.tolist(), self.sizes.tolist(), strict=True)
        for time_ns, start, size in places:
            yield time_ns, self.block[start : start + size]

    def messages(self) -> Iterator[tuple[float, Any]]:
        """Yield log time [s] and message object of each message; raises RecordingError."""
        try:
            types = _typestore(self.schema.name, self.schema.encoding, self.schema.data)
            for time_ns, data in self.serialized():
                yield 1e-9 * time_ns, types.deserialize_cdr(data, self.schema.name)
        except Exception as error:
            raise self._error(error) from None

    def _error(self, error: Exception) -> RecordingError:
        return RecordingError(f"{self.path}: {self.topic} cannot be read as {self.schema.name}: {error}")


def missing_topic_error(path: Path, topic: str, there: Iterable[str]) -> RecordingError:
    """Return the error that `topic` is not among those that are `there`."""
    return RecordingError(f"{path} has no messages on {topic}; there is {', '.join(sorted(there)) or 'nothing'}")


def _rows(block: bytes, size: int, starts: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    """Return `size` bytes of the block from each start on, shape (n, size)."""
    return np.lib.stride_tricks.sliding_window_view(np.frombuffer(block, np.uint8), size)[np.asarray(starts)]


@cache
def _typestore(name: str, encoding: str, definition: bytes) -> Typestore:
    store, text = get_typestore(Stores.EMPTY), definition.decode()
    types = get_types_from_idl(text) if encoding == "ros2idl" else get_types_from_msg(text, name)
    store.register({kind: types[kind] for kind in types.keys() - store.types.keys()})
    return store


class Bag:
    """The files of one recording, or of a part of it, read one after the other; `pieces` fills in the attributes."""

    def __init__(self, path: Path | str, *, skip_damaged: bool = False) -> None:
        self.path, self._skip_damaged = Path(path), skip_damaged
        whole, self._part = split_location(path)
        self.files = mcap_files(whole)
        self.metadata: dict[str, dict[str, str]] = {}
        """Metadata records of all files."""
        self.attachments: dict[str, bytes] = {}
        self.notes: list[str] = []
        """A sentence on each file that is torn or damaged."""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._begin, self._end = -inf, inf  # ns
        self._finished, self._damaged = False, 0  # of the present file

    def pieces(self, topic: str | None = None) -> Iterator[Piece]:
        """Yield each channel's messages in each block of each file.

        `topic`: only those of this topic. Raises RecordingError: not MCAP, damaged, or none of this topic. A torn file
        is read up to its end.
        """
        if self._part is not None:
            first = next((piece.heads["log_time"][0] for piece in Bag(self.files[0]).pieces()), 0)
            self._begin, self._end = (float(first + 1e9 * edge) for edge in self._part)
        there: set[str] = set()
        for path in self.files:
            self._schemas, self._channels = {0: Schema(id=0, data=b"", encoding="", name="")}, {}
            self._finished, self._damaged = False, 0
            try:
                with path.open("rb") as stream:
                    for block in self._blocks(path, stream):
                        for piece in self._split(path, block):
                            there.add(piece.topic)
                            if topic in (None, piece.topic):
                                yield piece
            except OSError as error:
                raise RecordingError(f"{path} cannot be read: {error.strerror}") from None
            if self._damaged:
                self.notes.append(f"{path.name} is damaged: {self._damaged} of its blocks could not be read")
            elif not self._finished:
                self.notes.append(f"{path.name} was not finished (its recorder was killed?): read up to its end")
        if topic is not None and topic not in there:
            raise missing_topic_error(self.path, topic, there)

    def _blocks(self, path: Path, stream: BinaryIO) -> Iterator[bytes]:
        """Yield the content of each chunk, and a megabyte at a time the messages outside of chunks."""
        if (magic := stream.read(len(_MAGIC))) != _MAGIC:
            raise RecordingError(f"{path} {'is not an MCAP file' if magic else 'is empty'}")
        if self._skip_damaged:
            stream.seek(0)
            with suppress(McapError, struct_error):  # declarations that are in a damaged chunk are in the summary, too
                summary = SeekingReader(stream).get_summary()
                self._schemas |= summary.schemas if summary else {}
                self._channels |= summary.channels if summary else {}
        size, loose = stream.seek(0, SEEK_END), bytearray()
        stream.seek(len(_MAGIC))
        while len(head := stream.read(_RECORD_HEAD.size)) == _RECORD_HEAD.size:
            opcode, length = _RECORD_HEAD.unpack(head)
            if opcode == 0 or stream.tell() + length > size:
                break
            body = stream.read(length)
            if opcode == Opcode.CHUNK:
                yield self._content(path, body)
            elif opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                loose += head + body
            elif opcode == Opcode.METADATA:
                record = Metadata.read(ReadDataStream(BytesIO(body)))
                self.metadata[record.name] = record.metadata
            elif opcode == Opcode.ATTACHMENT:
                attachment = Attachment.read(ReadDataStream(BytesIO(body)))
                self.attachments[attachment.name] = attachment.data
            elif opcode == Opcode.DATA_END:
                stream.seek(size - len(_MAGIC))
                self._finished = stream.read() == _MAGIC
                break
            if len(loose) > 1 << 20:
                yield bytes(loose)
                loose.clear()
        yield bytes(loose)

    def _content(self, path: Path, body: bytes) -> bytes:
        """Return the content of a chunk: empty if it has no message of the part, or is damaged and skipped."""
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            if self._channels and not (chunk.message_start_time < self._end and chunk.message_end_time >= self._begin):
                return b""
            unpacked, size = get_chunk_data_stream(chunk, validate_crc=True)
            return unpacked.read(size)
        except Exception as error:
            if self._skip_damaged:
                self._damaged += 1
                return b""
            remedy = "`ros2 run hydro_bridge recorder --repair FOLDER` leaves the chunk out"
            raise RecordingError(f"{path} is damaged: {error}: {remedy}") from None

    def _split(self, path: Path, block: bytes) -> Iterator[Piece]:
        """Yield the messages of each channel in a block; store schemas and channels."""
        places: dict[int, list[int]] = defaultdict(list)
        place, size, head, kind = 0, len(block), _BLOCK_HEAD.unpack_from, int(Opcode.MESSAGE)
        while place + _BLOCK_HEAD.size <= size:
            opcode, length, number = head(block, place)
            if opcode == kind:
                places[number].append(place)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                body = ReadDataStream(BytesIO(block[place + _RECORD_HEAD.size : place + _RECORD_HEAD.size + length]))
                if opcode == Opcode.SCHEMA:
                    schema = Schema.read(body)
                    self._schemas[schema.id] = schema
                else:
                    channel = Channel.read(body)
                    self._channels[channel.id] = channel
            place += _RECORD_HEAD.size + length
        for number, begins in places.items():
            if number not in self._channels:  # its declaration was in a damaged chunk
                self._damaged += 1
                continue
            heads = _rows(block, MESSAGE_HEAD.itemsize, begins).view(MESSAGE_HEAD)[:, 0]
            kept = (heads["log_time"] >= self._begin) & (heads["log_time"] < self._end)
            heads, starts = heads[kept], np.array(begins)[kept] + MESSAGE_HEAD.itemsize
            if len(heads):
                channel, sizes = self._channels[number], heads["length"] + _RECORD_HEAD.size - MESSAGE_HEAD.itemsize
                yield Piece(path, channel.topic, channel, self._schemas[channel.schema_id], block, starts, sizes, heads)
