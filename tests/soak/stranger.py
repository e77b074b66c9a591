# SPDX-License-Identifier: Apache-2.0
"""A stranger on one way of the serial line: what passes, and what he sends besides."""

from __future__ import annotations

import contextlib
import os
from collections import deque
from random import Random

from hydro_bridge.serial.protocol import CommandFrame, State
from tests.fuzz_link import DAMAGES

_DAMAGES = tuple(damage for damage, whole in DAMAGES.values() if not whole)
_KEPT = 500  # frames that may be sent again: fewer than the host remembers as seen


class Direction:
    """One way of the line: frames that passed, and what a stranger makes of them.

    What is hostile is noise, damaged frames, frames of another version, and frames that have passed already. A HELLO is
    never sent again: that opens a conversation again, and the wire has no key (network.md).
    """

    def __init__(self, random: Random) -> None:
        self.frames = self.hostile = 0
        self.unwritten = b""
        self._random, self._rest = random, b""
        self._passed: deque[bytes] = deque(maxlen=_KEPT)
        self._owed = 0.0

    def whole(self, data: bytes) -> list[bytes]:
        """Frames that end within `data`, without delimiters."""
        *pieces, self._rest = (self._rest + data).split(b"\0")
        return [piece for piece in pieces if piece]

    def let_pass(self, piece: bytes, frame: object) -> None:
        """Send it on; what is no greeting may be sent again later."""
        wire = b"\0" + piece + b"\0"
        self.frames += 1
        self.unwritten += wire
        if isinstance(frame, State | CommandFrame):
            self._passed.append(wire)

    def disturb(self, size: float) -> None:
        """Send `size` hostile bytes, on average."""
        self._owed += size
        while self._owed > 0.0:
            chunk = self._chunk()
            self._owed -= max(len(chunk), 1)
            self.hostile += len(chunk)
            self.unwritten += chunk

    def replay(self, count: int) -> None:
        """Send frames again that have passed, in their order."""
        self.unwritten += b"".join(list(self._passed)[-count:])

    def write(self, descriptor: int) -> None:
        """Write what fits; a line that nobody reads loses what does not."""
        with contextlib.suppress(BlockingIOError):
            self.unwritten = self.unwritten[os.write(descriptor, self.unwritten) :]
        self.unwritten = self.unwritten[-65536:]

    def _chunk(self) -> bytes:
        chance = self._random.random()
        if chance < 0.3 or not self._passed:
            return self._random.randbytes(self._random.randint(1, 64))
        wire = self._random.choice(self._passed)
        return wire if chance < 0.5 else self._random.choice(_DAMAGES)(wire, self._random)
