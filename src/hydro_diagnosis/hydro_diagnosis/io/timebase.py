# SPDX-License-Identifier: Apache-2.0
"""Resampling of channels with different clocks to one of them.

Nothing is made up: a sensor that is as fast as the chosen clock, or faster, is read off between its two neighbouring
samples; one that is slower would be straight lines between its samples, which read as physics, and is left out. The
current is held: row k gets the mean of what acted from row k to row k + 1. All of it is noted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.formats.file_columns import Columns
from hydro_diagnosis.formats.units import UNITS
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.column_source import Source
from hydro_diagnosis.recording import MEASURED, InputError

SLOWER = 1.2
"""Multiple of the chosen clock's sampling time up to which a sensor counts as equally fast."""


COINCIDENT = 1e-3
"""Share of a sampling time within which two times are the same: times of day have 0.2 us in a float."""


def fields_of(found: Columns, chosen: ColumnMap) -> tuple[FloatArray, dict[str, FloatArray], list[str]]:
    """Times [s], fields in SI units by name, all of the same length, and what was done to get them there.

    Raises
    ------
    InputError
        If a column or a single number that the map names is not there, or no time belongs to the fields.
    """
    notes = list(found.notes)
    sources = {field: _in_unit(field, source, found, notes) for field, source in chosen.sources.items()}
    base = _base(sources, found)
    times = _Times(found, sources.get("time"))
    time = times.of(base)
    fields, spans = {}, []
    for field, source in sources.items():
        if field == "time":
            continue
        own = found.clocks.get(source.column, base) if source.column else base
        length = len(found.series[source.column]) if source.column in found.series else len(time)
        values = source.of(found.series, found.constants, length)
        if own == base and not source.delay and len(values) != len(time):
            raise InputError(f"{source.column!r} has {len(values)} rows, its times {len(time)}")
        if not source.delay and (own == base or _coincide(times.of(own), time)):
            fields[field] = values
            continue
        moved = _moved(field, times.of(own) - source.delay, values, time)
        if moved is None:
            notes.append(_too_slow(field, own, times.of(own), time))
            continue
        fields[field] = moved
        spans.append(_span(times.of(own) - source.delay))
        notes.append(_said(field, source, own, base))
    inside = _inside(time, spans)
    if not inside.any() or not fields:
        raise InputError("the clocks of the mapped columns have no time in common")
    return time[inside], {name: values[inside] for name, values in fields.items()}, notes


def _in_unit(field: str, source: Source, found: Columns, notes: list[str]) -> Source:
    """A source that is taken as it is, in the unit that the file states."""
    unit = found.units.get(source.column, "")
    if not source.plain or not unit:
        return source
    if UNITS[unit] != 1.0:
        notes.append(f"{field} is in {unit}, as the file says of {source.column!r}")
    return replace(source, unit=unit)


def _base(sources: Mapping[str, Source], found: Columns) -> str:
    """The column of times to which all are resampled: the mapped one, else that of most sensors, or the longest."""
    if "time" in sources:
        return sources["time"].column
    owners = [found.clocks.get(source.column, "") for field, source in sources.items() if field in MEASURED]
    owners = [clock for clock in owners if clock] or [clock for clock in found.clocks.values() if clock]
    if not owners:
        raise InputError(f"no column is the time: map one by --columns time=NAME,...; there are {_some(found.series)}")
    return max(sorted(set(owners)), key=lambda clock: (owners.count(clock), len(found.series[clock])))


class _Times:
    """Columns of times in s; what the map says of one holds for all of which the file states no unit."""

    def __init__(self, found: Columns, mapped: Source | None) -> None:
        self._found, self._mapped = found, mapped

    def of(self, clock: str) -> FloatArray:
        """Times of a clock."""
        found, mapped = self._found, self._mapped
        if mapped is not None and (clock == mapped.column or clock not in found.units):
            source = replace(mapped, column=clock)
        else:
            source = Source(clock, unit=found.units.get(clock, "s"))
        length = len(found.series.get(clock, ()))
        return source.of(found.series, found.constants, length)


def _moved(field: str, own: FloatArray, values: FloatArray, time: FloatArray) -> FloatArray | None:
    """Values at other times; None for a sensor that is too slow for them."""
    there = np.isfinite(own)
    own, values = own[there], values[there]
    if field == "valve_current":
        return _held_mean(own, values, time)
    if field not in MEASURED:
        return values[np.clip(np.searchsorted(own, time + 1e-9, side="right") - 1, 0, len(own) - 1)]
    if _step(own) > SLOWER * _step(time):
        return None
    return _read_off(own, values, time)


def _read_off(own: FloatArray, values: FloatArray, time: FloatArray) -> FloatArray:
    """Values between their neighbouring samples; a sample that falls on a time but for rounding is taken as it is."""
    near = np.clip(np.searchsorted(own, time - COINCIDENT * _step(time)), 0, len(own) - 1)
    there = np.abs(own[near] - time) < COINCIDENT * _step(time)
    return np.where(there, values[near], np.interp(time, own, values))


def _coincide(one: FloatArray, other: FloatArray) -> bool:
    if len(one) != len(other):
        return False
    return bool(np.all(np.abs(one - other) < COINCIDENT * _step(other)))


def _held_mean(own: FloatArray, values: FloatArray, time: FloatArray) -> FloatArray:
    """Mean, from each time to the next, of what is held from each of its own times to the next."""
    ends = np.concatenate([own, own[-1:] + _step(own)])
    edges = np.concatenate([time, time[-1:] + _step(time)])
    dose = np.concatenate([[0.0], np.cumsum(values * np.diff(ends))])
    clipped = np.clip(edges, ends[0], ends[-1])
    widths = np.diff(clipped)
    means = np.diff(np.interp(clipped, ends, dose)) / np.where(widths > 0.0, widths, np.nan)
    return np.asarray(means)


def _step(times: FloatArray) -> float:
    steps = np.diff(times)
    return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf


def _span(times: FloatArray) -> tuple[float, float]:
    return float(np.nanmin(times)), float(np.nanmax(times))


def _inside(time: FloatArray, spans: list[tuple[float, float]]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Rows at which every clock ran."""
    inside = np.ones(len(time), dtype=bool)
    for begin, end in spans:
        slack = 0.5 * _step(time)
        inside &= ~(time < begin - slack) & ~(time > end + slack)
    return inside


def _said(field: str, source: Source, own: str, base: str) -> str:
    how = {True: "the mean of what was held from row to row"}.get(
        field == "valve_current", "read off between its neighbouring samples" if field in MEASURED else "the last known"
    )
    late = f" {abs(source.delay) * 1e3:g} ms {'late' if source.delay > 0.0 else 'early'}" if source.delay else ""
    clock = f" by the clock {own!r}, not {base!r}" if own != base else ""
    return f"{field} was recorded{late}{' and' if late and clock else ''}{clock}: taken is {how}"


def _too_slow(field: str, own: str, times: FloatArray, time: FloatArray) -> str:
    return (
        f"{field} is sampled {1.0 / _step(times):.4g} times a second, the others {1.0 / _step(time):.4g} times: it was "
        f"left out (--columns time='{own}' brings all to its times)"
    )


def _some(names: Mapping[str, object]) -> str:
    return ", ".join(list(names)[:40])
