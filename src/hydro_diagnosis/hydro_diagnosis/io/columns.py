# SPDX-License-Identifier: Apache-2.0
"""Contents of a file: columns by name, their units, and their sampling clocks."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count, takewhile
from operator import eq

import numpy as np

from hydro_bridge.bags.recording import Extent
from hydro_core.signals import FloatArray
from hydro_diagnosis.io.units import quantity, split_unit, stated, to_si

_TIME = re.compile(
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
    """Units stated by the file, by column, as normalised by `units.stated`."""
    clocks: dict[str, str] = field(default_factory=dict)
    """Clock of each column: the name of its time column; empty for a table whose columns share one clock."""
    notes: list[str] = field(default_factory=list)
    """Notes on the reading of the file, one sentence each."""
    extents: Mapping[str, Extent] = field(default_factory=dict)
    """Count and range of all numbers, by column of which `series` holds every n-th row."""
    broken: dict[str, str] = field(default_factory=dict)
    """Reason, by column that cannot be read as numbers: its first such cell, one sentence."""

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
    return _TIME.match(split_unit(name)[0]) is not None and runs_forward(values, ticks=True)


def counts_rows(values: FloatArray) -> bool:
    """Return whether a column is a row counter: all of its steps are 1."""
    return len(values) > 1 and bool(np.all(np.diff(values) == 1.0))


_STEP = r"(wf_?|x_?)?(increment|incr?)|delta_?[tx]|dt|h_?resolution|(sampl\w*|x)[ _]?(interval|period|time|increment)"
_RATE = r"sampl\w*[ _]?(rate|freq\w*)|abtast(rate|frequenz)|fs"
_START = r"x_?0|t_?0|wf_?start_?offset|start|x_?(origin|offset|zero)"


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
        if re.fullmatch(_START, own, re.IGNORECASE):
            start = size
        elif re.fullmatch(_STEP, own, re.IGNORECASE) and not step:
            step = size
        elif re.fullmatch(_RATE, own, re.IGNORECASE) and size > 0.0 and not step:
            step = 1.0 / size
    return (start, step) if 0.0 < step < 1e3 else (0.0, 0.0)


def merge_parts(parts: Iterable[Columns]) -> Columns:
    """Merge the parts of a recording: consecutive parts with the same columns and continuing times are concatenated.

    Parts whose time restarts, or with other columns, add columns of their own, numbered where a name repeats. Notes
    report concatenated and restarted parts.
    """
    found, last, joined, again = Columns(), Columns(), 0, 0
    names: dict[str, str] = {}
    for part in parts:
        alike = bool(last.series) and list(part.series) == list(last.series)
        if alike and _goes_on(last, part):
            for name, values in part.series.items():
                found.series[names[name]] = np.concatenate([found.series[names[name]], values])
            joined += 1
        else:
            again += alike
            names = {name: found.add(name, values, part.units.get(name, "")) for name, values in part.series.items()}
            found.clocks.update({names[name]: names[clock] for name, clock in part.clocks.items()})
        found.other.extend(name for name in part.other if name not in found.other)
        found.notes.extend(note for note in part.notes if note not in found.notes)
        found.broken.update(part.broken)
        found.constants.update(part.constants)
        last = part
    if joined:
        found.notes.append(
            f"a header or other words stand among the numbers, or it was stopped and started again, {joined} times: "
            "what follows was joined by its times"
        )
    if again:
        found.notes.append(
            f"its columns come {again + 1} times and the time begins again: the later parts are columns of their own "
            "and a map takes one part only; give each part as a file of its own"
        )
    return found


def _goes_on(above: Columns, below: Columns) -> bool:
    """Return whether the times of `below` continue those of `above`: all clocks, else a time column or the first."""
    named = (name for name, values in above.series.items() if is_time(name, values))
    clocks = set(above.clocks.values()) or {next(named, next(iter(above.series)))}
    ends = [(above.series[name], below.series[name]) for name in clocks]
    ends = [(one[np.isfinite(one)], other[np.isfinite(other)]) for one, other in ends]
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
    """Assign a clock to each column of a file with several lengths: a time column of the same length.

    A time column in the same struct or group takes precedence. Of columns without one, the longest are kept without a
    clock and the others are listed under `other`.
    """
    series, clocks = found.series, found.clocks
    longest = max(map(len, series.values()), default=0)
    if all(len(values) == longest for values in series.values()):
        return
    times = [name for name, values in series.items() if is_time(name, values)]
    for name, values in [*series.items()]:
        alike = [time for time in times if len(series[time]) == len(values)]
        if alike:
            parts = name.split(".")[:-1]
            in_common = [sum(takewhile(bool, map(eq, parts, time.split(".")[:-1]))) for time in alike]
            clocks[name] = alike[int(np.argmax(in_common))]
        elif len(values) != longest:
            found.other.append(name)
            del series[name]
    if len({clocks.get(name) for name in series}) == 1:
        clocks.clear()


def unique(name: str, taken: Mapping[str, object]) -> str:
    """Return the name, numbered if it is taken: `time`, `time.2`, `time.3`."""
    numbered = (f"{name}.{number}" for number in count(2))
    return name if name not in taken else next(one for one in numbered if one not in taken)
