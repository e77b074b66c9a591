# SPDX-License-Identifier: Apache-2.0
"""Columns that the page plots, extracted from serialized messages, and their downsampling to screen resolution.

`column_descriptions` gives the page names and units. A bin keeps minimum and maximum: a pulse of one sample stays
visible.

`Downsampler`, of a live series, keeps the last minute in a ring::

    ring, shape (kept, columns, 2):   bin n is row n % kept;   [..., 0] minimum, [..., 1] maximum, NaN: no sample
    n = floor(time / BIN_WIDTH)       ... | closed | closed | open |    the open bin is still filling, not yet shown

`GrowingDownsampler`, of a recording of unknown length, lets its bins grow with it::

    bins of 10 ms    | 0 | 1 | 2 | 3 | ... | limit - 1 |     full, and another sample arrives:
    bins of 20 ms    |   0   |   1   | ... |           |     pairs are merged; and so on
"""

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


@dataclass(frozen=True)
class Bins:
    """Consecutive complete bins of a downsampled series."""

    first: int
    """Number of the first bin: floor(time / BIN_WIDTH)."""
    values: npt.NDArray[np.float32]
    """Minimum and maximum, shape (bins, columns, 2)."""

    def encode(self, series: int) -> bytes:
        """Return the bytes for the page: u32 series, u32 columns, f64 first, float32 values, all little endian."""
        head = np.array([series, self.values.shape[1]], "<u4").tobytes() + np.array([self.first], "<f8").tobytes()
        return head + np.ascontiguousarray(self.values, "<f4").tobytes()


class Downsampler:
    """Reduces a live stream to minimum and maximum per bin of `BIN_WIDTH`; `columns`: number of values in a sample."""

    def __init__(self, columns: int) -> None:
        self._ring = np.full((HISTORY_BINS, columns, 2), np.nan, np.float32)
        self._begin = self._taken = self._open = 0

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples.

        Samples older than the open bin are skipped; if time falls back by more than the ring, as after the clock was
        set, the series is restarted.

        `times`: s, shape (n,), not falling. `values`: shape (n, columns). Non-finite values count as missing.
        """
        if not len(times):
            return
        bins = np.floor(times / BIN_WIDTH).astype(np.int64)
        kept = len(self._ring)
        if not self._open or abs(int(bins[-1]) - self._open) >= kept:
            self._ring[:] = np.nan
            self._begin = self._taken = self._open = max(int(bins[0]), int(bins[-1]) - kept + 1)
        good = bins >= self._open
        bins, values = bins[good], values[good]
        if not len(bins):
            return
        last = int(bins[-1])
        self._ring[np.arange(self._open + 1, last + 1)[-kept:] % kept] = np.nan
        self._open, self._taken = last, max(self._taken, last - kept + 1)
        _reduce_into(self._ring, bins, values)

    def poll(self) -> Bins:
        """Return the bins closed since the last call."""
        bins = self._between(self._taken, self._open)
        self._taken = self._open
        return bins

    def history(self) -> Bins:
        """Return all bins in the ring up to the last `poll`, for a new viewer that gets the next ones by `poll`."""
        return self._between(max(self._begin, self._open - len(self._ring) + 1), self._taken)

    def _between(self, first: int, end: int) -> Bins:
        rows = np.arange(first, max(first, end)) % len(self._ring)
        return Bins(first, self._ring[rows])


BINS_MAX = 2**16
"""Default number of bins: 655 s in bins of 10 ms, an hour in bins of 80 ms."""


class GrowingDownsampler:
    """Reduces a stream of unknown length to minimum and maximum per bin; the bins' width doubles as it grows.

    `columns`: values per sample. `begin`: start of the first bin, s. `limit`: maximum number of bins, even.
    """

    def __init__(self, columns: int, begin: float, limit: int = BINS_MAX) -> None:
        self._begin = begin
        self.end = begin
        """Time of the latest sample, s, on the clock of the samples."""
        self._table = np.full((limit, columns, 2), np.nan, np.float32)
        self._count = 0
        self.bin_width = BIN_WIDTH
        """Width of a bin [s]."""

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples; those before `begin` are left out.

        `times`: s, shape (n,). `values`: shape (n, columns). Non-finite values count as missing.
        """
        good = times >= self._begin
        times, values = times[good], values[good]
        if not len(times):
            return
        self.end = max(self.end, float(times.max()))
        while self.end - self._begin >= self.bin_width * len(self._table):
            self._merge()
        bins = np.floor((times - self._begin) / self.bin_width).astype(np.int64)
        order = np.argsort(bins, kind="stable")
        _reduce_into(self._table, bins[order], values[order])
        self._count = max(self._count, int(bins.max()) + 1)

    def values(self, bin_width: float) -> npt.NDArray[np.float32]:
        """Return minimum and maximum in bins of `bin_width` s or this series' longer ones, shape (bins, columns, 2)."""
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


def _reduce_into(table: npt.NDArray[np.float32], bins: npt.NDArray[np.int64], values: FloatArray) -> None:
    """Extend minimum and maximum of bins, rows `bin % len(table)`, by the values of samples sorted by bin."""
    numbers, starts = np.unique(bins, return_index=True)
    rows, finite = numbers % len(table), np.where(np.isfinite(values), values, np.nan)
    table[rows, :, 0] = np.fmin(table[rows, :, 0], np.fmin.reduceat(finite, starts, axis=0))
    table[rows, :, 1] = np.fmax(table[rows, :, 1], np.fmax.reduceat(finite, starts, axis=0))
