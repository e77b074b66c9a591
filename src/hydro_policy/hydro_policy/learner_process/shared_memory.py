# SPDX-License-Identifier: Apache-2.0
"""Lock-free publication of a blob in shared memory: the actor never waits for the learner.

header   int64 version | 2 slots of [int64 length | int64 CRC-32 | bytes]
publish  write into slot (version + 1) mod 2, then count the version up
read     copy slot version mod 2; if the CRC does not match, a writer overtook the reader or died halfway: no new value
"""

from __future__ import annotations

import zlib

import numpy as np

_HEADER = 64
_SLOT_HEADER = 16


class SharedBlob:
    """Latest-value exchange of at most `capacity` bytes over a shared buffer (one writer, any number of readers).

    Parameters
    ----------
    memory
        Writable buffer of `memory_size(capacity)` bytes, zero at first, mapped by all sides.
    """

    def __init__(self, memory: object) -> None:
        self._bytes = np.frombuffer(memory, np.uint8)  # type: ignore[call-overload]
        self._version = self._bytes[:8].view(np.int64)
        self.capacity = (len(self._bytes) - _HEADER) // 2 - _SLOT_HEADER
        self._seen = 0

    @staticmethod
    def memory_size(capacity: int) -> int:
        """Return the bytes needed for blobs of up to `capacity` bytes (rounded up to a multiple of eight)."""
        return _HEADER + 2 * (_SLOT_HEADER + (capacity + 7) // 8 * 8)

    def publish(self, blob: bytes) -> None:
        """Make `blob` the latest value.

        Raises
        ------
        ValueError
            `blob` is longer than the capacity.
        """
        if len(blob) > self.capacity:
            raise ValueError(f"{len(blob)} bytes do not fit the {self.capacity} shared ones")
        version = int(self._version[0]) + 1
        slot = self._slot(version)
        slot[:_SLOT_HEADER].view(np.int64)[:] = len(blob), zlib.crc32(blob)
        slot[_SLOT_HEADER : _SLOT_HEADER + len(blob)] = np.frombuffer(blob, np.uint8)
        self._version[0] = version

    def read(self) -> bytes | None:
        """Return the latest value if it is newer than the last one read here, else None."""
        version = int(self._version[0])
        if version == self._seen:
            return None
        blob = self._copy(version)
        if blob is not None:
            self._seen = version
        return blob

    def latest(self) -> bytes | None:
        """Return the latest complete value, read before or not; None if there never was one."""
        version = int(self._version[0])
        for candidate in range(version, max(version - 2, 0), -1):  # a writer killed halfway leaves the other slot whole
            blob = self._copy(candidate)
            if blob is not None:
                return blob
        return None

    def _slot(self, version: int) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
        size = _SLOT_HEADER + self.capacity
        start = _HEADER + (version % 2) * size
        return self._bytes[start : start + size]

    def _copy(self, version: int) -> bytes | None:
        slot = self._slot(version)
        length, checksum = (int(v) for v in slot[:_SLOT_HEADER].view(np.int64))
        blob = slot[_SLOT_HEADER : _SLOT_HEADER + min(max(length, 0), self.capacity)].tobytes()
        return blob if length > 0 and zlib.crc32(blob) == checksum else None
