# SPDX-License-Identifier: Apache-2.0
"""A column map: which column of somebody's file is which BenchState field, in which unit, and turned by what.

::

    time=t,piston_position=pos[mm],hydraulic_force=vir*gtau,pressure_a=pa[bar]+1,load_force=0

On the left `time` or a BenchState field; on the right a column, its unit in brackets if it is not SI, then `*`, `/`,
`+` or `-` with a number or the name of a single number in the file, taken from left to right and in that unit. A number
alone is a constant. A YAML file holds the same, one line each, or the words column, unit, scale, offset.
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
import yaml

from hydro_bridge.signals import STATE_FIELDS
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.recording import InputError

TARGETS = ("time", *STATE_FIELDS)
"""What a column can become."""
UNITS = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
    "m": 1.0, "mm": 1e-3, "um": 1e-6, "m/s": 1.0, "mm/s": 1e-3,
    "N": 1.0, "kN": 1e3, "N/s": 1.0, "kN/s": 1e3,
    "Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "psi": 6894.757293168361,
    "A": 1.0, "mA": 1e-3,
}  # fmt: skip
"""SI over unit."""
_SOURCE = re.compile(
    r"""\s*(?:'(?P<single>[^']+)'|"(?P<double>[^"]+)"|(?P<bare>[^\[\]*/+\-'"]+?))\s*(?P<rest>[\[*/+\-].*)?"""
)
_STEP = re.compile(r"\s*(?P<sign>[*/+\-])\s*(?P<value>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_][\w.]*)\s*")
_UNIT = re.compile(r"\s*\[(?P<unit>[^\]]*)\]\s*")


@dataclass(frozen=True)
class Source:
    """Where a field comes from."""

    column: str
    """Name in the file; empty for a constant."""
    steps: tuple[tuple[str, float | str], ...] = ()
    """Sign (*, /, +, -) and number, or the name of a single number in the file; in this order."""

    def of(self, columns: Mapping[str, FloatArray], constants: Mapping[str, float], length: int) -> FloatArray:
        """The field in SI units, shape (length,).

        Raises
        ------
        InputError
            If the file lacks the column or a number that the steps name; the sentence lists what there is.
        """
        if not self.column:
            values: FloatArray = np.zeros(length)
        elif self.column in columns:
            values = columns[self.column]
        else:
            raise InputError(f"there is no column named {self.column!r}{_instead(self.column, columns)}")
        for sign, number in self.steps:
            if isinstance(number, str) and number not in constants:
                raise InputError(f"there is no single number named {number!r}{_instead(number, constants)}")
            by = constants[number] if isinstance(number, str) else number
            values = _OPERATIONS[sign](values, by)
        return np.ascontiguousarray(values, dtype=np.float64)


@dataclass(frozen=True)
class ColumnMap:
    """Sources by `time` and BenchState field name."""

    sources: Mapping[str, Source]

    @classmethod
    def load(cls, given: str | Path | Mapping[str, Any] | ColumnMap | None) -> ColumnMap | None:
        """From `FIELD=SOURCE,...`, the path of a YAML file, or a mapping; None stays None.

        Raises
        ------
        InputError
            In one sentence that names what cannot be read, and for a field the names that there are.
        """
        if given is None or isinstance(given, ColumnMap):
            return given
        if isinstance(given, Mapping):
            return cls({_target(str(key)): _source(str(key), value) for key, value in given.items()})
        if isinstance(given, Path) or (str(given).endswith((".yaml", ".yml")) and "=" not in str(given)):
            return cls.load(_from_yaml(Path(given)))
        pairs = [part.partition("=") for part in _parts(str(given))]
        for left, equals, _ in pairs:
            if not equals:
                raise InputError(f"columns: {left.strip()!r} is not FIELD=COLUMN, for instance piston_position=pos[mm]")
        return cls.load({left.strip(): right.strip() for left, _, right in pairs})


def known_as_they_are(names: Iterable[str]) -> ColumnMap:
    """The map of a file whose columns carry the fields' own names."""
    return ColumnMap({name: Source(name) for name in names if name in TARGETS})


def _target(name: str) -> str:
    if name not in TARGETS:
        close = difflib.get_close_matches(name, TARGETS, 1)
        hint = f", did you mean {close[0]!r}?" if close else f": there are {', '.join(TARGETS)}"
        raise InputError(f"columns: {name!r} is no field of a recording{hint}")
    return name


def _source(field: str, value: Any) -> Source:
    if isinstance(value, bool) or value is None:
        raise InputError(f"columns: {field} = {value!r} is neither a column nor a number")
    if isinstance(value, (int, float)):
        return _constant(field, float(value))
    if isinstance(value, Mapping):
        return _from_words(field, value)
    number = _number(value)
    return _constant(field, number) if isinstance(number, float) else _parsed(field, number)


def _constant(field: str, value: float) -> Source:
    if field == "time":
        raise InputError("columns: the time cannot be a constant")
    if not isfinite(value):
        raise InputError(f"columns: {field} = {value} is not a finite number")
    return Source("", (("+", value),))


def _from_words(field: str, words: Mapping[str, Any]) -> Source:
    unknown = [str(key) for key in words if key not in ("column", "unit", "scale", "offset")]
    if unknown or "column" not in words:
        said = f"{unknown[0]!r} is unknown" if unknown else "'column' is missing"
        raise InputError(f"columns: {field}: {said}; there are column, unit, scale, offset")
    steps: list[tuple[str, float | str]] = []
    for sign, word in (("*", "scale"), ("+", "offset")):
        if word in words:
            steps.append((sign, _number(words[word])))
    if "unit" in words:
        steps.append(("*", _unit(field, str(words["unit"]))))
    return Source(str(words["column"]), tuple(steps))


def _parsed(field: str, text: str) -> Source:
    found = _SOURCE.fullmatch(text)
    if found is None:
        raise InputError(f"columns: {field}={text} is not COLUMN[unit]*number+number; quote a name with signs in it")
    column = next(name for name in (found["single"], found["double"], found["bare"]) if name is not None)
    steps: list[tuple[str, float | str]] = []
    rest = found["rest"] or ""
    unit = _UNIT.match(rest)
    rest = rest[unit.end() :] if unit else rest
    while rest:
        step = _STEP.match(rest)
        if step is None:
            raise InputError(f"columns: {field}={text} cannot be read from {rest!r} on")
        steps.append((step["sign"], _number(step["value"])))
        rest = rest[step.end() :]
    if unit:
        steps.append(("*", _unit(field, unit["unit"])))
    return Source(column.strip(), tuple(steps))


def _number(text: Any) -> float | str:
    try:
        return float(text)
    except ValueError:
        return str(text)


def _unit(field: str, unit: str) -> float:
    if unit not in UNITS:
        raise InputError(f"columns: {field}: unit {unit!r} is unknown; there are {', '.join(UNITS)}, or give a factor")
    return UNITS[unit]


def _parts(text: str) -> list[str]:
    """Split at commas outside of quotes."""
    parts = re.findall(r"""(?:[^,'"]|'[^']*'|"[^"]*")+""", text)
    return [part for part in parts if part.strip()]


def _from_yaml(path: Path) -> Mapping[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    except yaml.YAMLError as error:
        raise InputError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: a column map is a mapping of fields to columns")
    return content


def _instead(name: str, there: Iterable[str]) -> str:
    names = list(there)
    close = difflib.get_close_matches(name, names, 1)
    hint = f", did you mean {close[0]!r}?" if close else ""
    listed = ", ".join(names[:40]) + (f" and {len(names) - 40} more" if len(names) > 40 else "")
    return f"{hint}; there are {listed}" if names else "; there are none"


_OPERATIONS = {
    "*": lambda values, by: values * by,
    "/": lambda values, by: values / by,
    "+": lambda values, by: values + by,
    "-": lambda values, by: values - by,
}
