# SPDX-License-Identifier: Apache-2.0
"""Text tables of any logger: records, headers and numbers, a block of the file at a time.

A file is a sequence of records: lines, joined where a quoted cell holds line breaks. Each record is a row of numbers,
words (a header, where names stand above as many numbers; else a remark) or blank. What is not read is counted, and
named by its first line.

A block in which each record is a row goes to pyarrow as it is; the records of any other are told apart one by one. A
column with a cell that pyarrow cannot read is read by the format that fits all of its cells: a decimal sign with
thousands, or times of day. If none does, its first unreadable cell and line are reported.
"""

from __future__ import annotations

import csv
import re
from codecs import getincrementaldecoder
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, groupby, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as pyarrow_csv

from hydro_core.signals import FloatArray
from hydro_diagnosis.io.columns import Columns, counts_rows, is_time, merge_parts, set_day_units, stated_step, unique
from hydro_diagnosis.io.units import UNIT_FACTORS, known, split_unit, stated

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
_WORDS = re.compile(r"[\s\"]*(?:[-*=<>/!]*\s*(?!nan\b|inf\b)[^\W\d_#%\[]|[_#%\[])", re.IGNORECASE)
"""Beginning of a record of words."""
_MAX_LINES = 40
"""Largest number of lines of one record."""
_LAST_ROWS = 200
"""Rows with which the separator is judged, and whether the last one was cut."""
_REMARK = "hold words: their neighbours were joined"
_SHORT = "have fewer numbers than the others"
_OPEN = "open a quote that nothing closes: they were left out"
_CUT = "end the file within a row or number: they were left out"


class Style(NamedTuple):
    """Separator and decimal sign of a text table."""

    separator: str
    decimal: str
    certain: bool
    """Whether some cell can be parsed with this decimal sign only."""

    def cells(self, record: str) -> list[str]:
        """Cells of a record, without quotes and line breaks."""
        if self.separator == _BLANKS:
            return record.split()
        csv.field_size_limit(1 << 24)
        reader = csv.reader([record.replace("\0", "")], delimiter=self.separator, skipinitialspace=True)
        return [" ".join(cell.split("\n")).strip() for cell in next(reader, [])]

    def number(self, cell: str) -> bool:
        """Whether a cell is a number; one with a decimal point is one among decimal commas, too."""
        return any(_NUMBER[sign].fullmatch(cell) for sign in {self.decimal, "."})

    def row(self, cells: list[str]) -> bool:
        """Whether most of the cells are numbers or times of day, and these are two or more cells."""
        given = [cell for cell in cells if cell]
        numbers = sum(len(one) < 100 and (self.number(one) or bool(re.search(_CLOCK, one))) for one in given)
        return len(cells) > 1 and numbers > 0 and 2 * numbers > len(given)


class _Header(NamedTuple):
    """Header above rows of numbers."""

    n_records: int  # before the first row of numbers
    lead: int  # cells before the first number of a row: 1 where the rows begin with a key
    n_cells: int  # of a row, the lead and an empty last one among them
    names: tuple[str, ...]  # of the columns, each unique; those beyond the rows' cells are empty columns
    named: bool  # whether the file states the names
    worded: bool  # whether the first row begins with a word
    units: tuple[str, ...]  # normalised by `units.stated`; empty if not stated
    start: float
    step: float  # s, sampling step if the header states one, else 0


@dataclass
class _Part:
    """Rows of numbers below one header."""

    header: _Header
    columns: list[list[pa.ChunkedArray]]  # numbers or texts of each column, by block
    lines: list[Sequence[int]] = field(default_factory=list)  # of each row, by block
    texts: set[int] = field(default_factory=set)  # columns that are no plain numbers


def text_columns(path: Path) -> Columns:
    """Read a table of text. Raises ValueError, OSError, pandas.errors.EmptyDataError if it cannot be read."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    if not head.strip():
        raise pd.errors.EmptyDataError(str(path))
    encoding = _encoding(head)
    lines = head.decode(encoding, errors="replace").splitlines()
    style = style_of(lines[:-1] if len(head) == 1 << 16 else lines)
    parts, notes = _parts(path, encoding, style)
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
    """Return the separator and decimal sign with which most cells of the last lines parse as numbers."""
    last = [line for line in lines[-_LAST_ROWS:] if line.strip()]
    best, most = Style(",", ".", certain=False), -1
    for decimal, other in (".,", ",."):
        plain = re.compile(_PLAIN[decimal], re.IGNORECASE)
        for separator in (";", "\t", _BLANKS, ",", "|"):
            tried = Style(separator, decimal, certain=False)
            rows = (tried.cells(line) for line in last if separator != _BLANKS or not re.search("[;\t|]", line))
            cells = [cell for row in rows if len(row) > 1 for cell in row if cell and len(cell) < 100]
            numbers = [cell for cell in cells if tried.number(cell)]
            score = sum(3 if plain.fullmatch(cell) else 1 if " " in cell else 2 for cell in numbers) - len(cells)
            if numbers and score > most:
                strict = (cell for cell in numbers if _NUMBER[decimal].fullmatch(cell))
                best = tried._replace(certain=any(not _NUMBER[other].fullmatch(cell) for cell in strict))
                most = score
    return best


# --- headers -------------------------------------------------------------------------------------------------------


def header_of(records: list[str], style: Style) -> _Header:
    """Header above the first row of numbers. Raises ValueError without one, or if decimal commas split cells."""
    rows = [style.cells(record) for record in records]

    def lead(at: int) -> int:
        """Return 1 if a row begins with a key and the next with an empty cell, else 0."""
        keyed = any(rows[at][:1]) and not style.number(rows[at][0])
        return int(keyed and (at + 1 >= len(rows) or rows[at + 1][:1] == [""]))

    def numbers_begin(at: int) -> bool:
        below = [row for row in rows[at + 1 : at + 5] if any(row)]
        return all(map(style.row, (rows[at][lead(at) :], *below)))

    # ControlDesk's key of the first row of numbers: rows above it may hold numbers too (flags, limits)
    marked = [k for k, row in enumerate(rows) if row and row[0].lower() == "trace_values"]
    first = marked[0] if marked else next(filter(numbers_begin, range(len(rows))), None)
    if first is None:
        raise ValueError("there is no row of two numbers or more in it")
    alike = [k for k, row in enumerate(rows[:first]) if len(row) == len(rows[first]) and style.number(row[0])]
    alike = [k for k in alike if not marked and style.row(rows[k])]
    if len(alike) > 5:  # remarks between all rows: these are no header
        first = alike[0]
    begin = lead(first)
    body = rows[first][begin:]
    ends_empty = all(not row or row[-1] == "" for row in rows[first:])  # a separator behind which nothing stands
    width = len(body) - (len(body) > 2 and ends_empty)
    above = _header_rows(records[:first], [row[begin:] for row in rows[:first]], width, style.separator)
    words = [row for row in above if not any(map(style.number, row))]
    if style[:2] == (",", ".") and any(width == 2 * len(row) for row in words):
        raise ValueError(
            f"line {first + 1} has {width} cells under half as many names: write decimal points, or semicolons between "
            "the columns"
        )
    pairs = any(row[0].lower() == "name" and row.count(row[0]) > 1 for row in above)  # a key, repeated for each clock
    names, units = _names_and_units(above, width, pairs=pairs)
    named, width = any(names), max(width, len(names))
    names, units = ([*some, *[""] * width][:width] for some in (names, units))
    unnamed = "time" if named and (pairs or begin) else "column {}"
    names = [name.lstrip("#% ") or unnamed.format(k) for k, name in enumerate(names)]
    units = [stated(unit) or split_unit(name)[1] for name, unit in zip(names, units, strict=True)]
    distinct: dict[str, None] = {}
    for name in names:
        distinct[unique(name, distinct)] = None
    step = stated_step(_properties([row for row in rows[:first] if any(row)] if begin else above))
    return _Header(first, begin, len(rows[first]), tuple(distinct), named, bool(_WORDS.match(records[first])),
                   tuple(units), *step)  # fmt: skip


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


def _names_and_units(above: list[list[str]], width: int, *, pairs: bool) -> tuple[list[str], list[str]]:
    """Names and units, as far as there are any: the row with most units, and of the others that with most names."""
    wide = [row for row in reversed(above) if width <= len(row) <= width + 3]
    if pairs:
        wide = [["" if cell == row[0] else cell for cell in row] for row in wide]
    units = next(filter(_are_units, wide), []) if len(wide) > 1 else []
    names = max((row for row in wide if row is not units), key=lambda row: len(set(row[:width])), default=[])
    while names and not names[-1]:
        names = names[:-1]
    return names, [unit or "ms" for unit in units] if pairs else units


def _are_units(row: list[str]) -> bool:
    """Return whether the cells of a row are units: most are known, or all are in brackets."""
    number = Style("", ",", certain=False).number
    cells = [cell for cell in row if cell and cell not in ("-", "[-]") and not number(cell)]
    if not cells:
        return not any(row)
    bracketed = all(cell[0] + cell[-1] in ("[]", "()") for cell in cells)
    return bracketed or 2 * sum(bool(known(cell)) for cell in cells) > len(cells)


# --- records -------------------------------------------------------------------------------------------------------

_Lines = list[tuple[int, str]]
"""Lines with their numbers, from 1."""


def _records(path: Path, encoding: str, style: Style, left: dict[str, _Lines]) -> Iterator[tuple[list[int], list[str]]]:
    """Yield blocks of records, each with the line on which it begins; a last row that is cut is added to `left`."""
    at, rest, recent = 1, "", list[str]()
    with path.open(encoding=encoding, errors="replace") as file:
        for text in chain(iter(partial(file.read, 1 << 22), ""), [""]):
            lines = (rest + text).split("\n")
            rest = lines.pop() if text else ""
            if len(rest) > 1 << 24:
                raise ValueError(f"line {at + len(lines)} is longer than 16 MB: it is no table")
            if not text and lines[0] and _is_cut(lines[0], recent, style):  # alone, for no line break ends it
                left[_CUT] = [(at, lines[0])]
                return
            numbers, records = list(range(at, at + len(lines))), lines
            at += len(lines)
            if style.separator != _BLANKS and any(line.count('"') % 2 for line in lines):
                numbers, records, is_open = [], [], False
                for number, line in enumerate(lines, at - len(lines)):
                    if is_open and number - numbers[-1] < _MAX_LINES and not style.row(style.cells(line)):
                        records[-1] += f"\n{line}"
                    else:
                        numbers.append(number)
                        records.append(line)
                        is_open = False
                    is_open ^= line.count('"') % 2 == 1
                if is_open and text:
                    at, rest = numbers.pop(), f"{records.pop()}\n{rest}"
            yield numbers, records
            recent = records[-_LAST_ROWS:]


def _is_cut(last: str, recent: list[str], style: Style) -> bool:
    """Return whether a row that no line break ends was cut: fewer cells, a shorter number, or an unlikely jump."""
    cells, rows = style.cells(last), [row for row in map(style.cells, recent) if style.row(row)]
    lengths = [len(row) for row in rows]
    width = max(lengths, key=lengths.count, default=0)
    rows = [row for row in rows if len(row) == width and row[-1]]
    if _WORDS.match(last) or not rows:
        return False
    if len(cells) < width or len(cells[-1]) < min(len(row[-1]) for row in rows):
        return True
    ends = numbers_of(pd.Series([*(row[-1] for row in rows), cells[-1]], dtype=object), style.decimal)[0]
    steps = np.abs(np.diff(ends))
    return bool(len(steps) > 1 and not steps[-1] <= 3.0 * np.nanmax(steps[:-1], initial=0.0))


def _parts(path: Path, encoding: str, style: Style) -> tuple[list[_Part], list[str]]:
    """Parts of a file, and notes on what was not read."""
    parts: list[_Part] = []
    left: dict[str, _Lines] = {}  # by reason
    words: _Lines = []  # since the last row

    def begin(header: _Header) -> None:
        texts = set() if style.certain else set(range(len(header.names)))
        parts.append(_Part(header, [[] for _ in header.names], texts=texts))

    for lines, records in _records(path, encoding, style, left):
        if not parts:
            begin(header_of(records[:400], style))
            lines, records = lines[parts[0].header.n_records :], records[parts[0].header.n_records :]
        part = parts[-1]
        if not words and not any(map(_WORDS.match, records)):
            with suppress(pa.ArrowInvalid):
                _add(part, lines, _numbers(records, part, style))
                continue
        for worded, run in groupby(
            zip(lines, records, strict=True), lambda one: _is_words(one[1], parts[-1].header, style)
        ):
            if worded:
                words += run
                continue
            if not (some := [one for one in run if one[1].strip()]):
                continue
            doubtful = [one for one in words if style.row(style.cells(one[1]))]  # a footer, if no row followed
            words, some = [one for one in words if one not in doubtful], [*doubtful, *some]
            below = _header_below(words, [record for _, record in some], parts[-1].header, style)
            if below is not None:
                begin(below)
            elif words:
                left.setdefault(_REMARK, []).extend(words)
            words, part = [], parts[-1]
            fitted = list(_fitted(some, part.header, style, left))
            rows = [row for _, row in fitted]
            if rows:
                _add(part, [line for line, _ in fitted], _numbers(rows, part, style, fallback=True))
    if not parts:
        raise ValueError("there is no row of two numbers or more in it")
    if words:
        left.setdefault(_REMARK, []).extend(words)
    short = [line for line, _ in left.pop(_SHORT, ()) if line < max((one[-1] for one in parts[-1].lines), default=0)]
    if short:
        raise ValueError(
            f"line {short[0]} has fewer numbers than the others: write nan, or separate the columns by another sign"
        )
    notes = [
        f"{len(some)} lines {reason} (from line {some[0][0]} on: {' '.join(some[0][1].split())[:40]!r})"
        for reason, some in left.items()
    ]
    return parts, notes


def _is_words(record: str, header: _Header, style: Style) -> bool:
    return _WORDS.match(record) is not None and not (header.worded and style.row(style.cells(record)))


def _header_below(words: _Lines, rows: list[str], above: _Header, style: Style) -> _Header | None:
    """Header of words above rows of numbers, None if they are remarks: it names columns, or another number of them."""
    header = None
    with suppress(ValueError):
        header = header_of([*(word for _, word in words), *rows[:5]], style) if words else None
    if header is None or header.n_records != len(words) or not header.named:
        return None
    names, others = ({split_unit(name)[0] for name in one.names} for one in (header, above))
    return header if names & others or len(names) != len(others) else None


def _fitted(rows: _Lines, header: _Header, style: Style, left: dict[str, _Lines]) -> Iterator[tuple[int, str]]:
    """Yield rows with as many cells as the header's, filled up with empty ones; others are added to `left`."""
    sign, width = style.separator, header.n_cells
    for line, row in rows:
        if sign != _BLANKS and '"' not in row and row.count(sign) == width - 1:
            yield line, row
            continue
        cells = style.cells(row)
        if sign != _BLANKS and row.count('"') % 2:
            left.setdefault(_OPEN, []).append((line, row))
        elif any(cells[max(width, header.lead + len(header.names)) :]):
            reason = f"have more cells than the {len(header.names)} of their header: they were left out"
            left.setdefault(reason, []).append((line, row))
        elif sign == _BLANKS and 0 < len(cells) < width:
            left.setdefault(_SHORT, []).append((line, row))
        elif row.strip():
            cells = [f'"{cell}"' if sign in cell else cell for cell in [*cells, *[""] * width][:width]]
            yield line, (" " if sign == _BLANKS else sign).join(cells)


def _numbers(rows: list[str], part: _Part, style: Style, *, fallback: bool = False) -> list[pa.ChunkedArray]:
    """Columns of rows with as many cells as the header's: numbers, or texts of those that hold no plain numbers.

    Raises pyarrow.ArrowInvalid on others, unless `fallback` adds their columns to the texts.
    """
    names = list(map(str, range(part.header.n_cells)))
    wanted = dict.fromkeys(names[part.header.lead :][: len(part.columns)], pa.float64())
    wanted |= dict.fromkeys([name for name in wanted if int(name) - part.header.lead in part.texts], pa.string())
    sign = " " if style.separator == _BLANKS else style.separator
    rows = [" ".join(row.split()) for row in rows] if sign == " " else rows
    data = "\n".join(rows).replace("\0", "").encode()
    read = pyarrow_csv.ReadOptions(column_names=names, block_size=max(1 << 20, 4 * max(map(len, rows), default=0)))
    parse = pyarrow_csv.ParseOptions(
        delimiter=sign, newlines_in_values=b'"' in data, quote_char=False if sign == " " else '"'
    )

    def table(types: dict[str, pa.DataType]) -> pa.Table:
        convert = pyarrow_csv.ConvertOptions(
            column_types=types, null_values=_NULLS, strings_can_be_null=True, decimal_point=style.decimal,
            include_columns=list(wanted),
        )  # fmt: skip
        found = pyarrow_csv.read_csv(pa.BufferReader(data), read, parse, convert)
        if found.num_rows != len(rows):  # blank lines
            raise pa.ArrowInvalid
        return found

    try:
        return table(wanted).columns
    except pa.ArrowInvalid:
        if not fallback:
            raise
    cells = table(dict.fromkeys(wanted, pa.string()))
    for name, kind in wanted.items():
        with suppress(pa.ArrowInvalid):
            if kind == pa.float64() and style.decimal == ".":
                cells = cells.set_column(cells.column_names.index(name), name, cells.column(name).cast(kind))
    return cells.columns


def _add(part: _Part, lines: Sequence[int], columns: list[pa.ChunkedArray]) -> None:
    part.texts |= {k for k, column in enumerate(columns) if pa.types.is_string(column.type)}
    part.lines.append(lines)
    for blocks, column in zip(part.columns, columns, strict=False):
        blocks.append(column)


# --- numbers -------------------------------------------------------------------------------------------------------


def _columns(part: _Part, style: Style) -> Columns:
    """Columns of a part; the memory of its blocks is released."""
    found, numbers, length = Columns(), [], sum(map(len, part.lines))
    for k, name in enumerate(part.header.names):
        blocks, part.columns[k] = part.columns[k], []
        if k not in part.texts or not blocks:
            numbers.append(
                np.concatenate([block.to_numpy() for block in blocks]) if blocks else np.full(length, np.nan)
            )
            continue
        texts = [pc.replace_substring(block.cast(pa.string()), ".", style.decimal) if pa.types.is_floating(block.type)
                 else block for block in blocks]  # fmt: skip
        cells = pd.Series(np.concatenate([block.to_numpy() for block in texts]), dtype=object)
        values, bad = numbers_of(cells, style.decimal, certain=style.certain)
        numbers.append(values)
        if bad is not None:
            line = next(islice(chain.from_iterable(part.lines), bad, None))
            found.broken[name] = (
                f"{str(cells[bad])[:40]!r} in line {line} of {name!r} is not a number as the others of its "
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
    only. The index is None if all cells or none can be parsed.
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
    if not len(bad):
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


def _take(header: _Header, columns: list[FloatArray], found: Columns) -> None:
    """Add the columns of a part; a time column is the clock of those to its right, and is added once."""
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
