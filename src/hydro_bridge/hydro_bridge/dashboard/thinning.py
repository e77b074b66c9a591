# SPDX-License-Identifier: Apache-2.0
"""Thinning of series to screen resolution: minimum and maximum of each 10 ms slot.

A pulse of one sample stays visible, and memory is bounded by the ring::

    ring, shape (kept, columns, 2):   slot n is row n % kept;   [..., 0] minimum, [..., 1] maximum, NaN: no sample
    n = floor(time / SLOT)            ... | closed | closed | open |    the open slot is still filling, not yet shown
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray

SLOT = 0.01
"""s; a page of 10 s has 1000 slots, about one per pixel of a plot."""
KEPT = 6000
"""Slots kept for viewers that connect later: 60 s."""

_AXES = 3


@dataclass(frozen=True)
class Slots:
    """Consecutive closed slots."""

    first: int
    """Number of the first one: floor(time / SLOT)."""
    values: npt.NDArray[np.float32]
    """Minimum and maximum, shape (slots, columns, 2)."""

    def encoded(self, series: int) -> bytes:
        """Return the bytes for the page: u32 series, u32 columns, f64 first, float32 values, all little endian."""
        assert self.values.ndim == _AXES
        head = np.array([series, self.values.shape[1]], "<u4").tobytes() + np.array([self.first], "<f8").tobytes()
        return head + np.ascontiguousarray(self.values, "<f4").tobytes()


class Thinner:
    """Thins one stream of samples.

    Parameters
    ----------
    columns
        Number of values in a sample.
    kept
        Slots in the ring.
    """

    def __init__(self, columns: int, kept: int = KEPT) -> None:
        self._ring = np.full((kept, columns, 2), np.nan, np.float32)
        self._begin = self._taken = self._open = 0

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples.

        Samples older than the open slot are skipped; if time falls back by more than the ring, as after the clock was
        set, the series is restarted.

        Parameters
        ----------
        times
            s, shape (n,), not falling.
        values
            Shape (n, columns). Non-finite values count as missing.
        """
        if not len(times):
            return
        slots = np.floor(times / SLOT).astype(np.int64)
        kept = len(self._ring)
        if not self._open or abs(int(slots[-1]) - self._open) >= kept:
            self._restart(max(int(slots[0]), int(slots[-1]) - kept + 1))
        good = slots >= self._open
        slots, values = slots[good], values[good]
        if not len(slots):
            return
        self._open_until(int(slots[-1]))
        rows, starts = np.unique(slots, return_index=True)
        finite = np.where(np.isfinite(values), values, np.nan)
        place = rows % kept
        ring = self._ring
        ring[place, :, 0] = np.fmin(ring[place, :, 0], np.fmin.reduceat(finite, starts, axis=0))
        ring[place, :, 1] = np.fmax(ring[place, :, 1], np.fmax.reduceat(finite, starts, axis=0))

    def take(self) -> Slots:
        """Return the slots closed since the last call."""
        slots = self._between(self._taken, self._open)
        self._taken = self._open
        return slots

    def history(self) -> Slots:
        """Return all taken slots that are still in the ring, which a new viewer gets before the next `take`."""
        return self._between(max(self._begin, self._open - len(self._ring) + 1), self._taken)

    def _restart(self, slot: int) -> None:
        self._ring[:] = np.nan
        self._begin = self._taken = self._open = slot

    def _open_until(self, slot: int) -> None:
        new = np.arange(self._open + 1, slot + 1)[-len(self._ring) :]
        self._ring[new % len(self._ring)] = np.nan
        self._open = slot
        self._taken = max(self._taken, slot - len(self._ring) + 1)

    def _between(self, first: int, end: int) -> Slots:
        rows = np.arange(first, max(first, end)) % len(self._ring)
        return Slots(first, self._ring[rows])
