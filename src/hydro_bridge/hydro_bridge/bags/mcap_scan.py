# SPDX-License-Identifier: Apache-2.0
"""Single pass over an .mcap file, finished or not: its checked blocks of messages in file order.

It needs neither index nor summary, so a recording whose recorder was killed is read by the same code as any other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from hydro_bridge.bags.types import RecordingError

_MAGIC = b"\x89MCAP0\r\n"
_RECORD = Struct("<BQ")
_MESSAGE = Struct("<HIQQ")
_LOOSE = 1 << 20  # bytes of messages outside chunks that are handed on together


@dataclass(frozen=True, kw_only=True)
class Span:
    """Location of one channel's messages in a block."""

    starts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    log_times: npt.NDArray[np.int64]
    """ns."""


@dataclass
class McapScan:
    """Contents of the file; filled in while `blocks` runs."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    finished: bool = False
    """Whether the end of the file was reached as its writer meant it."""

    def blocks(self) -> Iterator[tuple[bytes, dict[int, Span]]]:
        """Yield the bytes of each block and the location of each channel's messages in it.

        Raises
        ------
        RecordingError
            Not an MCAP file, or a damaged chunk. A truncated file raises nothing: `finished` stays False.
        """
        try:
            stream = self.path.open("rb")
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be read: {error.strerror}") from None
        with stream:
            if stream.read(len(_MAGIC)) != _MAGIC:
                empty = "is empty" if self.path.stat().st_size == 0 else "is no MCAP file"
                raise RecordingError(f"{self.path} {empty}")
            for block in self._raw_blocks(stream):
                yield block, self._split(block)

    def _raw_blocks(self, stream: BinaryIO) -> Iterator[bytes]:
        loose = bytearray()
        size = self.path.stat().st_size
        while len(head := stream.read(_RECORD.size)) == _RECORD.size:
            opcode, length = _RECORD.unpack(head)
            if opcode == 0 or stream.tell() + length > size:
                break  # cut off here
            if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                loose += head + stream.read(length)
            elif opcode == Opcode.CHUNK:
                yield self._chunk(stream.read(length), stream.tell() - length)
            elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
                self._note(opcode, stream.read(length))
            elif opcode == Opcode.DATA_END:
                self.finished = True
                break
            else:
                stream.seek(length, 1)
            if len(loose) > _LOOSE:
                yield bytes(loose)
                loose.clear()
        if loose:
            yield bytes(loose)

    def _chunk(self, body: bytes, place: int) -> bytes:
        try:
            stream, size = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(body))), validate_crc=True)
        except CRCValidationError:
            raise RecordingError(
                f"{self.path} is damaged: the check sum of the chunk at byte {place} does not hold"
            ) from None
        except Exception as error:
            raise RecordingError(
                f"{self.path} is damaged: the chunk at byte {place} cannot be unpacked: {error}"
            ) from None
        return stream.read(size)

    def _note(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.METADATA:
            record = Metadata.read(stream)
            self.metadata[record.name] = record.metadata
        else:
            attachment = Attachment.read(stream)
            self.attachments[attachment.name] = attachment.data

    def _split(self, block: bytes) -> dict[int, Span]:
        places: dict[int, list[tuple[int, int, int]]] = {}
        place, end = 0, len(block)
        record, message, kind = (_RECORD.unpack_from, _MESSAGE.unpack_from, int(Opcode.MESSAGE))
        while place + _RECORD.size <= end:
            opcode, length = record(block, place)
            place += _RECORD.size
            if opcode == kind:
                channel, _, log_time, _ = message(block, place)
                entry = (place + _MESSAGE.size, length - _MESSAGE.size, log_time)
                if channel in places:
                    places[channel].append(entry)
                else:
                    places[channel] = [entry]
            else:
                self._declare(opcode, block[place : place + length])
            place += length
        return {channel: _span(entries) for channel, entries in places.items()}

    def _declare(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            self.channels[channel.id] = channel


def _span(entries: list[tuple[int, int, int]]) -> Span:
    columns = np.array(entries, np.int64)
    return Span(starts=columns[:, 0], sizes=columns[:, 1], log_times=columns[:, 2])
