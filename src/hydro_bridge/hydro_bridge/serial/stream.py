# SPDX-License-Identifier: Apache-2.0
"""Stream decoder from bytes to frames. Damaged bytes are counted and never raise.

`Decoder` cuts the stream at the delimiters and checks each piece; `SequenceTracker` separates new samples from repeated
and late ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hydro_bridge.serial import protocol

_SEQUENCE_MODULUS = 1 << 32


@dataclass(kw_only=True)
class LinkCounts:
    """Counters of bytes, frames and errors since the line was first opened."""

    bytes: int = 0
    frames: int = 0
    """Accepted frames of all types."""
    crc_errors: int = 0
    """Pieces between delimiters with a wrong check sum."""
    malformed: int = 0
    """Pieces that are not frames for another reason: broken COBS, overlong, wrong length or content."""
    resyncs: int = 0
    """Number of resynchronisations: valid frames after damaged pieces."""
    unknown: int = 0
    """Valid frames of an unknown type."""
    wrong_version: int = 0
    """Valid frames of another protocol version."""
    lost: int = 0
    """Sequence numbers never delivered, late ones included."""
    duplicates: int = 0
    reordered: int = 0
    """Frames received after a later one; not delivered."""
    restarts: int = 0
    """Restarts of the box, from large jumps of its sequence number."""


def no_frames_message(counts: LinkCounts, before: LinkCounts, seconds: float) -> str:
    """Return an error message on the bytes received in `seconds` without a frame, from two counts."""
    size, crc, malformed, version, unknown = (
        getattr(counts, name) - getattr(before, name)
        for name in ("bytes", "crc_errors", "malformed", "wrong_version", "unknown")
    )
    if not size:
        return f"no byte came for {seconds:g} s: is the box on, and is this its port?"
    return (
        f"{size} bytes came and no frame in them for {seconds:g} s: {crc} pieces with a wrong CRC, {malformed} "
        f"malformed, {version} of a version and {unknown} of a type not known here: are port, bit rate and CRC right?"
    )


@dataclass
class Decoder:
    """Splits bytes into frames, in bounded memory: at most `protocol.ENCODED_SIZE_MAX` bytes stay without a delimiter.

    Bytes before the first delimiter belong to a frame cut off when the port was opened: discarded without an error.
    """

    counts: LinkCounts = field(default_factory=LinkCounts)
    foreign_version: int | None = None
    """Version of the last frame with a wrong one, for the log."""
    _pending: bytes = b""
    _overlong: bool = False
    _in_sync: bool = True
    _opening: bool = True

    def feed(self, data: bytes) -> list[protocol.Frame]:
        """Return the frames that end within `data`, in order; chunk borders may fall anywhere."""
        self.counts.bytes += len(data)
        *pieces, self._pending = (self._pending + data).split(b"\0")
        if pieces and (self._overlong or self._opening):
            pieces[0], self._overlong, self._opening = b"", False, False
        if len(self._pending) > protocol.ENCODED_SIZE_MAX:
            if not self._overlong:
                self._bad(crc=False)
            self._pending, self._overlong = b"", True
        return [frame for piece in pieces if piece and (frame := self._check(piece)) is not None]

    def reset(self) -> None:
        """Discard the partial frame, after the port was reopened; counts are kept."""
        self._pending, self._overlong, self._in_sync, self._opening = b"", False, True, True

    def _check(self, piece: bytes) -> protocol.Frame | None:
        try:
            frame = protocol.decode(piece)
        except protocol.UnknownFrameError:
            self.counts.unknown += 1
        except protocol.WrongVersionError as error:
            self.counts.wrong_version += 1
            self.foreign_version = error.version
        except protocol.MalformedError as error:
            self._bad(crc=isinstance(error, protocol.CheckSumError))
        else:
            self.counts.frames += 1
            self.counts.resyncs += not self._in_sync
            self._in_sync = True
            return frame
        return None

    def _bad(self, *, crc: bool) -> None:
        self.counts.crc_errors += crc
        self.counts.malformed += not crc
        self._in_sync = False


@dataclass
class SequenceTracker:
    """Detects new, repeated, late and missing sequence numbers, and restarts of the sender.

    A number up to `window` behind the newest is a duplicate or late; one further behind, or more than `leap` ahead,
    means that the sender was restarted.
    """

    counts: LinkCounts = field(default_factory=LinkCounts)
    window: int = 1024
    leap: int = 600_000
    _newest: int | None = None
    _seen: int = 0
    """Bit n: newest - n was received."""

    def accept(self, sequence: int) -> bool:
        """Count the frame with this sequence number and return whether to deliver it."""
        if self._newest is None:
            self._newest, self._seen = sequence, 1
            return True
        ahead = (sequence - self._newest) % _SEQUENCE_MODULUS
        if ahead == 0 or ahead >= _SEQUENCE_MODULUS - self.window:
            seen = self._seen >> (behind := -ahead % _SEQUENCE_MODULUS) & 1
            self.counts.duplicates += seen
            self.counts.reordered += not seen
            self._seen |= 1 << behind
            return False
        if ahead > self.leap:
            self.counts.restarts += 1
            self._newest, self._seen = sequence, 1
            return True
        self.counts.lost += ahead - 1
        self._seen = (self._seen << ahead | 1) & ((1 << self.window) - 1) if ahead < self.window else 1
        self._newest = sequence
        return True
