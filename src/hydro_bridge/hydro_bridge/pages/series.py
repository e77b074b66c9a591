# SPDX-License-Identifier: Apache-2.0
"""What the pages plot: columns, as minimum and maximum of each bin so that a pulse is visible; the learning curve."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_core.signals import Flag, FloatArray

PHASES = ("waiting", "training", "evaluating", "paused", "finished")
"""TrainingStatus.phase in words."""


@dataclass(frozen=True)
class Column:
    """One plotted series: a field of a message in the page's unit."""

    name: str
    field: str
    unit: str = ""
    scale: float = 1.0
    """Factor from the SI unit to the page's."""


SERIES_COLUMNS = (
    (
        Column("reference", "reference_force", "N"),
        Column("force", "load_force", "N"),
        Column("hydraulic force", "hydraulic_force", "N"),
        Column("K_p", "proportional_gain", "1/s"),
        Column("K_i", "integral_gain", "1/s²"),
        Column("current", "valve_current", "mA", 1e3),
        Column("pressure a", "pressure_a", "bar", 1e-5),
        Column("pressure b", "pressure_b", "bar", 1e-5),
        Column("position", "piston_position", "mm", 1e3),
        Column("error", "", "N"),
        Column("armed", ""),
        Column("tripped", ""),
    ),
    (
        Column("correction", "delta_u", "mA", 1e3),
        Column("without correction", "certificate_before", "1/s"),
        Column("with correction", "certificate_after", "1/s"),
    ),
    (
        Column("f_c", "compensated_reference", "N"),
        Column("a_0", "a_0", "%", 1e2),
        Column("a_1", "a_1", "ms", 1e3),
        Column("a_2", "a_2", "10⁻⁵ s²", 1e5),
        Column("a_3", "a_3", "N"),
        Column("a_4", "a_4", "10⁻⁶ s³", 1e6),
    ),
)
"""Columns of states, corrections and laws; those without a field are derived: f_r - f_l; 1 or 0; 1 or 0."""


def column_values(number: int, table: npt.NDArray[np.void]) -> FloatArray:
    """Return the columns `SERIES_COLUMNS[number]` of a message table in the page's units, shape (n, columns)."""
    values = [table[column.field] * column.scale for column in SERIES_COLUMNS[number] if column.field]
    if number == 0:
        flags, error = table["flags"], table["reference_force"] - table["load_force"]
        values += [error, (flags & Flag.ARMED) != 0, (flags & Flag.TRIPPED) != 0]
    return np.column_stack(values)


BIN_WIDTH = 0.01
"""Width of a bin [s]; a page of 10 s has 1000 bins, about one per pixel of a plot."""
HISTORY_BINS = 6000
"""Bins kept for viewers that connect later: 60 s."""
BinTable = npt.NDArray[np.float32]
"""Minimum and maximum of each bin, NaN without samples, shape (bins, columns, 2)."""


def encode_bins(series: int, first: int, bins: BinTable) -> bytes:
    """Return bins for the page: u32 series, u32 columns, f64 number of the first, float32 values, little endian."""
    head = np.array([series, bins.shape[1]], "<u4").tobytes() + np.array([first], "<f8").tobytes()
    return head + np.ascontiguousarray(bins, "<f4").tobytes()


class LiveSeries:
    """Bins of a live stream, those of the last minute; `columns`: number of values in a sample.

    Bin floor(time / BIN_WIDTH) is closed, and sent, once a later one has a sample.
    """

    def __init__(self, columns: int) -> None:
        self._ring = np.full((HISTORY_BINS, columns, 2), np.nan, np.float32)
        self._first = self._sent = self._open = 0  # numbers of the first bin, the next to send, the one that fills

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples; those of closed bins are skipped, and after a jump of the clock the series starts again.

        `times`: s, shape (n,), not falling. `values`: shape (n, columns). Non-finite values count as missing.
        """
        bins = np.floor(times / BIN_WIDTH).astype(np.int64)
        last = int(bins[-1])
        if abs(last - self._open) >= HISTORY_BINS:
            self._ring[:] = np.nan
            self._first = self._sent = self._open = max(int(bins[0]), last - HISTORY_BINS + 1)
        self._ring[np.arange(self._open + 1, last + 1) % HISTORY_BINS] = np.nan
        good = bins >= self._open
        self._open = max(self._open, last)
        _reduce_into(self._ring, bins[good] % HISTORY_BINS, values[good])

    def poll(self) -> tuple[int, BinTable]:
        """Return the bins closed since the last call, and the number of their first."""
        begin, self._sent = self._sent, self._open
        return begin, self._ring[np.arange(begin, self._sent) % HISTORY_BINS]

    def history(self) -> tuple[int, BinTable]:
        """Return the last minute up to the last `poll`, for a new viewer that gets the next bins by `poll`."""
        begin = max(self._first, self._open - HISTORY_BINS + 1)
        return begin, self._ring[np.arange(begin, self._sent) % HISTORY_BINS]


class RecordedSeries:
    """Bins of a recording of unknown length, at most `limit` (even); when they are full, pairs of bins are merged.

    `columns`: values per sample. `begin`: start of the first bin, s. 2**16 bins are 655 s of 10 ms, an hour of 80 ms.
    """

    def __init__(self, columns: int, begin: float, limit: int = 2**16) -> None:
        self._begin = self.end = begin
        """Time of the latest sample, s, on the clock of the samples."""
        self._table = np.full((limit, columns, 2), np.nan, np.float32)
        self._count = 0
        self.bin_width = BIN_WIDTH
        """Width of a bin [s]."""

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples from `begin` on; `times`: s, shape (n,). `values`: shape (n, columns), NaN: missing."""
        self.end = max(self.end, float(times.max()))
        while self.end - self._begin >= self.bin_width * len(self._table):
            self._merge()
        bins = np.floor((times - self._begin) / self.bin_width).astype(np.int64)
        order = np.argsort(bins, kind="stable")
        _reduce_into(self._table, bins[order], values[order])
        self._count = max(self._count, int(bins.max()) + 1)

    def values(self, bin_width: float) -> BinTable:
        """Return the bins of `bin_width` s, or this series' longer ones."""
        while self.bin_width < bin_width:
            self._merge()
        return self._table[: self._count]

    def _merge(self) -> None:
        half = len(self._table) // 2
        self._table[:half, :, 0] = np.fmin(self._table[::2, :, 0], self._table[1::2, :, 0])
        self._table[:half, :, 1] = np.fmax(self._table[::2, :, 1], self._table[1::2, :, 1])
        self._table[half:] = np.nan
        self._count = -(-self._count // 2)
        self.bin_width *= 2.0


def _reduce_into(table: BinTable, rows: npt.NDArray[np.int64], values: FloatArray) -> None:
    """Extend minimum and maximum of the table's rows by the values of samples, of which those of a row are adjacent."""
    starts = np.flatnonzero(np.diff(rows, prepend=-1))
    if len(starts):
        rows, finite = rows[starts], np.where(np.isfinite(values), values, np.nan)
        table[rows, :, 0] = np.fmin(table[rows, :, 0], np.fmin.reduceat(finite, starts, axis=0))
        table[rows, :, 1] = np.fmax(table[rows, :, 1], np.fmax.reduceat(finite, starts, axis=0))


class LearningCurve:
    """Learning curve: results of the finished episodes, at most 1000; beyond that every second one is dropped."""

    KEYS = ("episode", "rmse", "return", "critic_loss", "actor_loss")

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []
        self._last = 0
        self._result: tuple[float, ...] = ()

    def add(self, status: Any) -> None:
        """Add a TrainingStatus, as a message or the row of a table.

        Changed results are those of a further episode; `episode` is the present one in training, else the last one. A
        smaller episode number starts another run.
        """
        if status.episode < self._last:
            self._rows.clear()
        before, self._last, self._result = self._result, status.episode, (status.force_rmse, status.episode_return)
        if self._result == before or not isfinite(status.episode_return):
            return
        episode = status.episode - (status.phase == PHASES.index("training"))
        self._rows.append((episode, *self._result, status.critic_loss, status.actor_loss))
        if len(self._rows) > 1000:
            del self._rows[::2]

    def content(self) -> dict[str, list[float]]:
        """Return the curve for the page: a list of values for each key of `KEYS`."""
        return {key: [row[column] for row in self._rows] for column, key in enumerate(self.KEYS)}
