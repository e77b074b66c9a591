# SPDX-License-Identifier: Apache-2.0
"""Text tables of any logger: encoding, separator, decimal sign, headers and blocks are detected.

dSPACE ControlDesk, TwinCAT Scope, LabVIEW and others put a header of key and values above the numbers, names and units
in rows of their own, one column of times per raster or one block below the other; spreadsheets of half of Europe write
decimal commas.

Four shapes of header are read: a row of names, with a row of units by it or units in brackets behind the names; rows
that begin with a key, as ControlDesk writes them (`trace_names;...`, `path;...`, `unit;...`, then `trace_values;`
before the first row of numbers and an empty cell before the others); rows that repeat their key before the channels of
each clock, as TwinCAT Scope writes them (`Name;fPos;Name;fForce`, then ms and values); lines of anything else above
either. Without names, columns are numbered. A step in the header (LabVIEW's `Delta_X`, a scope's `Increment`) makes the
times where no column is one.

pandas reads the numbers. Where it fails, a column is parsed in the format that fits all of its cells: a decimal sign
with thousands separators, or times of day. If none does, the first unparsable cell and its line are reported.
"""

from __future__ import annotations

import csv
import re
from codecs import getincrementaldecoder
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import (
    UNIT_FACTORS,
    Columns,
    counts_rows,
    is_time,
    known,
    merge_parts,
    set_day_units,
    split_unit,
    stated,
    stated_step,
    unique,
)

NAME_KEYS = (
    "name", "names", "trace_name", "trace_names", "displayidentifier", "signal", "signals", "channel", "label", "path",
    "variable", "bezeichnung", "symbolname",
)  # fmt: skip
"""First cells of rows of column names, in order of preference; a row with more distinct names precedes."""
UNIT_KEYS = ("unit", "units", "trace_units", "einheit", "einheiten", "y_unit_label")
"""First cells of rows that hold units."""
BLANKS_PATTERN = r"\s+"
_THOUSANDS_SEPARATORS = ".,'’ \u00a0\u2009\u202f"
_PLAIN_NUMBERS = {
    sign: rf"[+-]?(?:\d+[{sign}]?\d*|[{sign}]\d+)(?:[eEdD][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)" for sign in ".,"
}
_GROUPED_NUMBERS = {
    sign: rf"[+-]?[1-9]\d{{0,2}}([{_THOUSANDS_SEPARATORS.replace(sign, '')}])(?:\d{{2,3}}\1)*\d{{3}}(?:[{sign}]\d*)?"
    for sign in ".,"
}
_NUMBER_PATTERNS = {
    sign: re.compile(f"(?:{_GROUPED_NUMBERS[sign]}|{_PLAIN_NUMBERS[sign]})", re.IGNORECASE) for sign in ".,"
}
"""Numbers by decimal sign, with thousands or without."""
_CLOCK_PATTERN = r"(?<!\d)(?:(\d{1,2}):)?(\d\d):(\d\d)(?:([.,:])(\d+))?(?!\d|:)(?:\s*([ap])\.?m\b)?"
"""Time of day in a cell, or minutes and seconds; parts of a second behind a point, a comma or a colon."""
_TEXT_LINE_PATTERN = re.compile(r"^[\s\"]*(?!nan\b|inf\b)[A-Za-z_\[#%]", re.IGNORECASE)
"""Line that begins with a word, as headers do."""


class Style(NamedTuple):
    """Separator and decimal sign of a text table."""

    separator: str
    decimal: str
    certain: bool
    """Whether some cell can be parsed with this decimal sign only."""


@dataclass(frozen=True)
class Header:
    """Header above a block of numbers."""

    n_lines: int
    """Lines before the first row of numbers."""
    lead: int
    """Cells before the first number of a row: 1 where the rows begin with a key."""
    names: tuple[str, ...]
    """Names of the columns, each unique."""
    units: tuple[str, ...]
    """Units of the columns, normalised by `units.stated`; empty if not stated."""
    start: float
    step: float
    """Sampling step [s] if the header states one, else 0."""


def delimited_columns(path: Path) -> Columns:
    """Read a table of text. Raises ValueError, OSError, pandas.errors.EmptyDataError if it cannot be read."""
    inspected = 1 << 16
    with path.open("rb") as file:
        head = file.read(inspected)
    if not head.strip():
        raise pd.errors.EmptyDataError(str(path))
    if head.lstrip()[:1] == b"<":
        raise ValueError("it is a web page or XML, not a table")
    encoding = _encoding(head)
    lines = head.decode(encoding, errors="replace").splitlines()
    found = merge_parts(_blocks(path, encoding, style_of(lines[:-1] if len(head) == inspected else lines)))
    set_day_units(found)
    if len({len(values) for values in found.series.values()}) == 1 and len(set(found.clocks.values())) <= 1:
        found.clocks.clear()
    return found


def _encoding(head: bytes) -> str:
    """Encoding by the byte order mark; without one UTF-8 if valid, else a code page of Windows.

    That of Western Europe, or that of Korea where bytes beyond ASCII come in pairs.
    """
    for mark, encoding in ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if head.startswith(mark):
            return encoding
    if head[1::2].count(0) > len(head) // 4:
        return "utf-16-le"
    with suppress(UnicodeDecodeError):
        getincrementaldecoder("utf-8")().decode(head)  # a character may be cut in two where the head ends
        return "utf-8"
    return "cp1252" if any(len(run) % 2 for run in re.findall(rb"[\x80-\xff]+", head[:-1])) else "cp949"


def style_of(lines: list[str]) -> Style:
    """Return the separator and decimal sign with which most cells of the last 200 lines parse as numbers."""
    last = [line for line in lines[-200:] if line.strip()]
    best, most = Style(",", ".", certain=False), -1
    for decimal, other in (".,", ",."):
        plain = re.compile(_PLAIN_NUMBERS[decimal], re.IGNORECASE)
        for separator in (";", "\t", BLANKS_PATTERN, ",", "|"):
            rows = (
                _cells(line, separator) for line in last if separator != BLANKS_PATTERN or not re.search("[;\t|]", line)
            )
            cells = [cell for row in rows if len(row) > 1 for cell in row if cell]
            numbers = [cell for cell in cells if _is_number(cell, decimal)]
            score = sum(3 if plain.fullmatch(cell) else 1 if " " in cell else 2 for cell in numbers) - len(cells)
            if numbers and score > most:
                certain = any(
                    not _NUMBER_PATTERNS[other].fullmatch(cell)
                    for cell in numbers
                    if _NUMBER_PATTERNS[decimal].fullmatch(cell)
                )
                best, most = Style(separator, decimal, certain), score
    return best


def _cells(line: str, separator: str) -> list[str]:
    line = line.replace("\0", "")
    if separator == BLANKS_PATTERN:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]


def _is_number(cell: str, decimal: str) -> bool:
    return bool(_NUMBER_PATTERNS[decimal].fullmatch(cell)) or (
        decimal == "," and bool(_NUMBER_PATTERNS["."].fullmatch(cell))
    )


def header_of(lines: list[str], style: Style) -> Header:
    """Header of a block's `lines`. Raises ValueError without a row of numbers, or if decimal commas split cells."""
    rows = [_cells(line, style.separator) for line in lines]

    def lead(at: int) -> int:
        """Return 1 if a row begins with a key and the next with an empty cell, else 0."""
        keyed = any(rows[at][:1]) and not _is_number(rows[at][0], style.decimal)
        return int(keyed and (at + 1 >= len(rows) or rows[at + 1][:1] == [""]))

    def numbers_begin(at: int) -> bool:
        below = [row for row in rows[at + 1 : at + 5] if any(row)]
        return all(_mostly_numbers(row, style.decimal) for row in (rows[at][lead(at) :], *below))

    # ControlDesk's key of the first row of numbers: rows above it may hold numbers too (flags, limits)
    marked = [k for k, row in enumerate(rows) if row and row[0].lower() == "trace_values"]
    first = marked[0] if marked else next(filter(numbers_begin, range(len(rows))), None)
    if first is None:
        raise ValueError("there is no row of two numbers or more in it")
    body = rows[first][lead(first) :]
    ends_empty = all(not row or row[-1] == "" for row in rows[first:])  # a separator behind which nothing stands
    width = len(body) - (len(body) > 2 and ends_empty)
    above = _header_rows(lines[:first], rows[:first], width, style.separator)
    words = [row for row in above if not any(_is_number(cell, ".") for cell in row)]
    if style[:2] == (",", ".") and any(width == 2 * len(row) for row in words):
        raise ValueError(
            f"line {first + 1} has {width} cells under half as many names: write decimal points, or semicolons between "
            "the columns"
        )
    names, units = _names_and_units(above, width, keyed=bool(lead(first)))
    units = [stated(unit) or split_unit(name)[1] for name, unit in zip(names, units, strict=True)]
    distinct: dict[str, None] = {}
    for name in names:
        distinct[unique(name, distinct)] = None
    return Header(first, lead(first), tuple(distinct), tuple(units), *stated_step(_properties(above)))


def _header_rows(lines: list[str], rows: list[list[str]], width: int, separator: str) -> list[list[str]]:
    """Cells of the rows above the numbers; if none has `width` cells, by any separator that gives as many."""
    bare = [line.strip().lstrip("#%").strip() for line in lines]
    if separator == BLANKS_PATTERN:
        rows = [line.split() for line in bare]
    if width > 1 and not any(width <= len(row) <= width + 3 for row in rows):
        ways = (r"\s{2,}", r"\s*;\s*", r"\s*\t\s*", r"\s*,\s*", r"\s+")
        split = ([re.split(way, line) for line in bare] for way in ways)
        rows = next((one for one in split if any(len(cells) == width for cells in one)), rows)
    return [row for row in rows if any(row)]


def _properties(above: list[list[str]]) -> Iterator[tuple[str, str]]:
    """Yield cells, each with the number behind it, next to it or below it, if there is one."""
    for row, next_row in zip(above, [*above[1:], []], strict=False):
        for j, cell in enumerate(row):
            below = next_row[j] if len(next_row) > j else ""
            beside = next((one for one in row[j + 1 :] if one), "")
            key, _, behind = cell.replace("=", ":").partition(":")
            value = next((one for one in (behind.strip(), beside, below) if re.match(r"[+-]?[\d.,]", one)), "")
            if cell and value:
                yield key, value


def _names_and_units(above: list[list[str]], width: int, *, keyed: bool) -> tuple[list[str], list[str]]:
    """Names and units of the columns, `width` of each: from rows that begin with a key, else from rows as wide."""
    if any(row[0].lower() in NAME_KEYS and row[0] in row[1:] for row in above):  # a key repeated for each clock
        clock = dict.fromkeys(UNIT_KEYS, "ms")
        above = [
            [row[0], *(clock.get(row[0].lower(), "") if cell == row[0] else cell for cell in row)] for row in above
        ]
        keyed = True
    if keyed:
        by_key = {row[0].lower().strip("[]:"): row[1 : width + 1] for row in above if row[0]}
        there = [by_key[key] for key in NAME_KEYS if any(by_key.get(key, ()))]
        names = max(there, key=lambda names: len(set(names)), default=[])
        names = [name or "time" for name in [*names, *[""] * (width - len(names))]] if names else names
        units = next((by_key[key] for key in UNIT_KEYS if any(by_key.get(key, ()))), [])
    else:  # the last row in which most cells differ
        wide = [row for row in reversed(above) if width <= len(row) <= width + 3]
        units = next(filter(_are_units, wide), []) if len(wide) > 1 else []
        names = max((row for row in wide if row is not units), key=lambda row: len(set(row[:width])), default=[])
        names, units = names[:width], units[:width]
    return _numbered(names, width), [*units, *[""] * (width - len(units))]


def _are_units(row: list[str]) -> bool:
    """Return whether the cells of a row are units: most are known, or all are in brackets."""
    cells = [cell for cell in row if cell and cell not in ("-", "[-]") and not _is_number(cell, ",")]
    if not cells:
        return not any(row)
    return all(cell[0] + cell[-1] in ("[]", "()") for cell in cells) or 2 * sum(map(bool, map(known, cells))) > len(
        cells
    )


def _numbered(names: list[str], width: int) -> list[str]:
    """The names, with a number in place of those that are missing."""
    names = [*names, *[""] * (width - len(names))]
    return [name.lstrip("#% ") or f"column {k}" for k, name in enumerate(names)]


def _mostly_numbers(row: list[str], decimal: str) -> bool:
    cells = [cell for cell in row if cell]
    numbers = sum(_is_number(cell, decimal) or bool(re.search(_CLOCK_PATTERN, cell)) for cell in cells)
    return len(row) > 1 and numbers > 0 and 2 * numbers > len(cells)


def _blocks(path: Path, encoding: str, style: Style) -> Iterator[Columns]:
    """Yield the columns of each block of numbers below a header; most files are one block."""

    def text() -> Iterator[str]:
        with path.open(encoding=encoding, errors="replace") as file:
            yield from (line.rstrip("\r\n") for line in file)

    header = header_of(list(islice(text(), 400)), style)
    try:
        with path.open(encoding=encoding, errors="replace") as file:
            whole = _read(file, header, style)
    except (ValueError, pd.errors.ParserError):
        whole = None
    if whole is not None and not _holds_headers(whole, style):
        yield _columns(header, whole, style, lambda: islice(text(), header.n_lines, None), header.n_lines)
        return
    rest, at, above = list(text()), 0, header
    while at < len(rest):
        try:
            header = header_of(rest[at : at + 400], style)
        except ValueError:
            if at:
                return  # words below the last number
            raise
        if header.names == tuple(_numbered([], len(above.names))):  # words, no header
            header = replace(above, n_lines=header.n_lines)
        begin = at + header.n_lines
        words = (k for k in range(begin + 1, len(rest)) if _TEXT_LINE_PATTERN.match(rest[k]))
        end = next(
            (k for k in words if not _mostly_numbers(_cells(rest[k], style.separator), style.decimal)), len(rest)
        )
        frame = _read(StringIO("\n".join(rest[at:end])), header, style)
        yield _columns(header, frame, style, partial(iter, rest[begin:end]), begin)
        at, above = end, header


def _holds_headers(frame: pd.DataFrame, style: Style) -> bool:
    """Return whether some rows are headers of a new block: words in the first cell, and few numbers in the others."""
    first = frame.iloc[:, 0]
    if first.dtype != object:
        return False
    worded = first.astype(str).str.match(_TEXT_LINE_PATTERN.pattern, case=False) & first.notna()
    if worded.all() or not worded.any():
        return False
    rows = frame[worded].iloc[:20].astype(str).to_numpy()
    return not all(_mostly_numbers([*filter(lambda cell: cell != "nan", row)], style.decimal) for row in rows)


def _read(source: object, header: Header, style: Style) -> pd.DataFrame:
    """Cells of a block: columns of numbers if pandas can parse all cells of one, else of texts."""
    width = len(header.names) + header.lead
    frame = pd.read_csv(
        source, sep=style.separator, decimal=style.decimal, header=None, names=range(width),
        usecols=range(header.lead, width), index_col=False, skiprows=header.n_lines, skipinitialspace=True,
        skip_blank_lines=True, low_memory=False, dtype=None if style.certain else str,
        na_values=["-", "--", "---", "?", "NaN.", "1.#R"],  # in addition to pandas' own
        float_precision="round_trip" if style.decimal == "." else "high",
    )  # fmt: skip
    if not len(frame):
        raise pd.errors.EmptyDataError("no rows")
    frame.columns = pd.RangeIndex(len(header.names))
    return frame


def _columns(
    header: Header, frame: pd.DataFrame, style: Style, lines: Callable[[], Iterator[str]], begin: int
) -> Columns:
    """Columns of a block. `lines`: of its rows of numbers; `begin`: number of lines above them in the file."""
    found, numbers = Columns(), []
    if style.separator == BLANKS_PATTERN and frame.iloc[:-1, -1].isna().any():
        widths = ((begin + k + 1, len(line.split())) for k, line in enumerate(lines()))
        short = next((k for k, width in widths if 0 < width < frame.shape[1]), 0)
        if short:
            raise ValueError(
                f"line {short} has fewer numbers than the others: write nan, or separate the columns by another sign"
            )
    for k, name in enumerate(header.names):
        values, bad = numbers_of(frame[k], style.decimal, certain=style.certain)
        if bad is not None:
            line = next(islice(((begin + i + 1) for i, one in enumerate(lines()) if one.strip()), bad, None), 0)
            found.broken[name] = (
                f"{str(frame[k][bad])[:40]!r} in line {line} of {name!r} is not a number as the others of its column "
                "are: write it as they are, or leave the cell empty"
            )
        numbers.append(values)
        if style.certain or bad is not None or frame[k].dtype != object or found.notes:
            continue
        given = frame[k].dropna()
        if len(given) and given.str.fullmatch(_GROUPED_NUMBERS["," if style.decimal == "." else "."]).all():
            first = str(given.iloc[0])
            found.notes.append(
                f"{style.decimal!r} was taken as the decimal sign: {first!r} as {values[given.index[0]]:g}"
            )
    _take(header, numbers, found)
    return found


def numbers_of(cells: pd.Series, decimal: str = ".", *, certain: bool = True) -> tuple[FloatArray, int | None]:
    """Parsed numbers of a column, (n,), and the index of its first unparsable cell; such a column is NaN throughout.

    The format is the first that fits all cells: `decimal` with thousands, the other decimal sign, times of day [s].
    Unless `decimal` is `certain`, a column is rejected in which the two signs give different numbers in some cells
    only. The index is None if all cells, all but the last, or none can be parsed.
    """
    if cells.dtype != object:
        return cells.to_numpy(dtype=np.float64), None
    text = cells.astype(str).str.strip().str.replace("\u2212", "-").where(cells.notna(), "")
    given = (text != "").to_numpy()
    read: list[tuple[npt.NDArray[np.bool_], FloatArray]] = []
    for sign in (decimal, "," if decimal == "." else "."):
        fits = text.str.fullmatch(_NUMBER_PATTERNS[sign].pattern, case=False).to_numpy(dtype=bool)
        bare = text.where(fits, "nan").str.replace(f"[{_THOUSANDS_SEPARATORS.replace(sign, '')}]", "", regex=True)
        plain = bare.str.replace(",", ".").str.replace("d", "e", case=False)
        read.append((fits, plain.to_numpy(dtype=np.float64)))
    (fits, values), (others_fit, others) = read
    if fits[given].all():
        unlike = others_fit & given & ~np.isclose(values, others, equal_nan=True)
        if not certain and unlike.any() and not unlike[given].all() and others_fit[given].all():
            return np.full(len(text), np.nan), int(np.argmax(unlike))
        return values, None
    if others_fit[given].all():
        return others, None
    times = _times_of_day(text)
    fits, values = max([*read, (np.isfinite(times), times)], key=lambda one: int(np.sum(one[0] & given)))
    bad = np.flatnonzero(given & ~fits)
    if not len(bad) or (np.any(fits & given) and bad[0] == len(text) - 1):  # the file was cut off in it
        return values, None
    return np.full(len(text), np.nan), int(bad[0]) if np.any(fits & given) else None


def _times_of_day(text: pd.Series) -> FloatArray:
    """Times of day, with or without a date, in s since the first midnight; NaN in a cell without one."""
    parts = text.str.lower().str.extract(_CLOCK_PATTERN)
    hours = parts[0].astype(float)
    behind = parts[4].fillna("0")
    scale = np.where(parts[3] == ":", np.where(behind.str.len() > 3, 1e6, 1e3), 10.0 ** behind.str.len())
    seconds = (60.0 * parts[1].astype(float) + parts[2].astype(float) + behind.astype(float) / scale).to_numpy()
    seconds[hours.isna() & ((parts[3] == ":") | parts[3].isna())] = np.nan  # 10:00 is hours and minutes
    seconds += 3600.0 * hours.fillna(0.0).to_numpy()
    halves = parts[5].notna().to_numpy()
    seconds[halves] = seconds[halves] % 43200.0 + 43200.0 * (parts[5][halves] == "p").to_numpy()
    told = np.isfinite(seconds)
    seconds[told] = np.unwrap(seconds[told], period=86400.0 if hours.notna().any() else 3600.0)
    return np.asarray(seconds)


def _take(header: Header, columns: list[FloatArray], found: Columns) -> None:
    """Add the columns of a block; a time column is the clock of those to its right, and is added once."""
    series, clocks = found.series, found.clocks
    times = [k for k, name in enumerate(header.names) if is_time(name, columns[k][_filled(columns[k])])]
    clock = ""
    steps: FloatArray = np.empty(0)
    counter = next((k for k, one in enumerate(columns) if counts_rows(one[_filled(one)])), None)
    if header.step and (not times or (counter is not None and times == [counter] and not known(header.units[counter]))):
        rows = columns[counter] if counter is not None else np.arange(len(columns[0]), dtype=np.float64)
        times, steps = [], header.start + header.step * rows
        clock = found.add("time", steps, "s")
        found.notes.append(f"its rows are {1e3 * header.step:g} ms apart, as its header says")
    elif header.step and header.units[times[0]] in UNIT_FACTORS:
        own = float(np.nanmedian(np.diff(columns[times[0]]))) * UNIT_FACTORS[header.units[times[0]]]
        if not 0.99 < own / header.step < 1.01:
            found.notes.append(f"rows are {1e3 * own:g} ms apart by its times, {1e3 * header.step:g} ms by its header")
    for k, name in enumerate(header.names):
        values, unit = columns[k], header.units[k]
        if k in times and clock and np.array_equal(values, steps, equal_nan=True):
            continue  # a repetition of the previous clock
        if not np.isfinite(values).any():
            found.other.extend([name] * (name not in found.broken))
        elif k in times:
            clock, steps = found.add(name, values[_filled(values)], unit), values
        elif clock and _thinned(values, steps):
            sampled = np.isfinite(values) & np.isfinite(steps)
            own_clock = next((one for one in clocks.values() if np.array_equal(series[one], steps[sampled])), "")
            own_clock = own_clock or found.add(f"{clock} of {unique(name, series)}", steps[sampled])
            clocks[found.add(name, values[sampled], unit)] = own_clock
        elif clock:
            shorter = len(series[clock]) < len(values)
            clocks[found.add(name, values[_filled(steps)] if shorter else values, unit)] = clock
        else:
            found.add(name, values, unit)


def _filled(values: FloatArray) -> npt.NDArray[np.bool_]:
    """Mask of the rows up to the last with a number, (n,)."""
    finite = np.flatnonzero(np.isfinite(values))
    return np.arange(len(values)) < (finite[-1] + 1 if len(finite) else 0)


def _thinned(values: FloatArray, times: FloatArray) -> bool:
    """Return whether a column has a number in every n-th row only: it is sampled more slowly than `times`."""
    sampled = np.flatnonzero(np.isfinite(values[np.isfinite(times)]))
    if len(sampled) < 3 or len(sampled) > 0.7 * np.count_nonzero(np.isfinite(times)):
        return False
    gaps = np.diff(sampled)
    return bool(np.mean(gaps == np.median(gaps)) > 0.9)
