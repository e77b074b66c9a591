# SPDX-License-Identifier: Apache-2.0
"""Damaged frames that no box may accept, made from a valid COMMAND."""

from __future__ import annotations

import struct
from zlib import crc32

from cobs import cobs

_TIME, _WAVEFORM, _VERSION, _TYPE = 8, 34, 0, 1
"""Byte offsets in a frame's body."""
_CHANGED = {"waveform 4": (_WAVEFORM, 4), "version 9": (_VERSION, 9), "type 200": (_TYPE, 200)}
"""Offset and value of each change; the types from 200 are free for experiments."""


def damaged(frame: bytes, how: str) -> bytes:
    """Return the frame damaged by `how`: `bit flipped`, `truncated`, `too long`, `too short`, or one of `_CHANGED`.

    All but the first two have a valid check sum. Raises KeyError for an unknown kind of damage.
    """
    if how == "truncated":
        return frame[:-9] + b"\0"
    body = bytearray(cobs.decode(frame[1:-1])[:-4])
    if how == "bit flipped":
        check = crc32(body)
        body[_TIME] ^= 0x10
        return _wrapped(bytes(body), check)
    if how == "too long":
        body.append(1)
    elif how == "too short":
        del body[-4:]
    else:
        place, value = _CHANGED[how]
        body[place] = value
    return sealed(bytes(body))


def sealed(body: bytes) -> bytes:
    """Return a frame around any body, with a valid check sum."""
    return _wrapped(body, crc32(body))


def _wrapped(body: bytes, check: int) -> bytes:
    stuffed: bytes = cobs.encode(body + struct.pack("<I", check))
    return b"\0" + stuffed + b"\0"
