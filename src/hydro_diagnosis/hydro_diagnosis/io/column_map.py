# SPDX-License-Identifier: Apache-2.0
"""Column map: assigns columns of a file to BenchState fields, with unit, scale, offset and delay.

::

    time=t,piston_position=pos[mm],hydraulic_force=vir*gtau,pressure_a=pa[bar]+1,load_force=p*-4.9e-4+F

Left of `=`: `time` or a BenchState field. Right: a column; its unit in brackets, if neither SI nor stated by the file;
operations `*`, `/`, `+` or `-` with numbers, named scalars or other columns of the file, as these stand in it, applied
from left to right in that unit; `@` and the column's delay (`fl@20ms`). A number alone is a constant, `none` omits the
field. A YAML file holds the same, one line per field, or the keys column, unit, scale, offset, delay.

A map without `time` extends the default map: columns named as BenchState fields, at the times that the file states.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from hydro_core.settings import SettingsError, read_yaml
from hydro_core.signals import STATE_FIELDS, FloatArray
from hydro_diagnosis.io.units import UNIT_FACTORS, known, quantity, to_si
from hydro_diagnosis.recording import InputError

_SIZE = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_NAME = r"""\s*(?:'([^']+)'|"([^"]+)"|{})\s*"""
_SOURCE = re.compile(
    _NAME.format(r"""([^\[\]*/+\-@'"]+?)""") + rf"(?:\[([^\]]*)\]\s*)?([*/+-].*?)?(?:@\s*({_SIZE})\s*(s|ms|us)\s*)?"
)
_STEP = re.compile(rf"\s*([*/+-])(?:\s*({_SIZE})\s*|" + _NAME.format(r"([A-Za-z_][\w.]*)") + ")")
_BARE_NAME = re.compile(r"""[^\[\]*/+\-@'",=#:\s{}]+""")
"""Column name that needs no quotes, neither in a short map nor in YAML."""


@dataclass(frozen=True)
class Source:
    """Source of a BenchState field: a column with unit, factor, offset and delay, or a constant."""

    column: str
    """Name in the file; empty for a constant, which is the offset."""
    unit: str = ""
    """Unit of the column, SI if empty; converted to SI behind factor and offset."""
    factor: float = 1.0
    offset: float = 0.0
    """In that unit."""
    delay: float = 0.0
    """Delay [s] of the column relative to the others: its value at time t was measured at t - delay."""
    steps: tuple[tuple[str, float | str], ...] = ()
    """Operations before factor and offset: a sign, and a number or the name of another column or a scalar."""

    @property
    def plain(self) -> bool:
        """Whether the map states nothing of the column's size, so that the file's unit applies."""
        return bool(self.column) and (self.unit, self.factor, self.offset, self.steps) == ("", 1.0, 0.0, ())

    def __str__(self) -> str:
        """Source in the syntax of a short map."""
        if not self.column:
            return f"{self.offset:g}"
        unit = f"[{self.unit}]" if self.unit else ""
        steps = "".join(f"{sign}{_quoted(by) if isinstance(by, str) else f'{by:.9g}'}" for sign, by in self.steps)
        factor = f"*{self.factor:.9g}" if self.factor != 1.0 else ""
        offset = f"{self.offset:+.9g}" if self.offset else ""
        late = f"@{self.delay * 1e3:.9g}ms" if self.delay else ""
        return f"{_quoted(self.column)}{unit}{steps}{factor}{offset}{late}"

    def of(self, columns: Mapping[str, FloatArray], constants: Mapping[str, float], length: int) -> FloatArray:
        """Values of the field in SI units: the column's, shape (n,), or of a constant, shape (length,).

        Raises InputError if the file lacks a column or scalar of the source; the message lists what it has.
        """
        if self.column and self.column not in columns:
            raise InputError(f"there is no column named {self.column!r}{_instead(self.column, columns)}")
        values = columns[self.column] if self.column else np.zeros(length)
        for sign, by in (*self.steps, ("*", self.factor), ("+", self.offset), ("*", to_si(self.unit))):
            if isinstance(by, str) and by not in constants and len(columns.get(by, ())) != len(values):
                told = "column of its times" if by in columns else "single number"
                raise InputError(f"there is no {told} named {by!r}{_instead(by, constants)}")
            other = by if not isinstance(by, str) else constants[by] if by in constants else columns[by]
            if not (isinstance(by, float) and by == (sign in "*/")):  # not by 1, nor plus 0
                values = _OPERATIONS[sign](values, other)
        return np.ascontiguousarray(values, dtype=np.float64)


_OPERATIONS = {"*": np.multiply, "/": np.divide, "+": np.add, "-": np.subtract}


def _quoted(name: str) -> str:
    sign = '"' if "'" in name else "'"
    return name if _BARE_NAME.fullmatch(name) else f"{sign}{name}{sign}"


def source_of(field: str, value: Any) -> Source:
    """Source described by an entry of a column map. Raises InputError if invalid; the message names the field."""
    if isinstance(value, bool) or value is None:
        raise InputError(f"columns: {field} = {value!r} is neither a column nor a number")
    if not isinstance(value, Mapping) and isinstance(number := _number(value), float):
        if field == "time":
            raise InputError("columns: the time cannot be a constant")
        if not isfinite(number):
            raise InputError(f"columns: {field} = {number} is not a finite number")
        return Source("", offset=number)
    column, unit, steps, delay = (_of_words if isinstance(value, Mapping) else _of_text)(field, value)
    if unit and not known(unit):
        raise InputError(
            f"columns: {field}: unit {unit!r} is unknown; there are {', '.join(UNIT_FACTORS)}, or give a factor"
        )
    wanted, unit = QUANTITY_OF.get(field, ""), known(unit)
    if unit and wanted and quantity(unit) != wanted and not any(sign in "*/" for sign, _ in steps):
        raise InputError(f"columns: {field} is a {wanted}, {unit} is a unit of {quantity(unit)}: give a factor to SI")
    factor, offset, before = 1.0, 0.0, list[tuple[str, float | str]]()
    for sign, by in steps:
        if isinstance(by, str):
            before += [("*", factor)] * (factor != 1.0) + [("+", offset)] * (offset != 0.0) + [(sign, by)]
            factor, offset = 1.0, 0.0
        elif sign in "*/":
            by = by if sign == "*" else 1.0 / by if by else np.nan
            factor, offset = factor * by, offset * by
        else:
            offset += by if sign == "+" else -by
    if not isfinite(factor) or not isfinite(offset):
        raise InputError(f"columns: {field}: its factor or offset is not a finite number")
    return Source(column, unit, factor, offset, delay, tuple(before))


_SourceParts = tuple[str, str, list[tuple[str, float | str]], float]
"""Column, unit, operations, delay [s]."""


def _of_words(field: str, words: Mapping[str, Any]) -> _SourceParts:
    unknown = [str(key) for key in words if key not in ("column", "unit", "scale", "offset", "delay")]
    if unknown or "column" not in words:
        said = f"{unknown[0]!r} is unknown" if unknown else "'column' is missing"
        raise InputError(f"columns: {field}: {said}; there are column, unit, scale, offset, delay")
    for word in ("scale", "offset", "delay"):
        number = words.get(word, 0.0)
        if number is None or isinstance(number, bool) or (word == "delay" and not isinstance(_number(number), float)):
            raise InputError(f"columns: {field}: {word} {number!r} is not a number")
    steps = [(sign, _number(words[word])) for sign, word in (("*", "scale"), ("+", "offset")) if word in words]
    return str(words["column"]), str(words.get("unit", "")), steps, float(words.get("delay", 0.0))


def _of_text(field: str, text: str) -> _SourceParts:
    found = _SOURCE.fullmatch(text)
    if found is None:
        raise InputError(
            f"columns: {field}={text} is not COLUMN[unit]*number+number@delay; quote a name with signs in it"
        )
    steps: list[tuple[str, float | str]] = []
    rest = found[5] or ""
    while rest:
        step = _STEP.match(rest)
        if step is None:
            raise InputError(f"columns: {field}={text} cannot be read from {rest!r} on")
        steps.append((step[1], float(step[2]) if step[2] else step[3] or step[4] or step[5]))
        rest = rest[step.end() :]
    delay = float(found[6]) * UNIT_FACTORS[found[7]] if found[6] else 0.0
    return (found[1] or found[2] or found[3]).strip(), found[4] or "", steps, delay


def _number(text: Any) -> float | str:
    try:
        return float(text)
    except ValueError:
        return str(text)


def _instead(name: str, there: Iterable[str]) -> str:
    names = list(there)
    close = difflib.get_close_matches(name, names, 1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    listed = ", ".join(names[:40]) + (f" and {len(names) - 40} more" if len(names) > 40 else "")
    return f"{hint}; there are {listed}" if names else "; there are none"


TARGETS = ("time", *STATE_FIELDS)
"""Targets of a column: `time` and the BenchState fields."""
QUANTITY_OF = {
    "time": "time", "hydraulic_force": "force", "load_force": "force", "pressure_a": "pressure",
    "pressure_b": "pressure", "piston_position": "length", "piston_velocity": "velocity", "valve_current": "current",
    "reference_force": "force", "hydraulic_force_rate": "force rate", "load_force_rate": "force rate",
    "nominal_valve_current": "current",
}  # fmt: skip
"""Physical quantity of each target that has one."""


@dataclass(frozen=True)
class ColumnMap:
    """Column map: sources by target, `time` or a BenchState field."""

    sources: Mapping[str, Source]
    absent: frozenset[str] = frozenset()
    """Fields that are left out though the file has columns of their names."""

    def __str__(self) -> str:
        """Map in the syntax of `--columns`."""
        left_out = [f"{field}=none" for field in sorted(self.absent)]
        return ",".join([*(f"{field}={source}" for field, source in self.sources.items()), *left_out])

    def completed(self, names: Iterable[str]) -> ColumnMap:
        """Return the map extended by the columns among `names` that are named as a target; unless it maps the time."""
        if "time" in self.sources:
            return self
        besides = {name: Source(name) for name in names if name in TARGETS and name not in self.absent}
        return ColumnMap({**besides, **self.sources}, self.absent)

    def corrections(self) -> ColumnMap:
        """Return the map without columns that have their target's name already and are used unchanged."""
        return ColumnMap({name: one for name, one in self.sources.items() if one != Source(name)}, self.absent)

    def changed(self, field: str, source: Source | None) -> ColumnMap:
        """Return the map with the source of a field replaced; None omits the field."""
        others = {name: one for name, one in self.sources.items() if name != field or source is not None}
        if source is None:
            return ColumnMap(others, self.absent | {field})
        return ColumnMap({**others, field: source}, self.absent - {field})

    @classmethod
    def load(cls, given: str | Path | Mapping[str, Any] | ColumnMap | None) -> ColumnMap | None:
        """Load a map from `FIELD=SOURCE,...`, the path of a YAML file, or a mapping; None stays None.

        Raises InputError if it cannot be read; the message names the entry, and for an unknown field the valid names.
        """
        if given is None or isinstance(given, ColumnMap):
            return given
        if isinstance(given, Mapping):
            absent = frozenset(_target(str(key)) for key, value in given.items() if value is None or value == "none")
            there = {str(key): value for key, value in given.items() if str(key) not in absent}
            return cls({_target(key): source_of(key, value) for key, value in there.items()}, absent)
        if isinstance(given, Path) or (str(given).endswith((".yaml", ".yml")) and "=" not in str(given)):
            try:
                return cls.load(read_yaml(given))
            except SettingsError as error:
                raise InputError(str(error)) from None
        parts = re.findall(r"""(?:[^,'"]|'[^']*'|"[^"]*")+""", str(given))  # at commas outside of quotes
        pairs = [part.partition("=") for part in parts if part.strip()]
        for left, equals, _ in pairs:
            if not equals:
                raise InputError(f"columns: {left.strip()!r} is not FIELD=COLUMN, for instance piston_position=pos[mm]")
        return cls.load({left.strip(): right.strip() for left, _, right in pairs})


def _target(name: str) -> str:
    if name not in TARGETS:
        close = difflib.get_close_matches(name, TARGETS, 1)
        hint = f", did you mean {close[0]!r}?" if close else f": there are {', '.join(TARGETS)}"
        raise InputError(f"columns: {name!r} is not a field of a recording{hint}")
    return name
