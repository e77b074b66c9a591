# SPDX-License-Identifier: Apache-2.0
"""State of the emulated line's host: whether it is connected, and whether it answers each sample."""

from __future__ import annotations

import time
from struct import Struct
from zlib import crc32

from cobs import cobs

from hydro_bridge.serial.protocol import ENCODED_SIZE_MAX, HANDSHAKE_VERSION, FrameType

_HEADER = Struct("<BBIQ")
_LOCK_STEP_OFFSET = _HEADER.size + 3  # place in a HELLO
_CRC = Struct("<I")


class HostState:
    """State of the host, observed from the frames that it sends."""

    def __init__(self) -> None:
        self._pending = b""
        self.hellos = 0
        """HELLOs since the port was plugged in."""
        self.last_frame_time = 0.0
        """Time of its last frame, s of the monotonic clock."""
        self.fresh = False
        """Whether no COMMAND has come since the last HELLO."""
        self.time_us: int | None = None
        """Time in its last COMMAND, us; None: none since the last HELLO."""
        self.lock_step = False
        """Whether its HELLO announced an answer to each STATE: a COMMAND with that sample's time."""

    def reset(self) -> None:
        """Reset to no host, as the port was unplugged or closed."""
        self._pending, self.hellos, self.fresh, self.time_us, self.lock_step = b"", 0, False, None, False

    def observe(self, data: bytes) -> None:
        """Update the state by received bytes."""
        *pieces, self._pending = (self._pending + data).split(b"\0")
        self._pending = self._pending[-ENCODED_SIZE_MAX:]
        for piece in filter(None, pieces):
            try:
                raw = cobs.decode(piece)
            except cobs.DecodeError:
                continue
            if len(raw) < _HEADER.size + 4 or raw[-4:] != _CRC.pack(crc32(raw[:-4])):
                continue
            version, kind, _, time_us = _HEADER.unpack_from(raw)
            self.last_frame_time = time.monotonic()
            if kind == FrameType.HELLO and version == HANDSHAKE_VERSION:
                self.hellos, self.fresh, self.time_us = self.hellos + 1, True, None
                self.lock_step = raw[_LOCK_STEP_OFFSET : _LOCK_STEP_OFFSET + 1] == b"\1"
            elif kind == FrameType.COMMAND:
                self.fresh, self.time_us = False, time_us
