# SPDX-License-Identifier: Apache-2.0
"""Console output of all commands: progress bars, tables, and one-sentence errors with exit status 2.

Tables and results go to standard output, progress and messages to standard error, so that output can be piped.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import wraps
from io import TextIOBase, TextIOWrapper
from math import inf
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from tqdm import tqdm

from hydro_core.errors import UserError, is_user_error, user_message, writable_file, writable_folder
from hydro_core.files.atomic import encode_json, write_atomic
from hydro_core.process import termination

__all__ = [
    "Table", "UserError", "add_json_argument", "bounded_number", "command", "make_parser", "progress", "writable_file",
    "writable_folder",
]  # fmt: skip

T = TypeVar("T")
Number = TypeVar("Number", int, float)


def bounded_number(low: Number, high: float = inf) -> Callable[[str], Number]:
    """Return an argparse type: a finite number from `low` to `high`, of the type of `low`."""
    noun = "a whole number" if isinstance(low, int) else "a number"

    def convert(text: str) -> Number:
        with suppress(ValueError):
            if low <= (value := type(low)(text)) <= high and value < inf:
                return value
        raise argparse.ArgumentTypeError(f"{text}: must be {noun} within [{low:g}, {high:g}]")

    return convert


def command(*errors: type[Exception]) -> Callable[[Callable[[], int | None]], Callable[[], NoReturn]]:
    """Decorate a `main`: known errors are printed as one sentence, its return value becomes the exit status.

    Ctrl-C, SIGTERM and SIGHUP raise `termination.Terminated` in it: the status is 128 + the signal's number. `errors`:
    known errors in addition to `UserError` and to files that cannot be read or written; others keep their traceback.
    """

    def decorate(main: Callable[[], int | None]) -> Callable[[], NoReturn]:
        @wraps(main)
        def wrapped() -> NoReturn:
            for stream in (sys.stdout, sys.stderr):
                if isinstance(stream, TextIOWrapper):
                    stream.reconfigure(errors="replace")  # for a terminal that lacks some characters
            try:
                with termination.signals_as_exceptions():
                    status = main() or 0
            except BrokenPipeError:  # `| head` has closed the pipe: discard the buffered output
                with suppress(OSError):
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                sys.stderr.close()
                status = 0
            except KeyboardInterrupt as interruption:
                if reason := getattr(interruption, "reason", ""):
                    termination.print_error(reason)
                status = termination.exit_status(interruption)
            except Exception as error:
                if not (isinstance(error, errors) or is_user_error(error)):
                    raise
                termination.print_error(user_message(error))
                status = 2
            sys.exit(status)

        return wrapped

    return decorate


def progress(items: Iterable[T] | None = None, *, label: str = "", every: float = 0.0, **how: Any) -> tqdm[T]:
    """Return a progress bar on standard error: iterate over it, or `update` it; `how`: further options of tqdm.

    If standard error is not a terminal there is no bar, or with `every` one line every so many seconds.
    """
    if every and not sys.stderr.isatty():
        how |= {"file": _Lines(), "mininterval": every, "maxinterval": every, "ascii": True, "ncols": 0, "delay": every}
    else:
        how |= {"file": sys.stderr, "disable": None, "dynamic_ncols": True}
    bar: tqdm[Any] = tqdm(items, desc=label or None, **how)
    return bar


class _Lines(TextIOBase):
    """Standard error as a file that gets each state of a progress bar as a separate line."""

    def write(self, text: str) -> int:
        if line := text.strip("\r\n "):
            print(line, file=sys.stderr, flush=True)
        return len(text)


def print_above_progress(line: str) -> None:
    """Print a line on standard error, above a progress bar, if the terminal still exists."""
    with suppress(OSError, ValueError):
        tqdm.write(line, file=sys.stderr)


@dataclass
class Table:
    """Table of results: aligned text for people, and JSON with documented keys for programs."""

    columns: Mapping[str, str]
    """Key and meaning, with unit, of each column."""
    title: str = ""
    rows: list[dict[str, Any]] = field(default_factory=list)

    def add(self, **values: Any) -> None:
        """Add a row; a value is required for every column."""
        if set(values) != set(self.columns):
            raise ValueError(f"columns are {', '.join(self.columns)}, not {', '.join(values)}")
        self.rows.append(values)

    def text(self) -> str:
        """Return aligned columns below their keys, numbers right-aligned; the keys' meanings follow underneath."""
        columns = []
        for key in self.columns:
            cells = [key, *(format_cell(row[key]) for row in self.rows)]
            width, right = max(map(len, cells)), bool(self.rows) and not isinstance(self.rows[0][key], str)
            cells.insert(1, "-" * width)
            columns.append([f"{cell:{'>' if right else '<'}{width}}" for cell in cells])
        lines = ["  ".join(row).rstrip() for row in zip(*columns, strict=True)]
        meanings = [f"{key}: {meaning}" for key, meaning in self.columns.items() if meaning]
        return "\n".join([*filter(None, [self.title]), *lines, *meanings])

    def show(self, json_file: Path | str | None = None) -> None:
        """Print the table, and write it to `json_file` if given."""
        print(self.text())
        if json_file is not None:
            self.write_json(json_file)

    def write_json(self, path: Path | str) -> None:
        """Write `{"title", "columns": {key: meaning}, "rows": [{key: value}]}`; non-finite values become null."""
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_atomic(Path(path), encode_json({"title": self.title, "columns": self.columns, "rows": self.rows}))


def plural(count: int, noun: str) -> str:
    """Return a count with its noun: `1 episode`, `2 episodes`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def make_parser(name: str, text: str | None, **more: Any) -> argparse.ArgumentParser:
    """Return the argument parser of a command; `text`: its description, `more`: options of argparse."""
    raw = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(prog=name, description=text, formatter_class=raw, **more)


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option `--json FILE` that every command with a table has."""
    parser.add_argument(
        "--json", type=writable_file, metavar="FILE", help="also write the table to FILE, keys documented in it"
    )


def format_cell(value: Any) -> str:
    """Return the text of a table cell: a float with four significant digits, None as an empty string."""
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def explicit_options(parser: argparse.ArgumentParser, words: Sequence[str]) -> dict[str, Any]:
    """Return the options given explicitly in `words`, by name; those left at their defaults are omitted."""
    absent = object()
    names = vars(parser.parse_args(words))
    said = vars(parser.parse_args(words, argparse.Namespace(**dict.fromkeys(names, absent))))
    return {name: value for name, value in said.items() if value is not absent}
