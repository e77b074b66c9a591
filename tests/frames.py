# SPDX-License-Identifier: Apache-2.0
"""Frames of the serial line that were damaged on their way, or come from a foreign sender."""

from __future__ import annotations

from binascii import crc32
from collections.abc import Mapping
from random import Random

from cobs import cobs


def flip(wire: bytes, random: Random) -> bytes:
    """One to eight bits turned over anywhere, delimiters included."""
    damaged = bytearray(wire)
    for _ in range(random.randint(1, 8)):
        damaged[random.randrange(len(damaged))] ^= 1 << random.randrange(8)
    return bytes(damaged)


def splice(wire: bytes, random: Random) -> bytes:
    """Bytes missing, too many, or others in their place: anywhere, at most up to the end."""
    begin = random.randrange(len(wire))
    end = min(begin + random.choice((0, 1, 8, len(wire))), len(wire))
    return wire[:begin] + random.randbytes(random.choice((0, 8, end - begin))) + wire[end:]


def seal_anew(wire: bytes, random: Random) -> bytes:
    """Another version, type or length, with a check sum that holds: a foreign or a broken sender."""
    byte = random.randrange(4, 256)
    return altered(wire, {random.choice((0, 1)): byte}, random.randbytes(random.choice((0, 0, 1, 40))))


def altered(wire: bytes, bytes_at: Mapping[int, int], more: bytes = b"") -> bytes:
    """The frame with other bytes at some places of its body, and `more` behind it: its check sum holds."""
    body = bytearray(cobs.decode(wire[1:-1])[:-4])
    for place, byte in bytes_at.items():
        body[place] = byte
    return sealed(bytes(body) + more)


def sealed(body: bytes) -> bytes:
    """A frame of this body, with its check sum."""
    return b"\0" + cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


DAMAGES = (flip, splice, seal_anew)
