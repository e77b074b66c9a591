# SPDX-License-Identifier: Apache-2.0
"""Columns of a file: series by name, their units and clocks, and the parts of which a recording may consist."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field
from itertools import count, takewhile
from operator import eq

import numpy as np

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.units import known, quantity, split_unit, stated, to_si
from hydro_diagnosis.recording import InputError

_TIME_COLUMN = re.compile(
    r"^(.*[./\\ _-])?(time|t|\w*zeit|time_?stamps?|x-?axis|x_value|elapsed|date|datum|clock)(\.\d+)?$", re.IGNORECASE
)


@dataclass(frozen=True)
class Columns:
    """Columns and scalars of a file."""

    series: dict[str, FloatArray] = field(default_factory=dict)
    """Columns by name, each of shape (n,); n may differ between clocks."""
    constants: dict[str, float] = field(default_factory=dict)
    """Scalars by name (of .mat and HDF5 files)."""
    other: list[str] = field(default_factory=list)
    """Names of entries that are neither: texts, columns of another length."""
    units: dict[str, str] = field(default_factory=dict)
    """Units stated by the file, by column, as normalised by `stated`."""
    clocks: dict[str, str] = field(default_factory=dict)
    """Clock of each column: the name of its time column; empty for a table whose columns share one clock."""
    notes: list[str] = field(default_factory=list)
    """Notes on the reading of the file, one sentence each."""
    broken: dict[str, str] = field(default_factory=dict)
    """Reason, by column that cannot be read as numbers: its first such cell, one sentence."""
    unsure: dict[str, str] = field(default_factory=dict)
    """Reason, by column whose size the file leaves open, so that the map must say it; FIELD in it is the field."""

    def add(self, name: str, values: FloatArray, unit: str = "") -> str:
        """Add a column with the file's unit; returns its name, numbered if a column of this name exists."""
        column = unique(name, self.series)
        self.series[column] = values
        if stated(unit):
            self.units[column] = stated(unit)
        return column

    def clock(self, times: FloatArray, group: str = "") -> str:
        """Return the name of the clock with these times [s], added unless a clock of the `group` (prefix) has them."""
        clocks = (clock for clock in dict.fromkeys(self.clocks.values()) if clock.startswith(group))
        same = (clock for clock in clocks if np.array_equal(self.series[clock], times))
        return next(same, "") or self.add(f"{group}time", times, "s")

    def resolved(self, name: str) -> str:
        """Return the column that a map means: of this name, or of this name without its unit. Raises InputError."""
        own, unit = split_unit(name)
        same = [one for one in (self.series if name not in self.series else ()) if split_unit(one)[0] == own]
        if len(same) != 1 or name in (*self.broken, *self.other):
            return name
        if unit and self.unit(same[0]) and known(unit) != known(self.unit(same[0])):
            raise InputError(f"{same[0]!r} is in {self.unit(same[0])}, not {unit}")
        return same[0]

    def unit(self, name: str) -> str:
        """Unit of a column, stated by the file or contained in the column's name; empty if unknown."""
        return self.units.get(name) or split_unit(name)[1]


def runs_forward(values: FloatArray, *, ticks: bool = False) -> bool:
    """Return whether more than 90 % of the steps from row to row are positive, as in a column of times.

    `ticks`: steps of 0 count as well, if any step is positive, as of a clock with a coarse resolution.
    """
    steps = np.diff(values[np.isfinite(values)])
    forward = steps >= 0.0 if ticks and np.any(steps > 0.0) else steps > 0.0
    return len(steps) > 0 and float(np.mean(forward)) > 0.9


def median_step(times: FloatArray) -> float:
    """Median of the positive time steps; inf if there is none."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf


def means(values: FloatArray, samples: int) -> FloatArray:
    """Return block means of `values`, shape (n,), over `samples` each; an incomplete last block is dropped."""
    averaged: FloatArray = values[: len(values) // samples * samples].reshape(-1, samples).mean(axis=1)
    return averaged


def is_time(name: str, values: FloatArray) -> bool:
    """Return whether a column is a time, by its name and its increasing values."""
    return _TIME_COLUMN.match(split_unit(name)[0]) is not None and runs_forward(values, ticks=True)


def counts_rows(values: FloatArray) -> bool:
    """Return whether a column is a row counter: all of its steps are 1."""
    return len(values) > 1 and bool(np.all(np.diff(values) == 1.0))


_STEP_KEYS = (
    r"(wf_?|x_?)?(increment|incr?)|delta_?[tx]|dt|h_?resolution|(sampl\w*|x)[ _]?(interval|period|time|increment)"
)
_RATE_KEYS = r"sampl\w*[ _]?(rate|freq\w*)|abtast(rate|frequenz)|fs"
_START_KEYS = r"x_?0|t_?0|wf_?start_?offset|start|x_?(origin|offset|zero)"


def stated_step(properties: Iterable[tuple[str, object]]) -> tuple[float, float]:
    """Start and sampling step [s] of the rows, as stated by a file's properties; (0, 0) if no step is stated.

    Keys as loggers and scopes write them: `wf_increment`, `Delta_X`, `Increment`, `Sample rate [Hz]`.
    """
    start = step = 0.0
    for key, value in properties:
        own, unit = split_unit(key.strip().rstrip(":"))
        number, _, behind = str(value).strip().replace(",", ".").partition(" ")
        try:
            size = float(number) * (to_si(unit or behind) if quantity(unit or behind) != "" else 1.0)
        except ValueError:
            continue
        if re.fullmatch(_START_KEYS, own, re.IGNORECASE):
            start = size
        elif re.fullmatch(_STEP_KEYS, own, re.IGNORECASE) and not step:
            step = size
        elif re.fullmatch(_RATE_KEYS, own, re.IGNORECASE) and size > 0.0 and not step:
            step = 1.0 / size
    return (start, step) if 0.0 < step < 1e3 else (0.0, 0.0)


def merge_parts(parts: Iterable[Columns]) -> Columns:
    """Merge the parts of a recording: those whose times continue are joined by their columns' names, without units.

    A column that a part lacks is NaN there; units are converted. Parts whose time begins again, or without a column in
    common, add columns of their own, numbered where a name repeats. Notes report joined and restarted parts.
    """
    found, last, joined, again, partial = Columns(), dict[str, FloatArray](), 0, 0, dict[str, None]()
    names: dict[str, str] = {}  # of the columns of the recording, by their names without units
    for part in parts:
        bare = [split_unit(name)[0] for name in part.series]
        here = {own if bare.count(own) == 1 else name: name for own, name in zip(bare, part.series, strict=True)}
        series, keys = {key: part.series[name] for key, name in here.items()}, {name: key for key, name in here.items()}
        clocks = {key: keys[part.clocks[name]] for key, name in here.items() if name in part.clocks}
        common = series.keys() & names.keys()
        if common and _goes_on(last, series, set(clocks.values())):
            above = {key: found.series[name] for key, name in names.items()}
            for key in dict.fromkeys((*names, *here)):
                one, other = (
                    some[key]
                    if key in some
                    else np.full(len(some.get(clocks.get(key, ""), next(iter(some.values())))), np.nan)
                    for some in (above, series)
                )
                if key in common:
                    other = _converted(other, part.unit(here[key]), found, names[key])
                else:
                    names.setdefault(
                        key, found.add(here[key], one, part.units.get(here[key], "")) if key in here else ""
                    )
                    partial[names[key]] = None
                found.series[names[key]] = np.concatenate([one, other])
            joined += 1
        else:
            again += bool(common)
            names = {key: found.add(name, part.series[name], part.units.get(name, "")) for key, name in here.items()}
        found.clocks.update({names[key]: names[clock] for key, clock in clocks.items()})
        found.other.extend(name for name in part.other if name not in found.other)
        found.notes.extend(note for note in part.notes if note not in found.notes)
        for mine, others in zip((found.broken, found.unsure), (part.broken, part.unsure), strict=True):
            mine.update(others)
        found.constants.update(part.constants)
        last = series
    if joined:
        found.notes.append(f"it was begun anew {joined} times: the parts were joined by their times and names")
    if partial:
        found.notes.append(f"{', '.join(partial)}: in some of the parts only")
    if again:
        found.notes.append(f"the time begins again, {again + 1} times: give each part as a file of its own")
    return found


def _converted(values: FloatArray, unit: str, found: Columns, name: str) -> FloatArray:
    """Values of a part in the unit of the column above; a column of another quantity is broken."""
    if (above := found.unit(name)) != unit:
        if not quantity(above) or quantity(above) != quantity(unit):
            found.broken[name] = f"{name!r} is in {above or 'no unit'}, and further on in {unit or 'none'}"
            return values
        values = values * (to_si(unit) / to_si(above))
        found.notes.append(f"{name!r} goes on in {unit}: it was converted to {above}")
    return values


def _goes_on(above: Mapping[str, FloatArray], below: Mapping[str, FloatArray], clocks: Set[str]) -> bool:
    """Return whether the times of `below` continue those of `above`: all clocks, else a time column or the first."""
    named = (name for name, values in above.items() if is_time(name, values))
    clocks = clocks or {next(named, next(iter(above), ""))}
    if any(clock not in above or clock not in below for clock in clocks):
        return False
    ends = [[one[np.isfinite(one)] for one in (above[clock], below[clock])] for clock in clocks]
    return all(len(a) and len(b) and runs_forward(a, ticks=True) and b[0] >= a[-1] for a, b in ends)


def set_day_units(found: Columns) -> None:
    """Set the unit of time columns that are date numbers of spreadsheets or MATLAB: days.

    Criterion: a median step below 20 us (of a time of day, below 2 us) if the numbers were seconds.
    """
    for name, values in found.series.items():
        finite = values[np.isfinite(values)]
        if found.unit(name) or not is_time(name, values) or len(finite) < 3:
            continue
        first, step = finite[0], median_step(finite)
        dated = 20_000.0 < first < 80_000.0 or 690_000.0 < first < 780_000.0
        if step < (2e-5 if dated else 2e-6) and (dated or 0.0 <= first < 1.0) and finite[-1] - first < 30.0:
            found.units[name] = "d"
            found.notes.append(f"{name!r} was taken as days, as spreadsheets count them: {first:.10g} and so on")


def assign_clocks_of_equal_length(found: Columns) -> None:
    """Assign a clock to each column without one, of a file with several lengths: a time column of the same length.

    A time column in the same struct or group takes precedence. Of columns without one, the longest are kept without a
    clock and the others are listed under `other`.
    """
    series, clocks = found.series, found.clocks
    longest = max(map(len, series.values()), default=0)
    if all(len(values) == longest for values in series.values()):
        return
    times = [name for name, values in series.items() if is_time(name, values)]
    for name in [name for name in series if name not in (*clocks, *clocks.values())]:
        alike = [time for time in times if len(series[time]) == len(series[name])]
        if alike:
            parts = name.split(".")[:-1]
            in_common = [sum(takewhile(bool, map(eq, parts, time.split(".")[:-1]))) for time in alike]
            clocks[name] = alike[int(np.argmax(in_common))]
        elif len(series[name]) != longest:
            found.other.append(name)
            del series[name]
    if len({clocks.get(name) for name in series}) == 1:
        clocks.clear()


def unique(name: str, taken: Mapping[str, object]) -> str:
    """Return the name, numbered if it is taken: `time`, `time.2`, `time.3`."""
    numbered = (f"{name}.{number}" for number in count(2))
    return name if name not in taken else next(one for one in numbered if one not in taken)
