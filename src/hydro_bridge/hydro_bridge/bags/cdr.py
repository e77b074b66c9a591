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
_FRAME_ID_OFFSET = 16  # of its characters, the first four bytes included


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

    def wire(self, frame_id_size: int) -> np.dtype[np.void]:
        """Record type of the serialized message; `frame_id_size` includes the NUL."""
        names, formats, offsets, place = list[str](), list[str](), list[int](), 0
        if self.has_header:
            names, formats, offsets = ["sec", "nanosec"], ["<i4", "<u4"], [4, 8]
            place = _FRAME_ID_OFFSET - 4 + frame_id_size
        for name, code in self.fields:
            size = np.dtype(code).itemsize
            place = -(-place // size) * size
            names.append(name)
            formats.append("<" + code)
            offsets.append(place + 4)
            place += size
        spec = {"names": names, "formats": formats, "offsets": offsets, "itemsize": place + 4}
        return np.dtype(spec)  # type: ignore[call-overload]

    def decode(self, rows: ByteRows, log_times: npt.NDArray[np.int64]) -> npt.NDArray[np.void]:
        """Decode serialized messages into a table.

        `rows`: shape (n, bytes). `log_times`: ns, shape (n,); used if the type has no header. Raises ValueError: the
        bytes are not plain CDR, little endian, of this type.
        """
        if rows.shape[1] < (_FRAME_ID_OFFSET if self.has_header else 4) or (rows[:, :2] != (0, 1)).any():
            raise ValueError("not plain CDR, little endian")
        out, sizes = np.empty(len(rows), self.table), np.zeros(len(rows), np.uint32)
        if self.has_header:
            sizes[:] = np.ascontiguousarray(rows[:, 12:_FRAME_ID_OFFSET]).view("<u4")[:, 0]
        for size in np.unique(sizes):  # nearly always one
            wire, part = self.wire(int(size)), sizes == size
            if rows.shape[1] < wire.itemsize:
                raise ValueError(f"{rows.shape[1]} bytes in a message, expected {wire.itemsize}")
            values = np.ascontiguousarray(rows[part, : wire.itemsize]).view(wire)[:, 0]
            for name, _ in self.fields:
                out[name][part] = values[name]
            out["time"][part] = values["sec"] + 1e-9 * values["nanosec"] if self.has_header else 1e-9 * log_times[part]
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
    layout, text = fixed_layout(STATE_TYPE), frame_id.encode() + b"\0"
    wire = layout.wire(len(text))
    values = np.zeros(len(states), wire)
    seconds = np.floor(states["time"])
    values["sec"] = seconds
    values["nanosec"] = np.minimum(np.rint((states["time"] - seconds) * 1e9), 999_999_999)
    for name, _ in layout.fields:
        values[name] = states[name]
    rows = values.view(np.uint8).reshape(len(states), wire.itemsize)
    rows[:, 1] = 1
    rows[:, 12:_FRAME_ID_OFFSET] = np.frombuffer(np.uint32(len(text)).tobytes(), np.uint8)
    rows[:, _FRAME_ID_OFFSET : _FRAME_ID_OFFSET + len(text)] = np.frombuffer(text, np.uint8)
    return rows
