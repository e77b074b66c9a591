# SPDX-License-Identifier: Apache-2.0
"""What has been computed, up to so much memory: what was asked for longest ago goes first."""

from __future__ import annotations

from typing import Any

ROOM = 96e6
"""Bytes."""


class Columns:
    """Arrays, or sets of them, by key."""

    def __init__(self) -> None:
        self._kept: dict[tuple[object, ...], tuple[Any, int]] = {}
        self._bytes = 0

    def get(self, key: tuple[object, ...]) -> Any:
        """Return what was put under a key, None if it is not there (any more)."""
        found = self._kept.pop(key, None)
        if found is None:
            return None
        self._kept[key] = found
        return found[0]

    def put(self, key: tuple[object, ...], what: Any, size: int) -> None:
        """Keep something of a size in bytes."""
        self._kept[key] = what, size
        self._bytes += size
        while self._bytes > ROOM and len(self._kept) > 1:
            self._bytes -= self._kept.pop(next(iter(self._kept)))[1]

    def clear(self) -> None:
        """Keep nothing."""
        self._kept.clear()
        self._bytes = 0
