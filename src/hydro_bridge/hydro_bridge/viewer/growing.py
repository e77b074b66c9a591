# SPDX-License-Identifier: Apache-2.0
"""Thinning of a series of unknown length in bounded memory: minimum and maximum per slot; slots grow with the series.

::

    slots of 10 ms   | 0 | 1 | 2 | 3 | ... | limit - 1 |     full, and another sample arrives:
    slots of 20 ms   |   0   |   1   | ... |           |     pairs are merged; and so on

A pulse of one sample stays visible at every length.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.dashboard.thinning import SLOT
from hydro_bridge.signals import FloatArray

LIMIT = 2**16
"""Number of slots: 655 s at 10 ms; an hour is 5.6 times that, in slots of 80 ms."""
JUMP = 3600.0
"""s between two samples beyond which the later one's stamp is rejected."""


class GrowingThinner:
    """Thins one stream of samples from `begin` on.

    Parameters
    ----------
    columns
        Number of values in a sample.
    begin
        Start of the first slot, s.
    limit
        Number of slots kept, even.
    """

    def __init__(self, columns: int, begin: float, limit: int = LIMIT) -> None:
        self._begin, self._last = begin, begin
        self._table = np.full((limit, columns, 2), np.nan, np.float32)
        self._end = 0
        self.slot = SLOT
        """s."""
        self.left_out = 0
        """Samples before `begin`, or more than `JUMP` after all previous ones."""

    @property
    def end(self) -> float:
        """Time of the latest sample, s, on the clock of the samples."""
        return self._last

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples.

        Parameters
        ----------
        times
            s, shape (n,).
        values
            Shape (n, columns). Non-finite values count as missing.
        """
        good = (times >= self._begin) & (times < self._last + JUMP)
        self.left_out += int(len(times) - np.count_nonzero(good))
        times, values = times[good], values[good]
        if not len(times):
            return
        self._last = max(self._last, float(times.max()))
        while self._last - self._begin >= self.slot * len(self._table):
            self._merge()
        slots = np.floor((times - self._begin) / self.slot).astype(np.int64)
        order = np.argsort(slots, kind="stable")
        rows, starts = np.unique(slots[order], return_index=True)
        finite = np.where(np.isfinite(values), values, np.nan)[order]
        self._table[rows, :, 0] = np.fmin(self._table[rows, :, 0], np.fmin.reduceat(finite, starts, axis=0))
        self._table[rows, :, 1] = np.fmax(self._table[rows, :, 1], np.fmax.reduceat(finite, starts, axis=0))
        self._end = max(self._end, int(rows[-1]) + 1)

    def values(self, slot: float) -> npt.NDArray[np.float32]:
        """Return minimum and maximum in slots of `slot` s, or this series' own if longer, shape (slots, columns, 2)."""
        while self.slot < slot:
            self._merge()
        return self._table[: self._end]

    def _merge(self) -> None:
        half = len(self._table) // 2
        self._table[:half, :, 0] = np.fmin(self._table[::2, :, 0], self._table[1::2, :, 0])
        self._table[:half, :, 1] = np.fmax(self._table[::2, :, 1], self._table[1::2, :, 1])
        self._table[half:] = np.nan
        self._end = -(-self._end // 2)
        self.slot *= 2.0
