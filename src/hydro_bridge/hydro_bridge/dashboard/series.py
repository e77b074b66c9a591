# SPDX-License-Identifier: Apache-2.0
"""Columns that the page plots, extracted from serialized messages, and their downsampling to screen resolution.

`column_descriptions` gives the page names and units. A slot keeps minimum and maximum: a pulse of one sample stays
visible.

`Downsampler`, of a live series, keeps the last minute in a ring::

    ring, shape (kept, columns, 2):   slot n is row n % kept;   [..., 0] minimum, [..., 1] maximum, NaN: no sample
    n = floor(time / SLOT)            ... | closed | closed | open |    the open slot is still filling, not yet shown

`GrowingDownsampler`, of a recording of unknown length, lets its slots grow with it::

    slots of 10 ms   | 0 | 1 | 2 | 3 | ... | limit - 1 |     full, and another sample arrives:
    slots of 20 ms   |   0   |   1   | ... |           |     pairs are merged; and so on
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
STATE_EXTRA = (Column("error", "", "N"), Column("armed", ""), Column("tripped", ""))
"""Columns derived from the state's fields: f_r - f_l; 1 or 0; 1 or 0."""
SERIES = ((*STATE_COLUMNS, *STATE_EXTRA), CORRECTION_COLUMNS, LAW_COLUMNS)
"""Columns of states, corrections and laws."""


def column_descriptions() -> list[list[dict[str, str]]]:
    """Return names and units of the columns of the series, states, corrections and laws, for the page."""
    return [[{"name": column.name, "unit": column.unit} for column in columns] for columns in SERIES]


def column_values(number: int, table: npt.NDArray[np.void]) -> FloatArray:
    """Return the columns `SERIES[number]` of a message table in the page's units, shape (n, columns)."""
    values = [table[column.field] * column.scale for column in SERIES[number] if column.field]
    if number == 0:
        flags, error = table["flags"], table["reference_force"] - table["load_force"]
        values += [error, (flags & Flag.ARMED) != 0, (flags & Flag.TRIPPED) != 0]
    return np.column_stack(values)


SLOT_TIME = 0.01
"""Duration of a slot [s]; a page of 10 s has 1000 slots, about one per pixel of a plot."""
HISTORY_SLOTS = 6000
"""Slots kept for viewers that connect later: 60 s."""


@dataclass(frozen=True)
class Slots:
    """Consecutive complete slots of a downsampled series."""

    first: int
    """Number of the first slot: floor(time / SLOT_TIME)."""
    values: npt.NDArray[np.float32]
    """Minimum and maximum, shape (slots, columns, 2)."""

    def encode(self, series: int) -> bytes:
        """Return the bytes for the page: u32 series, u32 columns, f64 first, float32 values, all little endian."""
        head = np.array([series, self.values.shape[1]], "<u4").tobytes() + np.array([self.first], "<f8").tobytes()
        return head + np.ascontiguousarray(self.values, "<f4").tobytes()


class Downsampler:
    """Reduces a live stream to minimum and maximum per slot of `SLOT_TIME`; `columns`: number of values in a sample."""

    def __init__(self, columns: int) -> None:
        self._ring = np.full((HISTORY_SLOTS, columns, 2), np.nan, np.float32)
        self._begin = self._taken = self._open = 0

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples.

        Samples older than the open slot are skipped; if time falls back by more than the ring, as after the clock was
        set, the series is restarted.

        `times`: s, shape (n,), not falling. `values`: shape (n, columns). Non-finite values count as missing.
        """
        if not len(times):
            return
        slots = np.floor(times / SLOT_TIME).astype(np.int64)
        kept = len(self._ring)
        if not self._open or abs(int(slots[-1]) - self._open) >= kept:
            self._ring[:] = np.nan
            self._begin = self._taken = self._open = max(int(slots[0]), int(slots[-1]) - kept + 1)
        good = slots >= self._open
        slots, values = slots[good], values[good]
        if not len(slots):
            return
        last = int(slots[-1])
        self._ring[np.arange(self._open + 1, last + 1)[-kept:] % kept] = np.nan
        self._open, self._taken = last, max(self._taken, last - kept + 1)
        _reduce_into(self._ring, slots, values)

    def poll(self) -> Slots:
        """Return the slots closed since the last call."""
        slots = self._between(self._taken, self._open)
        self._taken = self._open
        return slots

    def history(self) -> Slots:
        """Return all slots in the ring up to the last `poll`, for a new viewer that gets the next ones by `poll`."""
        return self._between(max(self._begin, self._open - len(self._ring) + 1), self._taken)

    def _between(self, first: int, end: int) -> Slots:
        rows = np.arange(first, max(first, end)) % len(self._ring)
        return Slots(first, self._ring[rows])


SLOTS_MAX = 2**16
"""Default number of slots: 655 s in slots of 10 ms, an hour in slots of 80 ms."""


class GrowingDownsampler:
    """Reduces a stream of unknown length to minimum and maximum per slot; the slots double as it grows.

    `columns`: values per sample. `begin`: start of the first slot, s. `limit`: maximum number of slots, even.
    """

    def __init__(self, columns: int, begin: float, limit: int = SLOTS_MAX) -> None:
        self._begin = begin
        self.end = begin
        """Time of the latest sample, s, on the clock of the samples."""
        self._table = np.full((limit, columns, 2), np.nan, np.float32)
        self._count = 0
        self.slot = SLOT_TIME
        """Duration of a slot [s]."""

    def add(self, times: FloatArray, values: FloatArray) -> None:
        """Add samples; those before `begin` are left out.

        `times`: s, shape (n,). `values`: shape (n, columns). Non-finite values count as missing.
        """
        good = times >= self._begin
        times, values = times[good], values[good]
        if not len(times):
            return
        self.end = max(self.end, float(times.max()))
        while self.end - self._begin >= self.slot * len(self._table):
            self._merge()
        slots = np.floor((times - self._begin) / self.slot).astype(np.int64)
        order = np.argsort(slots, kind="stable")
        _reduce_into(self._table, slots[order], values[order])
        self._count = max(self._count, int(slots.max()) + 1)

    def values(self, slot: float) -> npt.NDArray[np.float32]:
        """Return minimum and maximum in slots of `slot` s, or this series' own if longer, shape (slots, columns, 2)."""
        while self.slot < slot:
            self._merge()
        return self._table[: self._count]

    def _merge(self) -> None:
        half = len(self._table) // 2
        self._table[:half, :, 0] = np.fmin(self._table[::2, :, 0], self._table[1::2, :, 0])
        self._table[:half, :, 1] = np.fmax(self._table[::2, :, 1], self._table[1::2, :, 1])
        self._table[half:] = np.nan
        self._count = -(-self._count // 2)
        self.slot *= 2.0


def _reduce_into(table: npt.NDArray[np.float32], slots: npt.NDArray[np.int64], values: FloatArray) -> None:
    """Extend minimum and maximum of slots, rows `slot % len(table)`, by the values of samples sorted by slot."""
    numbers, starts = np.unique(slots, return_index=True)
    rows, finite = numbers % len(table), np.where(np.isfinite(values), values, np.nan)
    table[rows, :, 0] = np.fmin(table[rows, :, 0], np.fmin.reduceat(finite, starts, axis=0))
    table[rows, :, 1] = np.fmax(table[rows, :, 1], np.fmax.reduceat(finite, starts, axis=0))
