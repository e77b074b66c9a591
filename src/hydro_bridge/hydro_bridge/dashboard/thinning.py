# SPDX-License-Identifier: Apache-2.0
"""Series thinned to what a screen shows: the least and the greatest value of each slot of 10 ms.

A pulse of one sample stays visible, and memory is that of the ring::

    ring, shape (kept, columns, 2):   slot n stands in row n % kept;   [..., 0] least, [..., 1] greatest, NaN: no sample
    n = floor(time / SLOT)            ... | closed | closed | open |    the open slot is still filled, and not yet shown
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray

SLOT = 0.01
"""s; 1000 of them are the 10 s of a page, about as many as a plot has pixels."""
KEPT = 6000
"""Slots that are kept for a viewer who comes later: 60 s."""

_AXES = 3


@dataclass(frozen=True)
class Slots:
    """Closed slots, one after the other."""

    first: int
    """Number of the first one: floor(time / SLOT)."""
    values: npt.NDArray[np.float32]
    """Least and greatest value, shape (slots, columns, 2)."""

    def encoded(self, series: int) -> bytes:
        """For the page: u32 series, u32 columns, f64 first, then float32 values, all little endian."""
        assert self.values.ndim == _AXES
        head = np.array([series, self.values.shape[1]], "<u4").tobytes() + np.array([self.first], "<f8").tobytes()
        return head + np.ascontiguousarray(self.values, "<f4").tobytes()


class Thinner:
    """Thins one stream of samples.

    Parameters
    ----------
    columns
        Numbers in a sample.
    kept
        Slots in the ring.
    """

    def __init__(self, columns: int, kept: int = KEPT) -> None:
        self._ring = np.full((kept, columns, 2), np.nan, np.float32)
        self._begin = self._taken = self._open = 0

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Enter samples.

        Samples older than the open slot are left out; where time falls back by more than the ring, as behind a clock
        that was set, the series begins anew.

        Parameters
        ----------
        times
            s, shape (n,), not falling.
        values
            Shape (n, columns). What is not finite counts as no sample.
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
        """Slots that have closed since the last call."""
        slots = self._between(self._taken, self._open)
        self._taken = self._open
        return slots

    def history(self) -> Slots:
        """All slots that were taken and are still in the ring: what a new viewer gets before the next `take`."""
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
