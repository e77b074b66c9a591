# SPDX-License-Identifier: Apache-2.0
"""Header of a text table: names, units, and number of lines.

Three shapes are read. A row of names, with a row of units below it or units in brackets behind the names. Rows that
begin with a key, as ControlDesk writes them: `path;...`, `unit;...`, then `trace_values;` before the first row of
numbers and an empty cell before the others. Lines of anything else above either. Without names, columns are numbered.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass

from hydro_diagnosis.formats.units import in_name, known

NAME_KEYS = ("name", "names", "trace_name", "signal", "signals", "channel", "label", "path", "variable", "bezeichnung")
"""First cells of rows that hold names, the best first."""
UNIT_KEYS = ("unit", "units", "einheit", "einheiten")
"""First cells of rows that hold units."""
_NUMBER = re.compile(r"[+-]?(\d+([.]\d*)?|[.]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
_FOLLOWING = 4
"""Rows below the first that must be numbers too."""


@dataclass(frozen=True)
class Header:
    """Header above a block of numbers."""

    length: int
    """Lines before the first row of numbers."""
    lead: int
    """Cells before the first number of a row: 1 where the rows begin with a key."""
    names: tuple[str, ...]
    """Names of the columns, each unique."""
    units: tuple[str, ...]
    """Units as `units.UNITS` spells them; empty where none is stated."""


def header_of(lines: list[str], separator: str, decimal: str) -> Header:
    """Header of a block that begins with `lines`.

    Raises
    ------
    ValueError
        If no row of numbers is among them.
    """
    rows = list(csv.reader([line.replace("\0", "") for line in lines], delimiter=separator, skipinitialspace=True))
    rows = [[cell.strip() for cell in row] for row in rows]
    first = next((k for k in range(len(rows)) if _numbers_begin(rows, k, decimal)), None)
    if first is None:
        raise ValueError("there is no row of numbers in it")
    lead = 1 if rows[first] and rows[first][0] and not _is_number(rows[first][0], decimal) and _led(rows, first) else 0
    body = rows[first][lead:]
    width = len(body) - (1 if len(body) > 2 and body[-1] == "" and _ends_empty(rows[first:]) else 0)
    above = rows[:first]
    names, units = _keyed(above, width) if lead else _plain(above, width, decimal)
    stated = tuple(known(unit) or in_name(name) for name, unit in zip(names, units, strict=True))
    return Header(first, lead, _distinct(names), stated)


def numeric_cells(line: str, separator: str, decimal: str) -> int:
    """Number of numeric cells in a line; 0 where there are fewer than two."""
    cells = next(iter(csv.reader([line.replace("\0", "")], delimiter=separator)), [])
    count = sum(_is_number(cell.strip(), decimal) for cell in cells)
    return count if len(cells) > 1 else 0


def _is_number(cell: str, decimal: str) -> bool:
    plain = cell.replace(",", ".") if decimal == "," and "." not in cell else cell
    return _NUMBER.fullmatch(plain) is not None


def _numbers_begin(rows: list[list[str]], at: int, decimal: str) -> bool:
    """Return whether this row and those below are numbers; only its own first cell may be a key."""
    below = [row for row in rows[at + 1 : at + 1 + _FOLLOWING] if any(row)]
    keyed = bool(rows[at]) and bool(rows[at][0]) and not _is_number(rows[at][0], decimal) and _led(rows, at)
    here = rows[at][1:] if keyed else rows[at]
    return _mostly_numbers(here, decimal) and all(_mostly_numbers(row, decimal) for row in below)


def _led(rows: list[list[str]], at: int) -> bool:
    """Return whether the rows below begin with an empty cell, the first of them at least."""
    return at + 1 >= len(rows) or not rows[at + 1] or rows[at + 1][0] == ""


def _mostly_numbers(row: list[str], decimal: str) -> bool:
    cells = [cell for cell in row if cell]
    numbers = sum(_is_number(cell, decimal) for cell in cells)
    return len(row) > 1 and numbers > 0 and 2 * numbers > len(cells)


def _ends_empty(rows: list[list[str]]) -> bool:
    """Return whether rows end with a separator behind which nothing stands."""
    return all(not row or row[-1] == "" for row in rows)


def _keyed(above: list[list[str]], width: int) -> tuple[list[str], list[str]]:
    rows = {row[0].lower().strip("[]:"): row[1 : width + 1] for row in above if row and row[0]}
    names = next((rows[key] for key in NAME_KEYS if any(rows.get(key, ()))), [])
    units = next((rows[key] for key in UNIT_KEYS if any(rows.get(key, ()))), [])
    names = [name or "time" for name in [*names, *[""] * (width - len(names))]] if names else names
    return _filled(names, width), [*units, *[""] * (width - len(units))]


def _plain(above: list[list[str]], width: int, decimal: str) -> tuple[list[str], list[str]]:
    """The last row as wide as the numbers that is not one of units, and below it the row of units if there is one."""
    wide = [row for row in above if any(row) and width <= len(row) <= width + 1]
    units = wide.pop() if wide and len(wide) > 1 and _are_units(wide[-1]) else []
    names = wide[-1] if wide else []
    return _filled(names[:width], width), [*units[:width], *[""] * (width - len(units))]


def _are_units(row: list[str]) -> bool:
    """Return whether a row holds units: most are known, or all stand in brackets."""
    cells = [cell for cell in row if cell and cell not in ("-", "[-]")]
    bracketed = all(cell[0] in "[(" and cell[-1] in "])" for cell in cells)
    return not cells or bracketed or 2 * sum(bool(known(cell)) for cell in cells) > len(cells)


def _filled(names: list[str], width: int) -> list[str]:
    names = [*names, *[""] * (width - len(names))]
    return [name.lstrip("#% ") or f"column {k}" for k, name in enumerate(names)]


def _distinct(names: list[str]) -> tuple[str, ...]:
    found: list[str] = []
    for name in names:
        number = 2
        chosen = name
        while chosen in found:
            chosen, number = f"{name}.{number}", number + 1
        found.append(chosen)
    return tuple(found)
