# SPDX-License-Identifier: Apache-2.0
"""Columns of a file: their names and units, parsed by pint and by spellings of loggers, and their sampling clocks."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import count, takewhile
from operator import eq
from typing import Any

import numpy as np

from hydro_core.signals import FloatArray

OFFERED_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "daN": 10.0, "lbf": 4.4482216152605, "kip": 4448.2216152605},
    "force rate": {"N/s": 1.0, "kN/s": 1e3},
    "pressure": {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5, "psi": 6894.757293168361,
                 "N/mm2": 1e6},
    "current": {"A": 1.0, "mA": 1e-3},
}  # fmt: skip
UNIT_FACTORS = {unit: one for units in OFFERED_UNITS.values() for unit, one in units.items()}
"""Factor to SI of the units that are offered for a field; pint, which takes a second to load, reads all others."""
_COMMON_UNITS = {unit: (quantity, one) for quantity, units in OFFERED_UNITS.items() for unit, one in units.items()}
_SI_UNITS = {
    "time": "s", "length": "m", "velocity": "m/s", "acceleration": "m/s**2", "force": "N", "force rate": "N/s",
    "pressure": "Pa", "current": "A", "voltage": "V", "temperature": "K", "flow": "m**3/s", "frequency": "1/s",
    "torque": "N*m", "mass": "kg", "power": "W", "ratio or angle": "rad",
}  # fmt: skip
_UNIT_SPELLINGS = {
    "sek": "s", "sekunden": "s", "msek": "ms", "meter": "m", "mikrometer": "um", "n": "N", "kn": "kN", "pa": "Pa",
    "kpa": "kPa", "mpa": "MPa", "a": "A", "ma": "mA", "v": "V", "amp": "A", "amps": "A", "kp": "kgf", "lbs/in2": "psi",
    "psig": "psi", "barg": "bar", "bar(g)": "bar", "kg/cm2": "kgf/cm2", "kp/cm2": "kgf/cm2", "kg/cm²": "kgf/cm2",
    "kp/cm²": "kgf/cm2", "lpm": "l/min", "gpm": "gallon/min", "hz": "Hz", "khz": "kHz", "u/min": "rpm",
    "°c": "degC", "°C": "degC", "deg c": "degC", "celsius": "degC", "c": "degC", "°f": "degF", "f": "degF",
    "°": "deg", "grad": "deg",
    "Nm": "N*m", "kNm": "kN*m", "NM": "N*m",
}  # fmt: skip
"""Spellings of loggers in pint's; lower-case keys apply to any case."""
_NO_UNIT_TEXTS = ("", "-", "--", "1", "n/a", "na", "none", "unitless", "dimensionless", "no unit")
_UNIT_PATTERN = re.compile(r"(?:1/)?[A-Za-zµμΩ°%$/*·^(][\w µμΩ°%/*·^().²³⁻¹-]{0,23}")


@cache
def _registry() -> Any:
    """Separate unit registry: the program's own may define other units, and is filled late."""
    import pint

    return pint.UnitRegistry()


@cache
def _measured(text: str) -> tuple[str, float] | None:
    """Quantity of a unit and its factor to SI, or None where pint or the bench has none."""
    if text in _COMMON_UNITS:
        return _COMMON_UNITS[text]
    if not _UNIT_PATTERN.fullmatch(text):
        return None
    units, powers = _registry(), re.sub(r"(?<=[A-Za-z])(-?[1-4])(?![\w])", r"**\1", text)
    try:
        parsed = units.parse_units(powers)
        dimensions = parsed.dimensionality
        factor = units.get_base_units(parsed, check_nonmult=False)[0]
    except Exception:  # pint raises what its parser, tokenizer and registry raise
        return None
    quantity = next((q for q, one in _SI_UNITS.items() if units.parse_units(one).dimensionality == dimensions), "")
    return (quantity, float(f"{factor:.15g}")) if quantity else None


@cache
def known(text: str) -> str:
    """Return a unit in pint's spelling; empty if it measures no quantity of a bench. `mPa` is kept, `MPA` is MPa."""
    bare = text.strip().strip('[]{}"').strip()
    bare = bare[1:-1].strip() if bare[:1] == "(" and bare[-1:] == ")" else bare
    bare = bare.rstrip(".")
    lower = bare.lower()
    if lower in _NO_UNIT_TEXTS:
        return ""
    tried = (_UNIT_SPELLINGS.get(bare, ""), bare, _UNIT_SPELLINGS.get(lower, ""), lower)
    return next((one for one in tried if one and _measured(one)), "")


def stated(text: str) -> str:
    """Unit stated by a text: in pint's spelling if known, else the text itself; empty for none or dimensionless."""
    bare = text.strip().strip('[]"').strip()
    return known(text) or ("" if bare.lower() in _NO_UNIT_TEXTS else bare)


def quantity(unit: str) -> str:
    """Physical quantity measured by a unit; empty if the unit is unknown."""
    found = _measured(known(unit)) if unit else None
    return found[0] if found else ""


def to_si(unit: str) -> float:
    """Factor from a unit to SI; 1 for an empty unit. Raises KeyError if the unit is unknown."""
    if not unit:
        return 1.0
    found = _measured(known(unit))
    if found is None:
        raise KeyError(unit)
    return found[1]


_BRACKETED_UNIT = re.compile(r"\s*(?:\[\s*([^\]]{1,16})\s*\]|\(\s*([^)]{1,16})\s*\))\s*$")
_TRAILING_UNIT = re.compile(r"(?:\s+in\s+|\s*/\s*)([A-Za-zµ°%][\w°²]{0,6})$")
_SIMPLE_UNITS = (
    r"s|ms|us|ns|min|m|mm|cm|um|in|inch|ft|[mukM]?N|daN|lbf|lbs?|kip|kgf|kg|[hkM]?Pa|m?bar|psi|ksi|[mu]?A|m?V|rad|mrad|"
    r"deg|degC|degF|k?Hz|rpm|lpm|l|L|k?Nm"
)
_UNIT_SUFFIX = re.compile(rf"_({_SIMPLE_UNITS})(?:_(?:per_)?(s2|s|min|mm2|m2|cm2))?$")
_SUFFIX_COLUMNS = {
    "s": r"t|time\w*|\w*zeit|stamp|elapsed|clock", "min": r"t|time\w*|\w*zeit|elapsed",
    "m": r"[xyzsq]|x_?p|pos\w*|\w*weg\w*|hub|stroke|disp\w*|way|travel|length|lvdt",
    "in": r"[xyzsq]|pos\w*|stroke|disp\w*|travel|length|lvdt",
    "A": r"i|i_?v\w*|\w*current|cur|\w*strom", "V": r"u|\w*volt\w*|cmd\w*|command|control|signal|spannung",
    "l": r"vol\w*", "L": r"vol\w*", "a": r"i|\w*current|cur|\w*strom", "b": "",
}  # fmt: skip
"""Suffixes that are more often a chamber, a port or a limit than a unit, with the words next to which they are units.
"""


def _fits(name: str, unit: str) -> bool:
    words = re.split(r"[\W_]+", name)
    return unit not in _SUFFIX_COLUMNS or any(
        re.fullmatch(_SUFFIX_COLUMNS[unit], word, re.IGNORECASE) for word in words if word
    )


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without the unit at its end, and that unit: `pos [mm]`, `pos_mm`, `vel_mm_s`, `p / bar`.

    Text in square brackets is a unit even if unknown, text elsewhere only if known.
    """
    if found := _BRACKETED_UNIT.search(name):
        own, round_ = name[: found.start()].strip(), found[2] or ""
        unit = stated(found[1]) if found[1] else known(round_) if round_ not in "AaBb" or _fits(own, round_) else ""
        return (own or name, unit) if unit or found[1] else (name, "")
    if (found := _TRAILING_UNIT.search(name)) and known(found[1]) in (*UNIT_FACTORS, "V"):
        own = name[: found.start()].strip()
        return (own, known(found[1])) if own and _fits(own, found[1]) else (name, "")
    if found := _UNIT_SUFFIX.search(name):
        own, over = name[: found.start()], found[2]
        unit = known(f"{found[1]}/{over}" if over else found[1])
        return (own, unit) if own and unit and (over or _fits(own, found[1])) else (name, "")
    return name, ""


# --- columns -------------------------------------------------------------------------------------------------------

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
        found.notes.append(f"words stand among its numbers {joined} times: the parts were joined by their times")
    if again:
        found.notes.append(f"the time begins again, {again + 1} times: give each part as a file of its own")
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
