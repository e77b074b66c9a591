# SPDX-License-Identifier: Apache-2.0
"""Definitions of the graph's messages, and the vectorised conversion between serialized messages (CDR) and arrays.

A message of numbers only, with at most a leading header, has a fixed byte layout once the length of `header.frame_id`
is known. A thousand of them are therefore one numpy view, not a thousand Python objects::

    00 01 00 00 | sec i4 | nanosec u4 | length u4 | frame_id ... NUL, padding | numbers, each aligned to its size
    CDR, little   0        4            8           12

Offsets are counted from the end of the first four bytes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rosbags.typesys import get_types_from_msg

from hydro_core.signals import StateArray

STATE_TOPIC, STATE_TYPE = "/hydro/state", "hydro_msgs/msg/BenchState"
ByteRows = npt.NDArray[np.uint8]
"""Serialized messages of equal length, shape (n, bytes)."""
SCHEMA_FILE = Path(__file__).with_name("schemas.json")
"""Definitions by type; `python -m tests.schemas` renews them from the installed messages."""

_NUMBER_FORMATS = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4",
    "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_SECONDS, _NANOSECONDS, _SIZE, _FRAME_ID = ("header.sec", "header.nanosec", "header.size", "header.frame_id")


class NotFixedError(ValueError):
    """The type has strings, sequences or nested types beyond a header, so it has no fixed table layout."""


@cache
def definition(type_name: str) -> dict[str, str]:
    """Return `text` (ros2msg) and `type_hash` (RIHS01) of `package/msg/Type`; raises KeyError for one not recorded."""
    known: dict[str, str] = json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))[type_name]
    return known


@dataclass(frozen=True, kw_only=True)
class FixedLayout:
    """Layout of one message type, in bytes and as a table."""

    fields: tuple[tuple[str, str], ...]
    """Name and numpy code of each number, in message order, without the header."""
    has_header: bool

    @property
    def table(self) -> np.dtype[np.void]:
        """Record type of the table: `time` in s (header stamp, or log time without a header), then the fields."""
        return np.dtype([("time", "f8"), *self.fields], align=True)

    def wire(self, frame_id_size: int) -> tuple[np.dtype[np.void], int]:
        """Return the type of a message behind its first four bytes, and its size; `frame_id_size` includes the NUL."""
        head = [(_SECONDS, "<i4"), (_NANOSECONDS, "<u4"), (_SIZE, "<u4"), (_FRAME_ID, f"S{frame_id_size}")]
        wire = np.dtype(
            [*(head if self.has_header else []), *((name, "<" + code) for name, code in self.fields)], align=True
        )
        return wire, max((kind.itemsize + offset for kind, offset, *_ in (wire.fields or {}).values()), default=0)

    def decode(self, rows: ByteRows, log_times: npt.NDArray[np.int64]) -> npt.NDArray[np.void]:
        """Decode serialized messages into a table.

        `rows`: shape (n, bytes). `log_times`: ns, shape (n,); used if the type has no header. Raises ValueError: the
        bytes are not plain CDR, little endian, of this type.
        """
        if rows.shape[1] < (16 if self.has_header else 4) or (rows[:, :2] != (0, 1)).any():
            raise ValueError("not plain CDR, little endian")
        out, sizes = np.empty(len(rows), self.table), np.zeros(len(rows), np.uint32)
        if self.has_header:
            sizes[:] = np.ascontiguousarray(rows[:, 12:16]).view("<u4")[:, 0]
        for size in np.unique(sizes):  # nearly always one
            (wire, used), part = self.wire(int(size)), sizes == size
            if rows.shape[1] < used + 4:
                raise ValueError(f"{rows.shape[1]} bytes in a message, expected {used + 4}")
            padded = np.zeros((np.count_nonzero(part), wire.itemsize), np.uint8)
            padded[:, :used] = rows[part, 4 : used + 4]
            values = padded.view(wire)[:, 0]
            for name, _ in self.fields:
                out[name][part] = values[name]
            stamps = values[_SECONDS] + 1e-9 * values[_NANOSECONDS] if self.has_header else 1e-9 * log_times[part]
            out["time"][part] = stamps
        return out


@cache
def fixed_layout(type_name: str, text: str | None = None) -> FixedLayout:
    """Return the layout of a type from its ros2msg text, by default that of its known definition.

    Raises NotFixedError: the type is not numbers only with at most a leading header.
    """
    _, members = get_types_from_msg(text or definition(type_name)["text"], type_name)[type_name]
    has_header = bool(members) and members[0][0] == "header" and members[0][1][1] == "std_msgs/msg/Header"
    fields = []
    for name, (_, kind) in members[has_header:]:
        if not isinstance(kind, tuple) or kind[0] not in _NUMBER_FORMATS:
            raise NotFixedError(f"{type_name}.{name} is not a number")
        fields.append((name, _NUMBER_FORMATS[str(kind[0])]))
    return FixedLayout(fields=tuple(fields), has_header=has_header)


def encode_states(states: StateArray, frame_id: str = "bench") -> ByteRows:
    """Encode `STATE_DTYPE` records as serialized BenchState messages, little endian, shape (n, bytes)."""
    layout, text = fixed_layout(STATE_TYPE), frame_id.encode()
    wire, used = layout.wire(len(text) + 1)
    values, seconds = np.zeros(len(states), wire), np.floor(states["time"])
    values[_SECONDS], values[_SIZE], values[_FRAME_ID] = seconds, len(text) + 1, text
    values[_NANOSECONDS] = np.minimum(np.rint((states["time"] - seconds) * 1e9), 999_999_999)
    for name, _ in layout.fields:
        values[name] = states[name]
    rows = np.zeros((len(states), used + 4), np.uint8)
    rows[:, 1] = 1
    rows[:, 4:] = values.view(np.uint8).reshape(len(states), wire.itemsize)[:, :used]
    return rows
