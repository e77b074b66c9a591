# SPDX-License-Identifier: Apache-2.0
"""Recordings as arrays by field name, from a rosbag2 folder or a single .mcap of any writer.

>>> recording = read_bag("runs/tuesday")     # doctest: +SKIP
>>> recording.state["load_force"].mean()     # doctest: +SKIP

`read_bag` returns everything, `stream_bag` one topic block by block in bounded memory, `read_messages` the messages of
a topic whose type is not numbers only.

A file is read in one pass that needs neither index nor summary, with the checksum of every chunk: complete and torn
files, and parts of them, are read alike. Chunks outside of a part are not unpacked.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from io import SEEK_END, BytesIO
from math import inf
from pathlib import Path
from struct import Struct
from struct import error as struct_error
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
import yaml
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from hydro_bridge.bags import RecordingError, split_location
from hydro_bridge.bags.cdr import STATE_TOPIC, STATE_TYPE, NotFixedError, fixed_layout
from hydro_bridge.bags.writer import BagWriter
from hydro_core.signals import STATE_DTYPE, StateArray

__all__ = [
    "STATE_TOPIC", "Bag", "BagWriter", "Piece", "RecordingError", "as_states",
    "read_bag", "read_messages", "stream_bag",
]  # fmt: skip

TopicTable = npt.NDArray[np.void]
"""Structured array of one topic: `time` [s], then the message's fields."""
_MESSAGE_HEAD = np.dtype([
    ("opcode", "u1"), ("length", "<i8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<i8"),
    ("publish_time", "<i8"),
])  # fmt: skip
_RECORD_HEAD, _BLOCK_HEAD, _MAGIC = Struct("<BQ"), Struct("<BQH"), b"\x89MCAP0\r\n"


def read_bag(path: Path | str, topics: Collection[str] | None = None, *, skip_damaged: bool = False) -> Bag:
    """Read a recording into memory.

    `path`: a rosbag2 folder, an .mcap file, or a part of one: `runs/day#t=3600,7200`. `topics`: those to read; None:
    all whose types have numeric fields only. `skip_damaged`: skip damaged chunks, with a note. Raises RecordingError:
    the recording is missing, damaged or not MCAP, or one of `topics` has no messages.
    """
    bag = Bag(path, skip_damaged=skip_damaged)
    parts: dict[str, list[TopicTable]] = defaultdict(list)
    for piece in bag.pieces():
        if (topics is None or piece.topic in topics) and (table := piece.table()) is not None:
            parts[piece.topic].append(table)
    for topic in topics or ():
        if topic not in bag.topics:
            raise missing_topic_error(bag.path, topic, bag.topics)
    bag.tables = {topic: np.concatenate(tables) for topic, tables in parts.items()}
    return bag


def stream_bag(
    path: Path | str, topic: str = STATE_TOPIC, notes: list[str] | None = None, *, skip_damaged: bool = False
) -> Iterator[TopicTable]:
    """Yield one topic as one array per block of the file (about a second, at most a megabyte); errors as `read_bag`.

    `notes`: receives `Bag.notes` once all is read.
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
    return table[[*names]].astype(STATE_DTYPE, copy=False)


@dataclass(frozen=True)
class Piece:
    """Messages of one channel in one block of a file."""

    path: Path
    channel: Channel
    schema: Schema
    block: bytes
    starts: npt.NDArray[np.int64]
    """Offset of each serialized message in the block."""
    sizes: npt.NDArray[np.int64]
    heads: npt.NDArray[np.void]
    """Length, sequence, log and publish time [ns] of each message."""

    @property
    def topic(self) -> str:
        """Topic of the channel."""
        return self.channel.topic

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
            return out
        except NotFixedError:
            return None
        except Exception as error:  # a broken definition raises errors of rosbags' parser
            raise self._error(error) from None

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
    """One recording, or a part of it: files that `pieces` reads one after the other, and what it found in them."""

    def __init__(self, path: Path | str, *, skip_damaged: bool = False) -> None:
        self.path, self._skip_damaged = Path(path), skip_damaged
        whole, self._part = split_location(path)
        self.files = _mcap_files(whole)
        self.topics: dict[str, str] = {}
        """Type of each topic that has messages."""
        self.tables: dict[str, TopicTable] = {}
        """From `read_bag`, the table of each topic whose type has numeric fields only."""
        self.metadata: dict[str, dict[str, str]] = {}
        """MCAP metadata records; `hydro` holds the run's parameters, code version and digests."""
        self.attachments: dict[str, bytes] = {}
        """Attached files, for instance bench.yaml."""
        self.notes: tuple[str, ...] = ()
        """A sentence on each file that is torn or damaged; empty for a complete recording."""
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._begin, self._end = -inf, inf  # ns
        self._finished, self._damaged = False, 0  # of the present file

    def __getitem__(self, topic: str) -> TopicTable:
        """Return the table of a topic; raises RecordingError if there is none."""
        if topic not in self.tables:
            raise missing_topic_error(self.path, topic, self.topics)
        return self.tables[topic]

    @cached_property
    def state(self) -> StateArray:
        """/hydro/state as `STATE_DTYPE` records; raises RecordingError if it is missing or of another type."""
        return as_states(self[STATE_TOPIC], self.path)

    def pieces(self, topic: str | None = None) -> Iterator[Piece]:
        """Yield each channel's messages in each block of each file.

        `topic`: only those of this topic. Raises RecordingError: not MCAP, damaged, or none of this topic. A torn file
        is read up to its end.
        """
        if self._part is not None:
            first = next((piece.heads["log_time"][0] for piece in Bag(self.files[0]).pieces()), 0)
            self._begin, self._end = (float(first + 1e9 * edge) for edge in self._part)
        for path in self.files:
            self._schemas, self._channels = {0: Schema(id=0, data=b"", encoding="", name="")}, {}
            self._finished, self._damaged = False, 0
            try:
                with path.open("rb") as stream:
                    for block in self._blocks(path, stream):
                        for piece in self._split(path, block):
                            self.topics.setdefault(piece.topic, piece.schema.name)
                            if topic in (None, piece.topic):
                                yield piece
            except OSError as error:
                raise RecordingError(f"{path} cannot be read: {error.strerror}") from None
            if self._damaged:
                self.notes += (f"{path.name} is damaged: {self._damaged} of its blocks could not be read",)
            elif not self._finished:
                self.notes += (f"{path.name} was not finished (its recorder was killed?): read up to its end",)
        if topic is not None and topic not in self.topics:
            raise missing_topic_error(self.path, topic, self.topics)

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
                    self._schemas |= {(schema := Schema.read(body)).id: schema}
                else:
                    self._channels |= {(channel := Channel.read(body)).id: channel}
            place += _RECORD_HEAD.size + length
        for number, begins in places.items():
            if number not in self._channels:  # its declaration was in a damaged chunk
                self._damaged += 1
                continue
            heads = _rows(block, _MESSAGE_HEAD.itemsize, begins).view(_MESSAGE_HEAD)[:, 0]
            kept = (heads["log_time"] >= self._begin) & (heads["log_time"] < self._end)
            heads, starts = heads[kept], np.array(begins)[kept] + _MESSAGE_HEAD.itemsize
            if len(heads):
                channel, sizes = self._channels[number], heads["length"] + _RECORD_HEAD.size - _MESSAGE_HEAD.itemsize
                yield Piece(path, channel, self._schemas[channel.schema_id], block, starts, sizes, heads)


def _mcap_files(path: Path) -> list[Path]:
    """Return the .mcap files of a recording, in order: those that metadata.yaml lists, without one all in the folder.

    Raises RecordingError: nothing is there, a listed file is missing, or the recording is not stored as plain mcap.
    """
    if not path.exists():
        raise RecordingError(f"{path} does not exist")
    files, listing = [path], path / "metadata.yaml"
    if listing.is_file():
        try:
            information = yaml.safe_load(listing.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
            files = [path / Path(name).name for name in information["relative_file_paths"]]
        except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
            raise RecordingError(f"{listing} is not rosbag2 metadata: remove it to read the .mcap files") from None
    elif path.is_dir():  # day_2 before day_10
        files = sorted(path.glob("*.mcap"), key=lambda file: [int(word) for word in re.findall(r"\d+", file.name)])
    if any(file.suffix in (".bag", ".db3", ".zstd") for file in files):
        source = path.parent if path.suffix == ".db3" else path
        command = f"rosbags-convert --src {source} --dst {source.with_name(f'{source.stem}_mcap')} --dst-storage mcap"
        raise RecordingError(f"{path} is not stored as plain mcap: {command}")
    if not files:
        raise RecordingError(f"{path} is no recording: there is no .mcap in it")
    if missing := [file.name for file in files if not file.exists()]:
        names = ", ".join(missing)
        raise RecordingError(f"{listing} lists {names}, which is missing: put it back, or remove metadata.yaml")
    return files
