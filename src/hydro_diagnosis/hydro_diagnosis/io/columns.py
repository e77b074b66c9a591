# SPDX-License-Identifier: Apache-2.0
"""Contents of a file: columns by name, their units, and their sampling clocks."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hydro_bridge.bags.recording import Extent
from hydro_core.signals import FloatArray

_BY_QUANTITY: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "daN": 10.0, "lbf": 4.4482216152605},
    "force rate": {"N/s": 1.0, "kN/s": 1e3},
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5, "psi": 6894.757293168361,
        "N/mm2": 1e6,
    },
    "current": {"A": 1.0, "mA": 1e-3},
}  # fmt: skip

UNITS = {unit: factor for units in _BY_QUANTITY.values() for unit, factor in units.items()}
"""Factor from a unit to SI."""
_OTHERS = {"degC": "temperature", "degF": "temperature", "l/min": "flow", "rpm": "speed of rotation", "Hz": "frequency"}
QUANTITY = {unit: quantity for quantity, units in _BY_QUANTITY.items() for unit in units} | _OTHERS
"""Quantity that a unit measures; those that no field is have no factor in `UNITS`."""

_SPELLINGS = {
    "sec": "s", "second": "s", "seconds": "s", "sek": "s", "msec": "ms", "µs": "us", "μs": "us", "µm": "um", "μm": "um",
    "mikrometer": "um", "meter": "m", "metre": "m", "newton": "N", "pascal": "Pa", "ampere": "A", "amp": "A",
    "n": "N", "kn": "kN", "pa": "Pa", "kpa": "kPa", "mpa": "MPa", "a": "A", "ma": "mA",
    "n/mm²": "N/mm2", "n/mm^2": "N/mm2",
    "m*s^-1": "m/s", "m s-1": "m/s", "inch": "in",
    "°c": "degC", "degc": "degC", "deg c": "degC", "celsius": "degC", "°f": "degF", "lpm": "l/min", "hz": "Hz",
}  # fmt: skip
_IN_NAME = re.compile(r"[\[(]\s*([^\])]{1,12})\s*[\])]\s*$")
_SUFFIX = re.compile(r"_(s|ms|us|ns|mm|cm|um|N|kN|kPa|MPa|mbar|bar|psi|mA)$")
"""Units behind an underscore; `_a`, `_m`, `_A` are more often chambers and what was measured."""


def known(text: str) -> str:
    """The unit as `QUANTITY` spells it; empty where it is none of these."""
    bare = text.strip().strip("[](){}").strip()
    if bare in QUANTITY:
        return bare
    return _SPELLINGS.get(bare.lower(), bare.lower() if bare.lower() in QUANTITY else "")


def in_name(name: str) -> str:
    """The unit at the end of a column's name (`pos [mm]`, `pos_mm`), as `QUANTITY` spells it, or empty."""
    found = _IN_NAME.search(name)
    suffix = _SUFFIX.search(name)
    return known(found[1]) if found else suffix[1] if suffix else ""


def without_unit(name: str) -> str:
    """A column's name without the unit at its end."""
    return _SUFFIX.sub("", _IN_NAME.sub("", name)).strip()


_TIME = re.compile(
    r"^(.*[./\\ _-])?(time|t|\w*zeit|timestamp|timestamps|x-?axis|x_value|elapsed)(\.\d+)?$", re.IGNORECASE
)


@dataclass(frozen=True)
class Columns:
    """Columns and single numbers of a file."""

    series: dict[str, FloatArray] = field(default_factory=dict)
    """Columns by name, each of shape (n,); n may differ between clocks."""
    constants: dict[str, float] = field(default_factory=dict)
    """Single numbers by name (of .mat and HDF5 files)."""
    other: list[str] = field(default_factory=list)
    """Names of what is neither: texts, columns of another length."""
    units: dict[str, str] = field(default_factory=dict)
    """Units that the file states, as `QUANTITY` spells them; only those that are known."""
    clocks: dict[str, str] = field(default_factory=dict)
    """By column, the name of the column that holds its times; none for a table in which every row is one instant."""
    notes: list[str] = field(default_factory=list)
    """Notes on these times, one sentence each."""
    extents: Mapping[str, Extent] = field(default_factory=dict)
    """By column of which `series` holds every n-th number: what is known of all."""

    def add(self, name: str, values: FloatArray, unit: str = "") -> str:
        """Add a column in a unit as the file states it; returns its name, with a number behind it if it was taken."""
        column = unique(name, self.series)
        self.series[column] = values
        if known(unit):
            self.units[column] = known(unit)
        return column

    def unit(self, name: str) -> str:
        """Unit of a column, as the file states it or by the column's name; empty if neither tells."""
        return self.units.get(name) or in_name(name)


def named_like_time(name: str) -> bool:
    """Return whether a column's name says that it is the time."""
    return _TIME.match(without_unit(name)) is not None


def runs_forward(values: FloatArray) -> bool:
    """Return whether the numbers grow from each row to the next but for rare exceptions, as times do."""
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 0 and float(np.mean(steps > 0.0)) > 0.9


def assign_clocks_of_equal_length(found: Columns) -> None:
    """Assign clocks to columns of several lengths: the one column of times of the same length.

    The time beside a column, in the same struct or group, comes before one elsewhere. Columns of one length need no
    clock; of several lengths, the longest does without, and what has neither is listed under `other`.
    """
    series, clocks = found.series, found.clocks
    lengths = {len(values) for values in series.values()}
    if len(lengths) <= 1:
        return
    times = [name for name, values in series.items() if named_like_time(name) and runs_forward(values)]
    longest = max(lengths)
    for name, values in [*series.items()]:
        alike = [time for time in times if len(series[time]) == len(values)]
        if alike:
            clocks[name] = max(alike, key=lambda time: _kinship(time, name))
        elif len(values) != longest:
            found.other.append(name)
            del series[name]
    if len({clocks.get(name) for name in series}) == 1:
        clocks.clear()


def _kinship(one: str, other: str) -> int:
    """Number of leading parts that two dotted names share."""
    parts = zip(one.split(".")[:-1], other.split(".")[:-1], strict=False)
    count = 0
    for mine, yours in parts:
        if mine != yours:
            break
        count += 1
    return count


def unique(name: str, taken: Mapping[str, object]) -> str:
    """The name, or with a number behind it if it is taken: `time`, `time.2`, `time.3`."""
    if name not in taken:
        return name
    number = 2
    while f"{name}.{number}" in taken:
        number += 1
    return f"{name}.{number}"
