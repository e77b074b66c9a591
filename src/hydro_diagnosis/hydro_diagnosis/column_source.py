# SPDX-License-Identifier: Apache-2.0
"""One entry of a column map: where a field comes from, as text, as words or as a number (`columns` says how)."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.recording import InputError

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


def source_of(field: str, value: Any) -> Source:
    """The source that an entry of a map describes.

    Raises
    ------
    InputError
        In one sentence that names the field.
    """
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


def _instead(name: str, there: Iterable[str]) -> str:
    names = list(there)
    close = difflib.get_close_matches(name, names, 1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    listed = ", ".join(names[:40]) + (f" and {len(names) - 40} more" if len(names) > 40 else "")
    return f"{hint}; there are {listed}" if names else "; there are none"


_OPERATIONS = {
    "*": lambda values, by: values * by,
    "/": lambda values, by: values / by,
    "+": lambda values, by: values + by,
    "-": lambda values, by: values - by,
}
