# SPDX-License-Identifier: Apache-2.0
"""Text tables of any logger: records, headers and numbers, a block of the file at a time.

A file is a sequence of records: lines, joined where a quoted cell holds line breaks. Each record is a row of numbers,
words (a header, where names stand above as many numbers; else a remark) or blank. What is not read is counted, and
named by its first line.

Headers name columns in a row, with units below or in brackets; by keys at the beginning of rows (ControlDesk:
`trace_names;...`); or by a key that each clock repeats (TwinCAT Scope: `Name;fPos;Name;fForce`). pyarrow reads the
numbers. A column with a cell that it cannot read is read by the format that fits all of its cells: a decimal sign with
thousands, or times of day. If none does, its first unreadable cell and line are reported.
"""

from __future__ import annotations

import csv
import re
from codecs import getincrementaldecoder
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
from pyarrow import csv as pyarrow_csv

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import Columns, counts_rows, is_time, merge_parts, set_day_units, stated_step, unique
from hydro_diagnosis.io.units import UNIT_FACTORS, known, split_unit, stated

_NAME_KEYS = (
    "name", "names", "trace_name", "trace_names", "displayidentifier", "signal", "signals", "channel", "label", "path",
    "variable", "bezeichnung", "symbolname",
)  # fmt: skip
_UNIT_KEYS = ("unit", "units", "trace_units", "einheit", "einheiten", "y_unit_label")
_BLANKS = r"\s+"
_THOUSANDS = ".,'’ \u00a0\u2009\u202f"
_NULLS = ["", "-", "--", "---", "?", "nan", "NaN", "NAN", "-nan", "NaN.", "NA", "N/A", "#N/A", "n/a", "NULL", "null",
          "None", "1.#R", "1.#QNAN", "-1.#IND", "1.#IND", "#DIV/0!", "#NV", "#WERT!", "#VALUE!"]  # fmt: skip
_PLAIN = {
    sign: rf"[+-]?(?:\d+[{sign}]?\d*|[{sign}]\d+)(?:[eEdD][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?|∞|1{sign}#inf)"
    for sign in ".,"
}
_GROUPED = {
    sign: rf"[+-]?[1-9]\d{{0,2}}([{_THOUSANDS.replace(sign, '')}])(?:\d{{2,3}}\1)*\d{{3}}(?:[{sign}]\d*)?"
    for sign in ".,"
}
_NUMBER = {sign: re.compile(f"(?:{_GROUPED[sign]}|{_PLAIN[sign]})", re.IGNORECASE) for sign in ".,"}
"""Numbers by decimal sign, with thousands or without."""
_CLOCK = r"(?<!\d)(?:(\d{1,2}):)?(\d\d):(\d\d)(?:([.,:])(\d+))?(?!\d|:)(?:\s*([ap])\.?m\b)?"
"""Time of day in a cell, or minutes and seconds; parts of a second behind a point, a comma or a colon."""
_WORDS = re.compile(r"[\s\"]*(?!nan\b|inf\b)[^\W\d_#%\[]|[\s\"]*[_#%\[]", re.IGNORECASE)
"""Beginning of a record of words."""
_MAX_LINES = 40
"""Largest number of lines of one record."""


class Style(NamedTuple):
    """Separator and decimal sign of a text table."""

    separator: str
    decimal: str
    certain: bool
    """Whether some cell can be parsed with this decimal sign only."""


@dataclass(frozen=True)
class Header:
    """Header above rows of numbers."""

    n_records: int
    """Records before the first row of numbers."""
    lead: int
    """Cells before the first number of a row: 1 where the rows begin with a key."""
    names: tuple[str, ...]
    """Names of the columns, each unique."""
    named: bool
    """Whether the file states the names."""
    units: tuple[str, ...]
    """Units of the columns, normalised by `units.stated`; empty if not stated."""
    start: float
    step: float
    """Sampling step [s] if the header states one, else 0."""


@dataclass
class _Part:
    """Rows of numbers below one header."""

    header: Header
    columns: list[list[pa.ChunkedArray]]
    """Numbers or texts of each column, by block."""
    lines: list[Sequence[int]] = field(default_factory=list)
    """Line of each row, by block."""

    def line(self, row: int) -> int:
        """Line of a row."""
        return next(islice((line for lines in self.lines for line in lines), row, None), 0)


def text_columns(path: Path) -> Columns:
    """Read a table of text. Raises ValueError, OSError, pandas.errors.EmptyDataError if it cannot be read."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    if not head.strip():
        raise pd.errors.EmptyDataError(str(path))
    encoding = _encoding(head)
    lines = head.decode(encoding, errors="replace").splitlines()
    style = style_of(lines[:-1] if len(head) == 1 << 16 else lines)
    texts: set[tuple[int, int]] = set()  # part and column
    parts, notes, whole = _parts(path, encoding, style, texts)
    if not whole:  # a later block has shown that the cells of a column are no plain numbers
        parts, notes, _ = _parts(path, encoding, style, texts)
    found = merge_parts(_columns(part, style) for part in parts)
    found.notes[:0] = notes
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
        plain = re.compile(_PLAIN[decimal], re.IGNORECASE)
        for separator in (";", "\t", _BLANKS, ",", "|"):
            rows = (_cells(line, separator) for line in last if separator != _BLANKS or not re.search("[;\t|]", line))
            cells = [cell for row in rows if len(row) > 1 for cell in row if cell and len(cell) < 100]
            numbers = [cell for cell in cells if _is_number(cell, decimal)]
            score = sum(3 if plain.fullmatch(cell) else 1 if " " in cell else 2 for cell in numbers) - len(cells)
            if numbers and score > most:
                strict = (cell for cell in numbers if _NUMBER[decimal].fullmatch(cell))
                best = Style(separator, decimal, any(not _NUMBER[other].fullmatch(cell) for cell in strict))
                most = score
    return best


def _cells(record: str, separator: str) -> list[str]:
    record = record.replace("\0", "")
    if separator == _BLANKS:
        return record.split()
    csv.field_size_limit(1 << 24)
    cells = next(csv.reader([record], delimiter=separator, skipinitialspace=True), [])
    return [" ".join(cell.split("\n")).strip() for cell in cells]


def _is_number(cell: str, decimal: str) -> bool:
    return bool(_NUMBER[decimal].fullmatch(cell)) or (decimal == "," and bool(_NUMBER["."].fullmatch(cell)))


def _mostly_numbers(row: list[str], decimal: str) -> bool:
    cells = [cell for cell in row if cell]
    numbers = sum(len(one) < 100 and (_is_number(one, decimal) or bool(re.search(_CLOCK, one))) for one in cells)
    return len(row) > 1 and numbers > 0 and 2 * numbers > len(cells)


# --- headers -------------------------------------------------------------------------------------------------------


def header_of(records: list[str], style: Style) -> Header:
    """Header above the first row of numbers. Raises ValueError without one, or if decimal commas split cells."""
    rows = [_cells(record, style.separator) for record in records]

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
    rows_above = [
        k
        for k, row in enumerate(rows[:first] if not marked else [])
        if len(row) == len(rows[first]) and _is_number(row[0], style.decimal) and _mostly_numbers(row, style.decimal)
    ]
    if len(rows_above) > 5:  # remarks between all rows: these are no header
        first = rows_above[0]
    body = rows[first][lead(first) :]
    ends_empty = all(not row or row[-1] == "" for row in rows[first:])  # a separator behind which nothing stands
    width = len(body) - (len(body) > 2 and ends_empty)
    above = _header_rows(records[:first], rows[:first], width, style.separator)
    words = [row for row in above if not any(_is_number(cell, ".") for cell in row)]
    if style[:2] == (",", ".") and any(width == 2 * len(row) for row in words):
        raise ValueError(
            f"line {first + 1} has {width} cells under half as many names: write decimal points, or semicolons between "
            "the columns"
        )
    names, units = _names_and_units(above, width, keyed=bool(lead(first)))
    named, width = any(names), max(width, len(names))
    names = [name.lstrip("#% ") or f"column {k}" for k, name in enumerate([*names, *[""] * (width - len(names))])]
    units = [*units[:width], *[""] * (width - len(units))]
    units = [stated(unit) or split_unit(name)[1] for name, unit in zip(names, units, strict=True)]
    distinct: dict[str, None] = {}
    for name in names:
        distinct[unique(name, distinct)] = None
    return Header(first, lead(first), tuple(distinct), named, tuple(units), *stated_step(_properties(above)))


def _header_rows(records: list[str], rows: list[list[str]], width: int, separator: str) -> list[list[str]]:
    """Cells of the rows above the numbers; if none has `width` cells, by any separator that gives as many."""
    bare = [record.strip().lstrip("#%").strip() for record in records]
    if separator == _BLANKS:
        rows = [record.split() for record in bare]
    if width > 1 and not any(width <= len(row) <= width + 3 for row in rows):
        ways = (r"\s{2,}", r"\s*;\s*", r"\s*\t\s*", r"\s*,\s*", r"\s+")
        split = ([re.split(way, record) for record in bare] for way in ways)
        rows = next((one for one in split if any(len(cells) == width for cells in one)), rows)
    return [row for row in rows if any(row)]


def _properties(above: list[list[str]]) -> Iterator[tuple[str, str]]:
    """Yield cells, each with the number behind it, next to it or below it, if there is one."""
    for row, next_row in zip(above, [*above[1:], []], strict=False):
        beside = ""
        for j in range(len(row) - 1, -1, -1):
            below = next_row[j] if len(next_row) > j else ""
            key, _, behind = row[j].replace("=", ":").partition(":")
            value = next((one for one in (behind.strip(), beside, below) if re.match(r"[+-]?[\d.,]", one)), "")
            if row[j] and value:
                yield key, value
            beside = row[j] or beside


def _names_and_units(above: list[list[str]], width: int, *, keyed: bool) -> tuple[list[str], list[str]]:
    """Names and units, as far as there are any: from rows that begin with a key, else from rows as wide."""
    if any(row[0].lower() in _NAME_KEYS and row[0] in row[1:] for row in above):  # a key repeated for each clock
        clock = dict.fromkeys(_UNIT_KEYS, "ms")
        above = [
            [row[0], *(clock.get(row[0].lower(), "") if cell == row[0] else cell for cell in row)] for row in above
        ]
        keyed = True
    if keyed:
        by_key = {row[0].lower().strip("[]:"): row[1:] for row in above if row[0]}
        there = [by_key[key] for key in _NAME_KEYS if any(by_key.get(key, ()))]
        names = max(there, key=lambda names: len(set(names)), default=[])
        names = [name or "time" for name in [*names, *[""] * (width - len(names))][:width]] if names else names
        units = next((by_key[key] for key in _UNIT_KEYS if any(by_key.get(key, ()))), [])
    else:  # the last row in which most cells differ
        wide = [row for row in reversed(above) if width <= len(row) <= width + 3]
        units = next(filter(_are_units, wide), []) if len(wide) > 1 else []
        names = max((row for row in wide if row is not units), key=lambda row: len(set(row[:width])), default=[])
    while names and not names[-1]:
        names = names[:-1]
    return names, units


def _are_units(row: list[str]) -> bool:
    """Return whether the cells of a row are units: most are known, or all are in brackets."""
    cells = [cell for cell in row if cell and cell not in ("-", "[-]") and not _is_number(cell, ",")]
    if not cells:
        return not any(row)
    bracketed = all(cell[0] + cell[-1] in ("[]", "()") for cell in cells)
    return bracketed or 2 * sum(bool(known(cell)) for cell in cells) > len(cells)


# --- records -------------------------------------------------------------------------------------------------------


def _records(path: Path, encoding: str, style: Style) -> Iterator[tuple[Sequence[int], list[str]]]:
    """Yield blocks of records, each with the line on which it begins."""
    with path.open(encoding=encoding, errors="replace") as file:
        at, rest, ended = 1, "", False
        while not ended:
            text = file.read(1 << 22)
            ended, lines = not text, (rest + text).split("\n")
            rest = "" if ended else lines.pop()
            if len(rest) > 1 << 24:
                raise ValueError(f"line {at + len(lines)} is longer than 16 MB: it is no table")
            if '"' not in text and '"' not in rest and not any('"' in line for line in lines[:_MAX_LINES]):
                yield range(at, at + len(lines)), lines
                at += len(lines)
                continue
            numbers, records, k = [], [], 0
            while k < len(lines):
                if '"' in lines[k] and lines[k].count('"') % 2 and style.separator != _BLANKS:
                    if k + _MAX_LINES > len(lines) and not ended:
                        rest = "\n".join([*lines[k:], rest])
                        break
                    n_lines = _open_lines(lines[k : k + _MAX_LINES], style)
                else:
                    n_lines = 1
                numbers.append(at + k)
                records.append("\n".join(lines[k : k + n_lines]) if n_lines > 1 else lines[k])
                k += n_lines
            yield numbers, records
            at += k


def _open_lines(lines: list[str], style: Style) -> int:
    """Lines of a record whose first line opens a quote: up to the one that closes it; 1 if rows of numbers precede."""
    for k, line in enumerate(lines[1:], 2):
        if _mostly_numbers(_cells(line, style.separator), style.decimal):
            break
        if line.count('"') % 2:
            return k
    return 1


def _parts(path: Path, encoding: str, style: Style, texts: set[tuple[int, int]]) -> tuple[list[_Part], list[str], bool]:
    """Parts of a file, notes on what was not read, and whether all blocks of each column are of one type.

    Columns that are no plain numbers are added to `texts`.
    """
    parts: list[_Part] = []
    left: dict[str, list[tuple[int, str]]] = {}  # lines left out, by reason
    words: list[tuple[int, str]] = []  # since the last row
    whole = True
    for lines, records in _records(path, encoding, style):
        begin = 0
        if not parts:
            header = header_of(records[:400], style)
            begin = header.n_records
            parts.append(_Part(header, [[] for _ in header.names]))
        worded_rows = [_is_words(record, style) for record in records[begin:]]
        for worded, run in groupby(worded_rows):
            end = begin + len(list(run))
            those, numbers, begin = records[begin:end], lines[begin:end], end
            if worded:
                words += zip(numbers, those, strict=True)
                continue
            if words:
                below = _header_below([one for _, one in words], those, style)
                if below is not None and below.named and _is_header(below, parts[-1].header):
                    parts.append(_Part(below, [[] for _ in below.names]))
                else:
                    left.setdefault("hold words: their neighbours were joined", []).extend(words)
                words = []
            part, index = parts[-1], len(parts) - 1
            numbers, those = _fitted(numbers, those, part.header, style, left)
            if those:
                known_texts = {k for k in range(len(part.columns)) if (index, k) in texts or not style.certain}
                for k, column in enumerate(_parsed(those, part.header, style, known_texts)):
                    if pa.types.is_string(column.type) and k not in known_texts:
                        texts.add((index, k))
                        whole = whole and not part.columns[k]
                    part.columns[k].append(column)
                part.lines.append(numbers)
    if not parts:
        raise ValueError("there is no row of two numbers or more in it")
    if words:
        left.setdefault("hold words: their neighbours were joined", []).extend(words)
    short = [line for line, _ in left.pop(_SHORT, ()) if line < max((one[-1] for one in parts[-1].lines), default=0)]
    if short:
        raise ValueError(
            f"line {short[0]} has fewer numbers than the others: write nan, or separate the columns by another sign"
        )
    notes = [
        f"{len(some)} lines {reason} (from line {some[0][0]} on: {' '.join(some[0][1].split())[:40]!r})"
        for reason, some in left.items()
    ]
    return parts, notes, whole


_SHORT = "have fewer numbers than the others"


def _is_words(record: str, style: Style) -> bool:
    return _WORDS.match(record) is not None and not _mostly_numbers(_cells(record, style.separator), style.decimal)


def _header_below(words: list[str], rows: list[str], style: Style) -> Header | None:
    """Header of words above rows of numbers, None if they are remarks."""
    try:
        header = header_of([*words, *rows[:5]], style)
    except ValueError:
        return None
    return header if header.n_records == len(words) else None


def _is_header(header: Header, above: Header) -> bool:
    """Return whether words are the header of another part: it names columns of the part above, or another number."""
    names, others = ({split_unit(name)[0] for name in one.names} for one in (header, above))
    return bool(names & others) or len(names) != len(others)


def _fitted(
    lines: Sequence[int], rows: list[str], header: Header, style: Style, left: dict[str, list[tuple[int, str]]]
) -> tuple[Sequence[int], list[str]]:
    """Lines and records of the rows with as many cells as the header: filled up with empty ones, or left out."""
    sign, n_signs = style.separator, header.lead + len(header.names) - 1
    if sign == _BLANKS:
        sign, rows = " ", [" ".join(row.split()) for row in rows]
    counts = [row.count(sign) for row in rows]
    if counts.count(n_signs) == len(rows) and not any('"' in row for row in rows):
        return lines, rows
    kept: list[int] = []
    fitted: list[str] = []
    for line, row, count in zip(lines, rows, counts, strict=True):
        cells = _cells(row, sign) if '"' in row else []
        count = len(cells) - 1 if cells else count
        if not row.strip():
            continue
        if row.count('"') % 2 and sign != " ":
            left.setdefault("open a quote that nothing closes: they were left out", []).append((line, row))
            continue
        if count > n_signs:
            cells = cells or row.split(sign)
            if any(cell.strip() for cell in cells[n_signs + 1 :]):
                reason = f"have more cells than the {len(header.names)} of their header: they were left out"
                left.setdefault(reason, []).append((line, row))
                continue
            row = sign.join(f'"{cell}"' if sign in cell else cell for cell in cells[: n_signs + 1])
        elif count < n_signs and sign == " ":
            left.setdefault(_SHORT, []).append((line, row))
            continue
        kept.append(line)
        fitted.append(row + sign * (n_signs - count))
    return kept, fitted


def _parsed(rows: list[str], header: Header, style: Style, texts: set[int]) -> list[pa.ChunkedArray]:
    """Columns of rows: numbers, but texts if they are in `texts` or hold a cell that is no plain number."""
    names = [str(k - header.lead) for k in range(header.lead + len(header.names))]
    data = "\n".join(rows).replace("\0", "").encode()
    read = pyarrow_csv.ReadOptions(column_names=names, block_size=max(1 << 20, 4 * max(map(len, rows))))
    sign = " " if style.separator == _BLANKS else style.separator
    parse = pyarrow_csv.ParseOptions(
        delimiter=sign, newlines_in_values=b'"' in data, quote_char=False if sign == " " else '"'
    )

    def table(types: dict[str, pa.DataType]) -> pa.Table:
        convert = pyarrow_csv.ConvertOptions(
            column_types=types, null_values=_NULLS, strings_can_be_null=True, decimal_point=style.decimal,
            include_columns=names[header.lead :],
        )  # fmt: skip
        return pyarrow_csv.read_csv(pa.BufferReader(data), read, parse, convert)

    wanted = {name: pa.string() if int(name) in texts else pa.float64() for name in names[header.lead :]}
    try:
        return table(wanted).columns
    except pa.ArrowInvalid:
        pass
    cells = table(dict.fromkeys(wanted, pa.string()))
    found = []
    for name, kind in wanted.items():
        with suppress(pa.ArrowInvalid):
            if kind == pa.float64() and style.decimal == ".":
                found.append(cells.column(name).cast(kind))
                continue
        found.append(cells.column(name))
    return found


# --- numbers -------------------------------------------------------------------------------------------------------


def _columns(part: _Part, style: Style) -> Columns:
    """Columns of a part; the memory of its blocks is released."""
    found, numbers = Columns(), []
    for k, name in enumerate(part.header.names):
        blocks, part.columns[k] = part.columns[k], []
        if not any(pa.types.is_string(block.type) for block in blocks):
            numbers.append(np.concatenate([block.to_numpy() for block in blocks] or [np.empty(0)]))
            continue
        cells = pd.Series(np.concatenate([block.to_numpy() for block in blocks]), dtype=object)
        values, bad = numbers_of(cells, style.decimal, certain=style.certain)
        numbers.append(values)
        if bad is not None:
            found.broken[name] = (
                f"{str(cells[bad])[:40]!r} in line {part.line(bad)} of {name!r} is not a number as the others of its "
                "column are: write it as they are, or leave the cell empty"
            )
        given = cells.dropna()
        if not (style.certain or bad is not None or found.notes) and len(given):
            grouped = _GROUPED["," if style.decimal == "." else "."]
            if given.str.fullmatch(grouped).all():
                first, value = str(given.iloc[0]), values[given.index[0]]
                found.notes.append(f"{style.decimal!r} was taken as the decimal sign: {first!r} as {value:g}")
    _take(part.header, numbers, found)
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
    text = text.str.replace(r"∞|1[.,]#INF", "inf", regex=True)
    given = (text != "").to_numpy()
    read: list[tuple[npt.NDArray[np.bool_], FloatArray]] = []
    for sign in (decimal, "," if decimal == "." else "."):
        fits = text.str.fullmatch(_NUMBER[sign].pattern, case=False).to_numpy(dtype=bool)
        bare = text.where(fits, "nan").str.replace(f"[{_THOUSANDS.replace(sign, '')}]", "", regex=True)
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
    parts = text.str.lower().str.extract(_CLOCK)
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
        elif clock:
            shorter = len(series[clock]) < len(values)
            clocks[found.add(name, values[_filled(steps)] if shorter else values, unit)] = clock
        else:
            found.add(name, values, unit)


def _filled(values: FloatArray) -> npt.NDArray[np.bool_]:
    """Mask of the rows up to the last with a number, (n,)."""
    finite = np.flatnonzero(np.isfinite(values))
    return np.arange(len(values)) < (finite[-1] + 1 if len(finite) else 0)
