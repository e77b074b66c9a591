# SPDX-License-Identifier: Apache-2.0
"""Recordings as tables: bags, files of other loggers, column maps, and channels with different clocks.

Channels are resampled to one clock. A sensor as fast as this clock, or faster, is interpolated linearly between
neighbouring samples; a slower one is omitted, since its straight lines would be identified as physics. The valve
current is a zero-order hold over the box's sample: a row gets its mean over one row's length, centred on the middle of
the sample that begins there (rows of up to 1 ms: the mean from this row to the next). Notes report each conversion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from hydro_bridge.bags import exists, is_bag
from hydro_bridge.bags.recording import STATE_TOPIC, Bag, RecordingError, read_bag
from hydro_core.signals import SAMPLE_PERIOD, STATE_FIELDS, FloatArray
from hydro_diagnosis.io.column_map import QUANTITY_OF, ColumnMap, Source
from hydro_diagnosis.io.columns import Columns, median_step
from hydro_diagnosis.io.formats import read_columns
from hydro_diagnosis.io.raster import own_rows
from hydro_diagnosis.io.topics import has_states, topic_columns
from hydro_diagnosis.io.units import quantity, to_si
from hydro_diagnosis.recording import MEASURED_CHANNELS, InputError

MAX_SPLINED_ROWS = 10
"""Rows from sample to sample up to which a slower position, which is smooth, is interpolated by a spline."""
ROW_COLUMN = "row"
"""Column name by which a map refers to the row index, from 0, unless the file has a column of this name."""


@dataclass(frozen=True)
class RawTable:
    """Recording as read, before the quality checks."""

    name: str
    time: FloatArray
    """s, shape (n,)."""
    sample: FloatArray | None
    """Box sample number of each row, from 0, shape (n,), or None without the box's counter."""
    columns: dict[str, FloatArray]
    """BenchState fields, SI units, each of shape (n,)."""
    notes: tuple[str, ...] = ()
    """Conversions applied to the file, one sentence each."""
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Unit of a field's column before conversion to SI, where the map or the file states one."""


def read_table(path: str | Path, columns: ColumnMap | None = None) -> RawTable:
    """Read one recording.

    `path`: a rosbag2 folder or .mcap, or a file of one of `recording.RECORDING_SUFFIXES`. `columns`: column map; None
    for a file with a `time` column [s] and columns named as BenchState fields. A bag with /hydro/state needs none; the
    columns of other bags are made by `topics`. Raises InputError with a message that names the path, and where a column
    is not found, the available columns.
    """
    path = Path(path)
    if not (is_bag(path) and has_states(path)):
        return table_of(path, columns_of(path), columns)
    bag = _bag(path)
    steps = np.diff(bag.state["sequence"]).view(np.int32).astype(np.float64)
    fields = {name: np.ascontiguousarray(bag.state[name]) for name in STATE_FIELDS}
    samples = np.concatenate([[0.0], np.cumsum(steps)])
    found = RawTable(path.name, bag.state["time"].copy(), samples, fields, bag.notes)
    return found if columns is None else map_bag_fields(path, found, columns)


def columns_of(path: Path) -> Columns:
    """Columns of a recording before mapping: the fields of a bag with /hydro/state, all numeric columns of other files.

    Raises InputError with a message that names the path.
    """
    if not exists(path):
        raise InputError(f"{path}: there is no such recording")
    if is_bag(path):
        if not has_states(path):
            return topic_columns(path)
        bag = _bag(path)
        series = {name: bag.state[name].copy() for name in ("time", *STATE_FIELDS)}
        return Columns(series, units={"time": "s"}, notes=list(bag.notes))
    if path.suffix.lower() in (".bag", ".db3"):
        _bag(path)  # raises with the remedy
    return read_columns(path)


def map_bag_fields(path: Path, raw: RawTable, columns: ColumnMap) -> RawTable:
    """Apply a column map to the fields of a bag. Raises InputError: as `read_table`."""
    turned = table_of(path, Columns({"time": raw.time, **raw.columns}, notes=list(raw.notes)), columns)
    return replace(turned, name=raw.name, sample=raw.sample if len(turned.time) == len(raw.time) else None)


def _bag(path: Path) -> Bag:
    try:
        bag = read_bag(path, (STATE_TOPIC,), skip_damaged=True)
        empty = not len(bag.state)
    except RecordingError as error:
        raise InputError(str(error)) from None
    if empty:
        raise InputError(f"{path}: the recording is empty")
    return bag


def table_of(path: Path, found: Columns, columns: ColumnMap | None) -> RawTable:
    """Apply a column map to the columns of a file. Raises InputError: as `read_table`."""
    chosen = (columns or ColumnMap({})).completed([*found.series, *found.broken])
    there = ", ".join(list(found.series)[:40])
    if not set(chosen.sources) - {"time"}:
        raise InputError(
            f"{path}: no column is mapped to a BenchState field: map them by --columns "
            f"time=NAME,piston_position=NAME[mm],...; there are {there}"
        )
    if "time" not in chosen.sources and not found.clocks:
        raise InputError(
            f"{path}: no column is the time: name it by time=NAME in --columns, or count even rows, as by "
            f'--columns "time={ROW_COLUMN}*0.001,{chosen}" at 1 kHz; there are {there}'
        )
    if any(source.column == ROW_COLUMN for source in chosen.sources.values()) and ROW_COLUMN not in found.series:
        length = max(len(found.series.get(source.column, ())) for source in chosen.sources.values())
        found = replace(found, series={**found.series, ROW_COLUMN: np.arange(length, dtype=np.float64)})
    try:
        time, fields, notes, units = fields_of(found, chosen)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return RawTable(path.stem, time, None, fields, tuple(notes), units)


# --- one time base -------------------------------------------------------------------------------------------------


def fields_of(found: Columns, chosen: ColumnMap) -> tuple[FloatArray, dict[str, FloatArray], list[str], dict[str, str]]:
    """Times [s], (n,), fields in SI units, (n,), by name, notes on their conversion, and the columns' stated units.

    Raises InputError if a mapped column or scalar is missing or unusable, or the columns have no times in common.
    """
    empty = [name for name in found.other if name in MEASURED_CHANNELS]
    notes = [*found.notes, *(f"{name} holds no numbers and was left out" for name in empty)]
    named = {field: replace(one, column=found.resolved(one.column)) for field, one in chosen.sources.items()}
    given = named["time"].column if "time" in named else ""
    parent = given if given in found.series else given.rpartition(" of ")[0] or given  # of a slower channel's clock
    if given:
        named["time"] = replace(named["time"], column=parent)
    found = _with_rasters(found, ColumnMap(named), notes)
    sources = {field: _in_unit(field, source, found, notes) for field, source in named.items()}
    base = given if given != parent and given in found.series else base_clock(sources, found)
    times = cache(partial(_times_of, found=found, mapped=sources.get("time"), notes=notes))
    time = times(base)
    step, inside = median_step(time), np.ones(len(time), dtype=bool)
    coincident = 1e-3 * step  # tolerance of equal times: stamps since 1970 resolve 0.2 us in a float
    fields = {}
    for field, source in sources.items():
        if field == "time":
            continue
        if source.column in found.broken or source.column in found.other:
            raise InputError(found.broken.get(source.column, f"{source.column!r} holds no numbers, or too few"))
        clock = found.clocks.get(source.column, parent or base) if source.column else base
        values = source.of(found.series, found.constants, len(found.series.get(source.column, time)))
        gaps = ~np.isfinite(values)
        if field == "valve_current" and 0.05 < np.mean(gaps) < 1.0:  # written where it changes
            notes.append(f"{field} is empty in {int(np.sum(gaps))} rows: it was held from the last one")
            values = values[np.maximum.accumulate(np.where(gaps, 0, np.arange(len(values))))]
        if clock == base and len(values) != len(time):
            raise InputError(f"{source.column!r} has {len(values)} rows, its times {len(time)}")
        own = times(clock) - source.delay
        if not source.delay and (clock == base or (len(own) == len(time) and np.all(np.abs(own - time) < coincident))):
            fields[field] = values
            continue
        own, values = own[np.isfinite(own)], values[np.isfinite(own)]
        every = median_step(own)
        if field in MEASURED_CHANNELS and every > 1.2 * step:
            splined = (
                field == "piston_position"
                and clock.startswith(f"{base} of ")
                and every <= 1.2 * MAX_SPLINED_ROWS * step
            )
            if not splined:
                notes.append(
                    f"{field} is sampled {1.0 / every:.4g} times a second, the others {1.0 / step:.4g} "
                    f"times: it was left out (--columns time='{clock}' brings all to its times)"
                )
                continue
            inside &= (time >= own[0]) & (time <= own[-1])
            fields[field], how = CubicSpline(own, values)(time), "a spline through its samples"
        elif field == "valve_current":
            fields[field], how = _held_mean(own, values, time), "the mean of what was held about it"
        elif field in MEASURED_CHANNELS:
            near = np.clip(np.searchsorted(own, time - coincident), 0, len(own) - 1)
            exact = np.abs(own[near] - time) < coincident
            fields[field] = np.where(exact, values[near], np.interp(time, own, values))
            how = "its rows at these times" if exact.all() else "read off between its neighbouring samples"
        else:
            fields[field] = values[np.clip(np.searchsorted(own, time + 1e-9, side="right") - 1, 0, len(own) - 1)]
            how = "the last known"
        inside &= ~(time < own.min() - 0.5 * step) & ~(time > own.max() + 0.5 * step)
        said = [f" {abs(source.delay) * 1e3:g} ms {'late' if source.delay > 0.0 else 'early'}"] if source.delay else []
        said += [f" by the clock {clock!r}, not {base!r}"] if clock != base else []
        notes.append(f"{field} was recorded{' and'.join(said)}: taken is {how}")
    if not inside.any() or not fields:
        raise InputError("the clocks of the mapped columns have no time in common")
    units = {field: source.unit for field, source in sources.items() if source.unit}
    return time[inside], {name: values[inside] for name, values in fields.items()}, notes, units


def _with_rasters(found: Columns, chosen: ColumnMap, notes: list[str]) -> Columns:
    """Columns with those of mapped sensors at their own rows only, by clocks named `CLOCK of FIELD`."""
    series, clocks, units, there = dict(found.series), dict(found.clocks), dict(found.units), dict[bytes, str]()
    mapped = chosen.sources["time"].column if "time" in chosen.sources else ""
    for field, source in chosen.sources.items():
        clock = found.clocks.get(source.column) or mapped
        values, times = found.series.get(source.column), found.series.get(clock)
        if field not in (*MEASURED_CHANNELS, "valve_current") or values is None or times is None:
            continue
        rows, how = own_rows(times, values)
        if not len(rows) or (field == "valve_current" and np.isfinite(values).all()):
            continue  # a current is held
        own = there.setdefault(clock.encode() + rows.tobytes(), f"{clock} of {field}")
        series[own], series[source.column], clocks[source.column] = times[rows], values[rows], own
        units[own] = found.unit(clock)
        notes.append(f"{field} {how}: it is used at its own {len(rows)} samples")
    return replace(found, series=series, clocks=clocks, units=units)


def _in_unit(field: str, source: Source, found: Columns, notes: list[str]) -> Source:
    """Return a plain source with the file's unit. Raises InputError if that is not of the field's quantity."""
    if source.plain and source.column in found.unsure:
        raise InputError(found.unsure[source.column].replace("FIELD", field))
    unit, wanted = found.unit(source.column), QUANTITY_OF.get(field, "")
    if not source.plain or not unit:
        return source
    if wanted and quantity(unit) != wanted:
        raise InputError(
            f"{source.column!r} is in {unit}, {field} is a {wanted}: give a factor to SI, as in "
            f"{field}={replace(source, factor=0.001)}"
        )
    if to_si(unit) != 1.0:
        notes.append(f"{field} is in {unit}, as the file says of {source.column!r}")
    return replace(source, unit=unit)


def base_clock(sources: Mapping[str, Source], found: Columns) -> str:
    """Time column to which all others are resampled: the clock of most sensors, or the longest.

    Where the map names a time column, it is one of that column's rows: of most sensors, or of a position or a current
    that is slower.
    """
    mapped = sources["time"].column if "time" in sources else ""
    clocks = {field: found.clocks.get(one.column, mapped) for field, one in sources.items()}
    owners = [clock for field, clock in clocks.items() if field in (*MEASURED_CHANNELS, "valve_current") and clock]
    if mapped:
        owners = [clock for clock in owners if f"{clock} of ".startswith(f"{mapped} of ")] or [mapped]
    owners = owners or [clock for clock in found.clocks.values() if clock]
    if not owners:
        there = ", ".join(list(found.series)[:40])
        raise InputError(f"no column is the time: map one by --columns time=NAME,...; there are {there}")
    rows = {clock: len(found.series.get(clock, ())) for clock in owners}
    most = max(sorted(rows), key=lambda clock: (owners.count(clock), rows[clock]))
    slow = [clocks[field] for field in ("piston_position", "valve_current") if clocks.get(field) in rows]
    if slow and slow[0] == clocks.get("piston_position") and rows[slow[0]] * MAX_SPLINED_ROWS >= rows[most]:
        slow = slow[1:]
    return min([most, *slow], key=rows.__getitem__) if mapped else most


def _times_of(clock: str, found: Columns, mapped: Source | None, notes: list[str]) -> FloatArray:
    """Times of a clock [s]; the mapped unit and operations apply to all clocks without a unit stated by the file."""
    if clock in found.broken:
        raise InputError(found.broken[clock])
    if mapped is not None and (f"{clock} of ".startswith(f"{mapped.column} of ") or not found.unit(clock)):
        source = replace(mapped, column=clock)
    else:
        source = _in_unit("time", Source(clock), found, [])
    times = source.of(found.series, found.constants, len(found.series.get(clock, ())))
    return _between_ticks(clock, times, notes)


def _between_ticks(clock: str, times: FloatArray, notes: list[str]) -> FloatArray:
    """Times of rows stamped by a clock of coarse resolution: evenly spaced, by counting the rows.

    Raises InputError if the counts from tick to tick show that rows are missing, or there are too few ticks.
    """
    steps = np.diff(times)
    if not np.isfinite(times).all() or np.any(steps < 0.0) or not 0.1 < np.mean(steps == 0.0) < 1.0:
        return times
    first = np.flatnonzero(steps > 0.0) + 1
    tick = float(np.median(np.diff(times[first]))) if len(first) > 2 else 0.0
    fitted = float(np.polyfit(first, times[first], 1)[0]) if tick else 0.0
    tried = (float(f"{fitted:.{digits}g}") for digits in range(1, 5))
    step = next((one for one in tried if np.ptp(times[first] - one * first) < 1.01 * one), fitted)
    even = float(np.median(times[first] - step * first)) + step * np.arange(len(times), dtype=np.float64)
    if not tick or np.any(np.abs(even - times)[first] > 0.5 * tick + step):
        raise InputError(
            f"{clock!r} is too coarse to tell when each row was taken: where the rows are even, count them, as by "
            "--columns time=row*0.001,... at 1 kHz"
        )
    notes.append(f"{clock!r} goes on in ticks of {1e3 * tick:.4g} ms: its rows were placed {1e3 * step:.4g} ms apart")
    return np.asarray(even)


def _held_mean(own: FloatArray, values: FloatArray, time: FloatArray) -> FloatArray:
    """Means of a zero-order hold with times `own`, one per row of `time`, centred on the middle of the box's sample."""
    ends = np.concatenate([own, own[-1:] + median_step(own)])
    dose = np.concatenate([[0.0], np.cumsum(values * np.diff(ends))])
    rows = np.diff(time, append=time[-1] + median_step(time))
    middle = time + 0.5 * np.minimum(rows, SAMPLE_PERIOD)
    low, high = (np.clip(middle + side * 0.5 * rows, ends[0], ends[-1]) for side in (-1.0, 1.0))
    widths = np.where(high > low, high - low, np.nan)
    return np.asarray((np.interp(high, ends, dose) - np.interp(low, ends, dose)) / widths)
