# SPDX-License-Identifier: Apache-2.0
"""Columns that the pages plot, and their reduction to minimum and maximum per bin: a pulse of one sample is visible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_core.signals import Flag, FloatArray


@dataclass(frozen=True)
class Column:
    """One plotted series: a field of a message in the page's unit."""

    name: str
    field: str
    unit: str = ""
    scale: float = 1.0
    """Factor from the SI unit to the page's."""


STATE_COLUMNS = (
    Column("reference", "reference_force", "N"),
    Column("force", "load_force", "N"),
    Column("hydraulic force", "hydraulic_force", "N"),
    Column("K_p", "proportional_gain", "1/s"),
    Column("K_i", "integral_gain", "1/s²"),
    Column("current", "valve_current", "mA", 1e3),
    Column("pressure a", "pressure_a", "bar", 1e-5),
    Column("pressure b", "pressure_b", "bar", 1e-5),
    Column("position", "piston_position", "mm", 1e3),
)
CORRECTION_COLUMNS = (
    Column("correction", "delta_u", "mA", 1e3),
    Column("without correction", "certificate_before", "1/s"),
    Column("with correction", "certificate_after", "1/s"),
)
LAW_COLUMNS = (
    Column("f_c", "compensated_reference", "N"),
    Column("a_0", "a_0", "%", 1e2),
    Column("a_1", "a_1", "ms", 1e3),
    Column("a_2", "a_2", "10⁻⁵ s²", 1e5),
    Column("a_3", "a_3", "N"),
)
DERIVED_COLUMNS = (Column("error", "", "N"), Column("armed", ""), Column("tripped", ""))
"""Columns derived from the state's fields: f_r - f_l; 1 or 0; 1 or 0."""
SERIES_COLUMNS = ((*STATE_COLUMNS, *DERIVED_COLUMNS), CORRECTION_COLUMNS, LAW_COLUMNS)
"""Columns of states, corrections and laws."""


def column_descriptions() -> list[list[dict[str, str]]]:
    """Return names and units of the columns of the series, states, corrections and laws, for the page."""
    return [[{"name": column.name, "unit": column.unit} for column in columns] for columns in SERIES_COLUMNS]


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
    """Bins of a live stream, at least those of the last minute; `columns`: number of values in a sample.

    Bin floor(time / BIN_WIDTH) is closed, and sent, once a later one has a sample.
    """

    def __init__(self, columns: int) -> None:
        self._table = np.full((2 * HISTORY_BINS, columns, 2), np.nan, np.float32)
        self._first = self._sent = self._open = (
            0  # numbers of the table's first bin, the next to send, the one that fills
        )

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples; those of closed bins are skipped, and after a jump of the clock the series starts again.

        `times`: s, shape (n,), not falling. `values`: shape (n, columns). Non-finite values count as missing.
        """
        if not len(times):
            return
        bins = np.floor(times / BIN_WIDTH).astype(np.int64)
        if abs(int(bins[-1]) - self._open) >= HISTORY_BINS:
            self._table[:] = np.nan
            self._first = self._sent = self._open = max(int(bins[0]), int(bins[-1]) - HISTORY_BINS + 1)
        good = bins >= self._open
        while int(bins[-1]) >= self._first + len(self._table):
            self._table[:HISTORY_BINS] = self._table[HISTORY_BINS:]
            self._table[HISTORY_BINS:] = np.nan
            self._first += HISTORY_BINS
        self._open = max(self._open, int(bins[-1]))
        _reduce_into(self._table, bins[good] - self._first, values[good])

    def poll(self) -> tuple[int, BinTable]:
        """Return the bins closed since the last call, and the number of their first."""
        found = self._between(self._sent, self._open)
        self._sent = self._open
        return found

    def history(self) -> tuple[int, BinTable]:
        """Return the last minute up to the last `poll`, for a new viewer that gets the next bins by `poll`."""
        return self._between(self._sent - HISTORY_BINS, self._sent)

    def _between(self, begin: int, end: int) -> tuple[int, BinTable]:
        begin = max(begin, self._first)
        return begin, self._table[begin - self._first : end - self._first].copy()


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
        if not len(times):
            return
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
    """Extend minimum and maximum of the table's rows by the values of samples, which are sorted by row."""
    if not len(rows):
        return
    rows, starts = np.unique(rows, return_index=True)
    finite = np.where(np.isfinite(values), values, np.nan)
    table[rows, :, 0] = np.fmin(table[rows, :, 0], np.fmin.reduceat(finite, starts, axis=0))
    table[rows, :, 1] = np.fmax(table[rows, :, 1], np.fmax.reduceat(finite, starts, axis=0))
