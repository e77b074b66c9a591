# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis inspect FILE...`: what a recording holds, and what of it the diagnosis would use."""

from __future__ import annotations

import argparse
import difflib
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hydro_bridge.console import Table, add_json_argument, command
from hydro_diagnosis.columns import TARGETS, ColumnMap
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.importers import SUFFIXES, read_columns
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.table import read_table

COLUMNS = {
    "recording": "",
    "column": "name in the file",
    "count": "numbers in it",
    "low": "smallest",
    "high": "largest",
    "used": "the field that it becomes; `?`: a field that it may be, map it by --columns",
}


def listed(path: Path, columns: ColumnMap | None, table: Table) -> None:
    """Add a row per column.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    if path.suffix.lower() not in SUFFIXES:
        raw = read_table(path)
        for name, values in {"time": raw.time, **raw.columns}.items():
            table.add(recording=path.name, column=name, **_range(values), used=name)
        return
    if not path.exists():
        raise InputError(f"{path}: there is no such recording")
    found = read_columns(path)
    becomes = {source.column: field for field, source in columns.sources.items()} if columns else {}
    for name, values in found.series.items():
        field = becomes.get(name, "") if columns else _guess(name)
        table.add(recording=path.name, column=name, **_range(values), used=field)
    for name, number in found.constants.items():
        table.add(recording=path.name, column=name, count=1, low=number, high=number, used="a number for --columns")
    for name in found.other:
        table.add(
            recording=path.name, column=name, count=0, low=np.nan, high=np.nan, used="not numbers, or another length"
        )


def _range(values: FloatArray) -> Mapping[str, float]:
    finite = values[np.isfinite(values)]
    return {"count": len(finite), "low": float(finite.min(initial=np.inf)), "high": float(finite.max(initial=-np.inf))}


def _guess(name: str) -> str:
    if name in TARGETS:
        return name
    close = difflib.get_close_matches(name.lower(), TARGETS, 1, cutoff=0.7)
    return f"{close[0]}?" if close else ""


@command(InputError)
def main() -> int:
    """Entry point."""
    options = argparse.ArgumentParser(prog="inspect", description="List what recordings hold, column by column.")
    options.add_argument("recordings", nargs="+", type=Path, metavar="FILE", help="as for diagnose")
    options.add_argument("--columns", metavar="MAP", help="as for diagnose: shows what it would make of the columns")
    add_json_argument(options)
    chosen = options.parse_args(sys.argv[1:])
    columns = ColumnMap.load(chosen.columns)
    table = Table(COLUMNS)
    for path in chosen.recordings:
        listed(path, columns, table)
    table.show(chosen.json)
    return 0


if __name__ == "__main__":
    main()
