# SPDX-License-Identifier: Apache-2.0
"""Sequential access to the files of a recording: the bytes of each channel and their decoding into tables."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BytesIO
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
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from mcap.summary import Summary
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from hydro_bridge.bags.cdr import FixedLayout, NotFixedError, fixed_layout
from hydro_bridge.bags.location import is_remote, open_file, split_location
from hydro_bridge.bags.types import RecordingError, UnknownTypeError, definition

MIXED_FILES_NOTE = ", of several recordings"
"""Part of the note on a folder whose file names belong to several recordings."""


def _to_mcap(path: Path) -> str:
    """Return the command that makes a recording of another format readable."""
    return f"rosbags-convert --src {path} --dst {path.with_name(f'{path.stem}_mcap')} --dst-storage mcap"


def mcap_files(path: Path) -> tuple[list[Path], list[str]]:
    """Return the .mcap files in order, and notes on anything unusual about the folder.

    Raises RecordingError: nothing there, or a recording that is not stored as plain mcap.
    """
    if path.is_file() and path.suffix == ".bag":
        raise RecordingError(f"{path} is a bag of ROS 1: {_to_mcap(path)}")
    if path.is_file() and path.suffix == ".db3":
        raise RecordingError(f"{path} is a file of an SQLite bag: name its folder")
    if path.is_file() or is_remote(path):
        return [path], []
    if not path.is_dir():
        raise RecordingError(f"{path} does not exist")
    if not (path / "metadata.yaml").is_file():
        files = sorted(path.glob("*.mcap"), key=_by_number)
        several = len({re.sub(r"(_\d+)?$", "", file.stem) for file in files}) > 1
        notes = [f"{path} has no metadata.yaml: read every .mcap in it" + (MIXED_FILES_NOTE if several else "")]
    else:
        information = _information(path)
        storage = information.get("storage_identifier")
        mode = str(information.get("compression_mode") or "none").lower()
        if storage != "mcap":
            raise RecordingError(f"{path} is stored as {storage}, not as mcap: {_to_mcap(path)}")
        if mode != "none":
            raise RecordingError(f"{path} is compressed by {mode}, not within mcap: {_to_mcap(path)}")
        files, notes = _found(path, [path / Path(name).name for name in information["relative_file_paths"]])
    if not files and list(path.glob("*.db3")):
        raise RecordingError(
            f"{path} is an SQLite bag without metadata.yaml: `ros2 bag reindex {path} sqlite3` writes it, then "
            f"{_to_mcap(path)}"
        )
    if not files:
        raise RecordingError(f"{path} holds no recording: there is no .mcap in it")
    return files, notes


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Key by which day_2 comes before day_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _found(folder: Path, listed: list[Path]) -> tuple[list[Path], list[str]]:
    """Return the listed files that are there, and notes on those that are not, and on those that are not listed.

    Raises RecordingError: none is there, and it is not a single one under another name.
    """
    others = sorted(set(folder.glob("*.mcap")) - set(listed), key=_by_number)
    absent = [path.name for path in listed if not path.exists()]
    if len(absent) == len(listed) == len(others):
        note = f"{folder}: metadata.yaml lists {', '.join(absent)}, which is not there: read as its new name"
        return others, [f"{note} {', '.join(path.name for path in others)}"]
    if len(absent) == len(listed):
        there = ", ".join(path.name for path in others) or "no .mcap at all"
        raise RecordingError(f"{folder}: metadata.yaml lists {', '.join(absent)}; there is {there}")
    notes = [f"{folder}: metadata.yaml lists {name}, which is not there" for name in absent]
    notes += [f"{folder} holds {path.name}, which metadata.yaml does not list: not read" for path in others]
    return [path for path in listed if path.exists()], notes


def _information(folder: Path) -> dict[str, Any]:
    """Return the content of metadata.yaml; raises RecordingError."""
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
        found: dict[str, Any] = yaml.safe_load(text)["rosbag2_bagfile_information"]
        found["relative_file_paths"]
    except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError):
        raise RecordingError(f"{folder / 'metadata.yaml'} is not rosbag2 metadata") from None
    return found


def listed_topics(folder: Path) -> list[tuple[str, str]]:
    """Return topics and types in the order of metadata.yaml; empty where it is not there or damaged."""
    with suppress(OSError, RecordingError, KeyError, TypeError):
        entries = [topic["topic_metadata"] for topic in _information(folder)["topics_with_message_count"]]
        return [(entry["name"], entry["type"]) for entry in entries]
    return []


_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = Struct("<BQ")
MESSAGE_HEAD = Struct("<HIQQ")
"""Channel, sequence, log time and publish time [ns] before the data of a message."""
_LOOSE_BATCH_SIZE = 1 << 20  # bytes of messages outside chunks that are yielded together


@dataclass(frozen=True, kw_only=True)
class Span:
    """Location of one channel's messages in a block."""

    starts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    log_times: npt.NDArray[np.int64]
    """ns."""


@dataclass
class McapScan:
    """Content of one .mcap file; filled in while `blocks` iterates."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    finished: bool = False
    """Whether the file is complete up to its closing magic bytes."""
    interval: tuple[float, float] | None = None
    """Interval [ns] of the log times to read, without metadata and attachments; None: all messages."""
    skip_damaged: bool = False
    """Whether damaged chunks are skipped instead of raising an error."""
    damaged: int = 0
    """Number of skipped chunks."""
    unread: int = 0
    """Bytes after the last readable record of an unfinished file."""
    from_this_package: bool = False
    """Whether this package wrote the file: its channels are then numbered in the order of metadata.yaml."""

    def blocks(self) -> Iterator[tuple[bytes, dict[int, Span]]]:
        """Yield the bytes of each block and the location of each channel's messages in it.

        Raises RecordingError: not an MCAP file, or a damaged chunk. A truncated file raises nothing: `finished` stays
        False.
        """
        with self._opened() as (stream, size):
            if self.interval is not None:
                summary = self._index(stream)
                self.schemas, self.channels, self.finished = dict(summary.schemas), dict(summary.channels), True
                begin, end = self.interval
                chunks = self._indexed_chunks(stream)
                wanted = [one for one in chunks if one.message_start_time < end and one.message_end_time >= begin]
                for block in self._blocks_of(stream, wanted):
                    yield block, self._split(block, begin, end)
                return
            if self.skip_damaged:
                with suppress(RecordingError):  # the chunk that declares the channels may be damaged
                    summary = self._index(stream)
                    self.schemas, self.channels = dict(summary.schemas), dict(summary.channels)
                stream.seek(len(_MAGIC))
            for block in self._raw_blocks(stream, size):
                yield block, self._split(block)

    def times(self) -> tuple[int, int]:
        """Return the log times [ns] of the first and last message from the index; raises RecordingError as `blocks`."""
        with self._opened() as (stream, _):
            statistics = self._index(stream).statistics
        return (statistics.message_start_time, statistics.message_end_time) if statistics else (0, 0)

    @contextmanager
    def _opened(self) -> Iterator[tuple[BinaryIO, int]]:
        try:
            stream, size = open_file(self.path)
            with stream:
                if stream.read(len(_MAGIC)) != _MAGIC:
                    empty = "is empty" if size == 0 else "is not an MCAP file"
                    raise RecordingError(f"{self.path} {empty}")
                yield stream, size
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be read: {error.strerror or error}") from None

    def add_channel(self, number: int, listed: list[tuple[str, str]]) -> None:
        """Add a channel whose description is lost, as entry `number` of the topics and types in metadata.yaml."""
        with suppress(UnknownTypeError, IndexError):
            topic, type_name = listed[number - 1]
            text = definition(type_name).text.encode()
            schema = next((one for one in self.schemas.values() if one.name == type_name), None)
            schema = schema or Schema(id=0xFF00 + number, data=text, encoding="ros2msg", name=type_name)
            self.schemas[schema.id] = schema
            self.channels[number] = Channel(
                id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=schema.id
            )

    def _index(self, stream: BinaryIO) -> Summary:
        stream.seek(0)
        try:
            summary = SeekingReader(stream).get_summary()
        except (McapError, struct_error):
            summary = None
        if summary is None or (not summary.chunk_indexes and summary.statistics and summary.statistics.message_count):
            raise RecordingError(
                f"{self.path} has no index, so that no part of it can be found: "
                "`ros2 run hydro_bridge recorder --repair FOLDER` makes one"
            )
        return summary

    def _indexed_chunks(self, stream: BinaryIO, behind: int = 0) -> list[ChunkIndex]:
        """Return the entries of the index from a place in the file on, in its order; raises RecordingError."""
        chunks = [chunk for chunk in self._index(stream).chunk_indexes if chunk.chunk_start_offset > behind]
        return sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)

    def _blocks_of(self, stream: BinaryIO, chunks: Iterable[ChunkIndex]) -> Iterator[bytes]:
        for chunk in chunks:
            stream.seek(chunk.chunk_start_offset + _RECORD_HEAD.size)
            yield from self._chunk(stream, chunk.chunk_length - _RECORD_HEAD.size)

    def _raw_blocks(self, stream: BinaryIO, size: int) -> Iterator[bytes]:
        loose = bytearray()
        while len(head := stream.read(_RECORD_HEAD.size)) == _RECORD_HEAD.size:
            opcode, length = _RECORD_HEAD.unpack(head)
            if opcode == 0 or stream.tell() + length > size:
                self.unread = size - stream.tell() + _RECORD_HEAD.size  # cut off here
                if self.skip_damaged:
                    with suppress(RecordingError):  # the chunks behind it, by the index, if there is one
                        chunks = self._indexed_chunks(stream, behind=stream.tell())
                        self.unread, self.damaged = 0, self.damaged + 1
                        yield from self._blocks_of(stream, chunks)
                break
            if opcode == Opcode.HEADER:
                self.from_this_package = b"hydro_bridge" in stream.read(length)
                continue
            if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                loose += head + stream.read(length)
            elif opcode == Opcode.CHUNK:
                yield from self._chunk(stream, length)
            elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
                self._keep(opcode, stream.read(length))
            elif opcode == Opcode.DATA_END:
                stream.seek(size - len(_MAGIC))
                self.finished = stream.read() == _MAGIC  # else its index is cut off
                break
            else:
                stream.seek(length, 1)
            if len(loose) > _LOOSE_BATCH_SIZE:
                yield bytes(loose)
                loose.clear()
        if loose:
            yield bytes(loose)

    def _chunk(self, stream: BinaryIO, length: int) -> Iterator[bytes]:
        """Yield the content of the chunk that begins here; nothing of a damaged one that is skipped."""
        place, body = stream.tell(), stream.read(length)
        try:
            unpacked, size = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(body))), validate_crc=True)
            content = unpacked.read(size)
        except Exception as error:
            if not self.skip_damaged:
                chunk, wrong = f"the chunk at byte {place}", isinstance(error, CRCValidationError)
                told = f"the check sum of {chunk} does not hold" if wrong else f"{chunk} cannot be unpacked: {error}"
                raise RecordingError(f"{self.path} is damaged: {told}") from None
            self.damaged += 1
        else:
            yield content

    def _split(self, block: bytes, begin: float = -inf, end: float = inf) -> dict[int, Span]:
        """Return the messages of each channel with `begin` <= log time < `end` [ns]; store schemas and channels."""
        places: dict[int, list[tuple[int, int, int]]] = {}
        place, size = 0, len(block)
        record, message, kind = (_RECORD_HEAD.unpack_from, MESSAGE_HEAD.unpack_from, int(Opcode.MESSAGE))
        while place + _RECORD_HEAD.size <= size:
            opcode, length = record(block, place)
            place += _RECORD_HEAD.size
            if opcode == kind:
                channel, _, log_time, _ = message(block, place)
                entry = (place + MESSAGE_HEAD.size, length - MESSAGE_HEAD.size, log_time)
                places.setdefault(channel, []).append(entry)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._keep(opcode, block[place : place + length])
            place += length
        spans: dict[int, Span] = {}
        for channel, entries in places.items():
            starts, sizes, log_times = np.array(entries, np.int64).T
            kept = (log_times >= begin) & (log_times < end)
            if kept.any():
                spans[channel] = Span(starts=starts[kept], sizes=sizes[kept], log_times=log_times[kept])
        return spans

    def _keep(self, opcode: int, body: bytes) -> None:
        """Store a schema, channel, metadata or attachment record; others are ignored."""
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            record = Metadata.read(stream)
            self.metadata[record.name] = record.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            self.attachments[attachment.name] = attachment.data


TopicTable = npt.NDArray[np.void]
"""Structured array of one topic: `time` [s], then the message's fields."""


@dataclass
class BagSource:
    """The files of one recording, read one after the other."""

    path: Path
    skip_damaged: bool = False
    """Whether damaged blocks are skipped, with a note, instead of raising an error."""
    scans: list[McapScan] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _layouts: dict[tuple[str, str], FixedLayout | None] = field(default_factory=dict)
    _types: Typestore = field(default_factory=lambda: get_typestore(Stores.EMPTY))

    def __post_init__(self) -> None:
        whole, part = split_location(self.path)
        files, self.notes = mcap_files(whole)
        self.scans = [McapScan(path, skip_damaged=self.skip_damaged) for path in files]
        with suppress(RecordingError):  # in the order of their first messages, if the index of each file has it
            first_times = {scan.path: scan.times()[0] for scan in self.scans} if len(files) > 1 else {}
            if all(first_times.values()):
                self.scans.sort(key=lambda scan: first_times.get(scan.path, 0))
        if part is not None:
            first = self.scans[0].times()[0]
            for scan in self.scans:
                scan.interval = (first + 1e9 * part[0], first + 1e9 * part[1])

    def spans(self, topic: str | None = None) -> Iterator[tuple[McapScan, Channel, bytes, Span]]:
        """Yield each channel's messages in each block of each file.

        `topic`: only those of this topic. Raises RecordingError: the recording is damaged, or has none of this topic.
        """
        found = False
        for scan in self.scans:
            for block, spans in scan.blocks():
                for number, span in spans.items():
                    if number not in scan.channels:
                        raise RecordingError(f"{scan.path} has messages on a channel that it does not declare")
                    if topic in (None, scan.channels[number].topic):
                        found = True
                        yield scan, scan.channels[number], block, span
            if scan.damaged:
                self.notes.append(f"{scan.path.name} is damaged: {scan.damaged} of its blocks could not be read")
            elif not scan.finished:
                told = "was not finished (its recorder was killed?): read up to where it ends"
                self.notes.append(f"{scan.path.name} {told}")
        if topic is not None and not found:
            there = {channel.topic for scan in self.scans for channel in scan.channels.values()}
            raise self.missing_topic_error(topic, there)

    def missing_topic_error(self, topic: str, topics: Collection[str]) -> RecordingError:
        """Return the error that `topic` is not among the `topics` that were read."""
        there = f"there is {', '.join(sorted(topics)) or 'nothing'}"
        if damaged := sum(scan.damaged for scan in self.scans):
            there = f"{damaged} of its blocks are damaged"
        if not topics and not all(scan.finished for scan in self.scans):
            there = "it was cut off before the end of its first block: copy it again"
        elif any(scan.interval for scan in self.scans):
            there = "the part ends before it begins, or begins after it has ended"
        return RecordingError(f"{self.path} has no messages on {topic}; {there}")

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
        """Return the layout of a channel's type, None if not all fields are numeric; raises RecordingError."""
        name, text = self.type_of(scan, channel)
        if (name, text) not in self._layouts:
            try:
                self._layouts[name, text] = fixed_layout(name, text)
            except NotFixedError:
                self._layouts[name, text] = None
            except Exception as error:
                raise RecordingError(f"{scan.path}: the definition of {name} cannot be read: {error}") from None
        return self._layouts[name, text]

    def messages(self, scan: McapScan, channel: Channel, block: bytes, span: Span) -> Iterator[tuple[float, Any]]:
        """Yield log time [s] and message object of one channel of any type in one block; raises RecordingError.

        A type's definition is that of its first channel.
        """
        name, text = self.type_of(scan, channel)
        if name not in self._types.types:
            types = get_types_from_msg(text, name)
            self._types.register({kind: types[kind] for kind in types.keys() - self._types.types.keys()})
        places = zip(span.starts.tolist(), span.sizes.tolist(), span.log_times.tolist(), strict=True)
        for start, size, time_ns in places:
            yield 1e-9 * time_ns, self._types.deserialize_cdr(block[start : start + size], name)


def decode_span(path: Path, topic: str, layout: FixedLayout, block: bytes, span: Span) -> TopicTable:
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
