# SPDX-License-Identifier: Apache-2.0
"""Text tables of any logger: encoding, separator, decimal sign, headers and blocks are detected.

dSPACE ControlDesk, TwinCAT Scope, LabVIEW and others put a header of key and values above the numbers, names and units
in rows of their own, one column of times per raster or one block below the other; spreadsheets of half of Europe write
decimal commas.

Four shapes of header are read: a row of names, with a row of units by it or units in brackets behind the names; rows
that begin with a key, as ControlDesk writes them (`trace_names;...`, `path;...`, `unit;...`, then `trace_values;`
before the first row of numbers and an empty cell before the others); rows that repeat their key before the channels of
each clock, as TwinCAT Scope writes them (`Name;fPos;Name;fForce`, then ms and values); lines of anything else above
either. Without names, columns are numbered. LabVIEW's step `Delta_X` makes the times where no column is one.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import Columns, in_name, known, named_like_time, runs_forward, unique

NAME_KEYS = (
    "name", "names", "trace_name", "trace_names", "displayidentifier", "signal", "signals", "channel", "label", "path",
    "variable", "bezeichnung", "symbolname",
)  # fmt: skip
"""First cells of rows that hold names, the best first: those in which names differ come before."""
UNIT_KEYS = ("unit", "units", "trace_units", "einheit", "einheiten", "y_unit_label")
"""First cells of rows that hold units."""
FIRST_NUMBERS = "trace_values"
"""ControlDesk's key of the first row of numbers: rows above it may hold numbers too (flags, limits)."""
_NUMBER = re.compile(r"[+-]?(\d+([.]\d*)?|[.]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
_CLOCK = r"(?<!\d)(\d{1,2}):(\d\d):(\d\d(?:[.]\d+)?)(?:\s*([ap])\.?m\b)?"
"""Time of day in a cell, its decimal sign a point; of 12 hours with am or pm."""
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
    """Units as `columns.QUANTITY` spells them; empty where none is stated."""
    step: float
    """s from row to row, where the header states it; else 0."""


def header_of(lines: list[str], separator: str, decimal: str) -> Header:
    """Header of a block that begins with `lines`. Raises ValueError if no row of numbers is among them."""
    rows = list(csv.reader([line.replace("\0", "") for line in lines], delimiter=separator, skipinitialspace=True))
    rows = [[cell.strip() for cell in row] for row in rows]
    marked = (k for k, row in enumerate(rows) if row and row[0].lower() == FIRST_NUMBERS)
    first = next(marked, None)
    if first is None:
        first = next((k for k in range(len(rows)) if _numbers_begin(rows, k, decimal)), None)
    if first is None:
        raise ValueError("there is no row of numbers in it")
    lead = 1 if rows[first] and rows[first][0] and not _is_number(rows[first][0], decimal) and _led(rows, first) else 0
    body = rows[first][lead:]
    width = len(body) - (1 if len(body) > 2 and body[-1] == "" and _ends_empty(rows[first:]) else 0)
    above = [row for row in rows[:first] if any(row)]
    grouped = _by_clock(above)
    names, units = _keyed(grouped or above, width) if lead or grouped else _plain(above, width)
    stated = tuple(known(unit) or in_name(name) for name, unit in zip(names, units, strict=True))
    steps = [row[1] for row in above if row[0].lower() == "delta_x" and len(row) > 1 and _is_number(row[1], decimal)]
    step = float(steps[0].replace(decimal, ".")) if steps else 0.0
    return Header(first, lead, _distinct(names), stated, step)


def _by_clock(above: list[list[str]]) -> list[list[str]]:
    """Rows that repeat their key above each clock, with the key in front and nothing or ms in its place; else none."""
    if not any(row[0].lower() in NAME_KEYS and row[0] in row[1:] for row in above):
        return []
    clock = dict.fromkeys(UNIT_KEYS, "ms")
    return [[row[0], *(clock.get(row[0].lower(), "") if cell == row[0] else cell for cell in row)] for row in above]


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
    return at + 1 >= len(rows) or rows[at + 1][:1] == [""]


def _mostly_numbers(row: list[str], decimal: str) -> bool:
    cells = [cell for cell in row if cell]
    numbers = sum(_is_number(cell, decimal) for cell in cells)
    return len(row) > 1 and numbers > 0 and 2 * numbers > len(cells)


def _ends_empty(rows: list[list[str]]) -> bool:
    """Return whether rows end with a separator behind which nothing stands."""
    return all(not row or row[-1] == "" for row in rows)


def _keyed(above: list[list[str]], width: int) -> tuple[list[str], list[str]]:
    rows = {row[0].lower().strip("[]:"): row[1 : width + 1] for row in above if row[0]}
    there = [rows[key] for key in NAME_KEYS if any(rows.get(key, ()))]
    names = max(there, key=lambda names: len(set(names)), default=[])
    units = next((rows[key] for key in UNIT_KEYS if any(rows.get(key, ()))), [])
    names = [name or "time" for name in [*names, *[""] * (width - len(names))]] if names else names
    return _filled_cells(names, width), [*units, *[""] * (width - len(units))]


def _plain(above: list[list[str]], width: int) -> tuple[list[str], list[str]]:
    """Of the rows as wide as the numbers the last in which most cells differ, and the last of units if there is one."""
    wide = [row for row in reversed(above) if width <= len(row) <= width + 1]
    units = next(filter(_are_units, wide), []) if len(wide) > 1 else []
    names = max((row for row in wide if row is not units), key=lambda row: len(set(row)), default=[])
    return _filled_cells(names[:width], width), [*units[:width], *[""] * (width - len(units))]


def _are_units(row: list[str]) -> bool:
    """Return whether a row holds units: most are known, or all stand in brackets."""
    cells = [cell for cell in row if cell and cell not in ("-", "[-]")]
    bracketed = all(cell[0] in "[(" and cell[-1] in "])" for cell in cells)
    return not cells or bracketed or 2 * sum(bool(known(cell)) for cell in cells) > len(cells)


def _filled_cells(names: list[str], width: int) -> list[str]:
    names = [*names, *[""] * (width - len(names))]
    return [name.lstrip("#% ") or f"column {k}" for k, name in enumerate(names)]


def _distinct(names: list[str]) -> tuple[str, ...]:
    found: dict[str, None] = {}
    for name in names:
        found[unique(name, found)] = None
    return tuple(found)


_HEAD = 1 << 16
"""Bytes inspected to detect a file's format."""
_SEPARATORS = (";", "\t", ",")
_TEXT = re.compile(r"^[\s\"]*(?!nan\b|inf\b)[A-Za-z_\[#%]", re.IGNORECASE)
"""A line that begins with a word: what stands above a block of numbers."""


def delimited_columns(path: Path) -> Columns:
    """Read a table of text. Raises ValueError, OSError, pandas.errors.EmptyDataError if it cannot be read."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not head.strip():
        raise pd.errors.EmptyDataError(str(path))
    if head.lstrip()[:1] == b"<":
        raise ValueError("it is a web page or XML, not a table")
    encoding = _encoding(head)
    text = head.decode(encoding, errors="replace")
    separator, decimal = _style(text.splitlines()[:-1] if len(head) == _HEAD else text.splitlines())
    blocks, notes = _joined(_blocks(path, encoding, separator, decimal))
    found = Columns(notes=notes)
    for header, frame in blocks:
        _take(header, frame, found)
    if len({len(values) for values in found.series.values()}) == 1 and len(set(found.clocks.values())) <= 1:
        found.clocks.clear()
    return found


def _joined(blocks: Iterable[tuple[Header, pd.DataFrame]]) -> tuple[list[tuple[Header, pd.DataFrame]], list[str]]:
    """Blocks, those put together whose header is the same, or without names, while the time goes on; and notes."""
    found: list[tuple[Header, pd.DataFrame]] = []
    joined = again = 0
    for header, frame in blocks:
        before, above = found[-1] if found else (header, frame)
        alike = header.names in (before.names, tuple(_filled_cells([], len(before.names))))
        if found and alike and _goes_on(before.names, above, frame):
            found[-1] = before, pd.concat([above, frame], ignore_index=True)
            joined += 1
            continue
        again += bool(found) and alike
        found.append((header, frame))
    notes = []
    if joined:
        times = "once" if joined == 1 else f"{joined} times"
        notes.append(f"a header or other words stand among the numbers {times}: what follows was joined to them")
    if again:
        notes.append(
            f"its header comes {again + 1} times and the time begins again: the later parts are columns of their own "
            "and a map takes one part only; give each part as a file of its own"
        )
    return found, notes


def _goes_on(names: tuple[str, ...], above: pd.DataFrame, below: pd.DataFrame) -> bool:
    """Return whether the times of one block follow those of another: of the column named so, else of the first."""
    time = next((k for k, name in enumerate(names) if named_like_time(name)), 0)
    parts = [frame[time].to_numpy(dtype=np.float64) for frame in (above, below)]
    last, first = parts[0][np.isfinite(parts[0])], parts[1][np.isfinite(parts[1])]
    return len(last) > 1 and len(first) > 0 and runs_forward(last) and first[0] >= last[-1]


def _encoding(head: bytes) -> str:
    """Encoding by the byte order mark; without one UTF-8 if valid, else a code page of Windows.

    That of Western Europe, or that of Korea where bytes beyond ASCII come in pairs.
    """
    marks = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
    for mark, encoding in marks.items():
        if head.startswith(mark):
            return encoding
    if head[1::2].count(0) > len(head) // 4:
        return "utf-16-le"
    for cut in range(4):  # a character may be cut in two where the head ends
        try:
            head[: len(head) - cut].decode("utf-8")
        except UnicodeDecodeError:
            continue
        return "utf-8"
    return "cp1252" if any(len(run) % 2 for run in re.findall(rb"[\x80-\xff]+", head[:-1])) else "cp949"


def _style(lines: list[str]) -> tuple[str, str]:
    """Separator and decimal sign: those by which the most cells of the last lines are numbers."""
    last = [line for line in lines[-200:] if line.strip()]
    counts = {
        (separator, decimal): sum(numeric_cells(line, separator, decimal) for line in last)
        for decimal in (".", ",")
        for separator in _SEPARATORS
    }
    best = max(counts, key=lambda style: counts[style])
    return best if counts[best] else (",", ".")


def _blocks(path: Path, encoding: str, separator: str, decimal: str) -> Iterator[tuple[Header, pd.DataFrame]]:
    """Headers with their numbers; most files are one such block, read by pandas in one go."""
    lines: list[str] = []
    with path.open(encoding=encoding, errors="replace") as file:
        for line in file:
            lines.append(line.rstrip("\r\n"))
            if len(lines) > 400:
                break
    header = header_of(lines, separator, decimal)
    try:
        with path.open(encoding=encoding, errors="replace") as file:
            yield header, _numbers(file, header, separator, decimal)
            return
    except (ValueError, pd.errors.ParserError):
        pass
    rest = path.read_text(encoding=encoding, errors="replace").splitlines()
    some = False
    while rest:
        try:
            header = header_of(rest[:400], separator, decimal)
        except ValueError:
            if some:
                return  # words below the last number
            raise
        some = True
        end = next((k for k in range(header.length + 1, len(rest)) if _TEXT.match(rest[k])), len(rest))
        yield header, _numbers(StringIO("\n".join(rest[:end])), header, separator, decimal, strict=False)
        rest = rest[end:]


def _numbers(source: object, header: Header, separator: str, decimal: str, *, strict: bool = True) -> pd.DataFrame:
    """The block's numbers; if `strict`, a header among them is a ValueError: a new block begins there."""
    width = len(header.names) + header.lead
    frame = pd.read_csv(
        source, sep=separator, decimal=decimal, header=None, names=range(width), usecols=range(header.lead, width),
        index_col=False, skiprows=header.length, skipinitialspace=True, skip_blank_lines=True, low_memory=False,
        float_precision="round_trip" if decimal == "." else "high",
    )  # fmt: skip
    if not len(frame):
        raise pd.errors.EmptyDataError("no rows")
    if decimal == ",":  # a column with a word in it was not converted
        texts_there = frame.select_dtypes("object").columns
        frame[texts_there] = frame[texts_there].apply(lambda column: column.str.replace(",", ".", regex=False))
    numbers = frame.apply(pd.to_numeric, errors="coerce")
    broken = frame.notna() & numbers.isna()
    texts = [column for column in frame if broken[column].all() or not numbers[column].notna().any()]
    if strict and broken.drop(columns=texts).to_numpy().any() and _holds_headers(frame[broken.any(axis=1)]):
        raise ValueError("another block")
    for column in numbers.columns[numbers.isna().all()]:
        numbers[column] = _times_of_day(frame[column])
    numbers.columns = pd.RangeIndex(len(header.names))
    return numbers


def _times_of_day(cells: pd.Series) -> FloatArray:
    """Times of day, with or without a date, in s since the first midnight; NaN in a cell without one."""
    parts = cells.astype(str).str.lower().str.replace(",", ".").str.extract(_CLOCK)
    seconds = parts[[0, 1, 2]].to_numpy(dtype=np.float64) @ np.array([3600.0, 60.0, 1.0])
    halves = parts[3].notna()
    seconds[halves] = seconds[halves] % 43200.0 + 43200.0 * (parts[3][halves] == "p")
    told = np.isfinite(seconds)
    seconds[told] = np.unwrap(seconds[told], period=86400.0)
    return np.asarray(seconds)


def _holds_headers(rows: pd.DataFrame) -> bool:
    """Whether rows that are not numbers look like a header of a new block: words in most of their first cells."""
    first = rows.iloc[:, 0].astype(str)
    return bool(first.str.match(_TEXT.pattern, case=False).any())


def _take(header: Header, frame: pd.DataFrame, found: Columns) -> None:
    """Add a block's columns; a column of times is the clock of those to its right, and kept once."""
    series, clocks = found.series, found.clocks
    columns = [frame[k].to_numpy(dtype=np.float64) for k in range(len(header.names))]
    times = [
        k
        for k, name in enumerate(header.names)
        if named_like_time(name) and runs_forward(columns[k][_filled(columns[k])])
    ]
    clock = ""
    steps: FloatArray = np.empty(0)
    if header.step and not times:
        steps = np.arange(len(frame), dtype=np.float64) * header.step
        clock = found.add("time", steps, "s")
    for k, name in enumerate(header.names):
        if k in times and clock and np.array_equal(columns[k], steps, equal_nan=True):
            continue  # the clock of the columns to the left again
        there = _filled(columns[k])
        if not np.isfinite(columns[k]).any():
            found.other.append(name)
            continue
        column = unique(name, series)
        if header.units[k]:
            found.units[column] = header.units[k]
        if k in times:
            series[column], clock, steps = columns[k][there], column, columns[k]
        elif clock and _thinned(columns[k], steps):
            sampled = np.isfinite(columns[k]) & np.isfinite(steps)
            own = next((one for one in clocks.values() if np.array_equal(series[one], steps[sampled])), "")
            own = own or unique(f"{clock} of {column}", series)
            series[own], series[column], clocks[column] = steps[sampled], columns[k][sampled], own
        elif clock and len(series[clock]) < len(columns[k]):
            series[column], clocks[column] = columns[k][_filled(steps)], clock
        else:
            series[column] = columns[k]
            if clock:
                clocks[column] = clock


def _filled(values: FloatArray) -> npt.NDArray[np.bool_]:
    """All rows up to the last that holds a number."""
    finite = np.flatnonzero(np.isfinite(values))
    return np.arange(len(values)) < (finite[-1] + 1 if len(finite) else 0)


def _thinned(values: FloatArray, times: FloatArray) -> bool:
    """Return whether a column has a number in every so many rows only: sampled less often than the times beside it."""
    sampled = np.flatnonzero(np.isfinite(values[np.isfinite(times)]))
    if len(sampled) < 3 or len(sampled) > 0.7 * np.count_nonzero(np.isfinite(times)):
        return False
    gaps = np.diff(sampled)
    return bool(np.mean(gaps == np.median(gaps)) > 0.9)
