# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis inspect FILE...`: what recordings hold, and a column map for them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hydro_bridge.cli.console import Table, add_json_argument, command, writable
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.signals import FloatArray
from hydro_diagnosis.formats.file_columns import Columns, named_like_time, runs_forward
from hydro_diagnosis.formats.units import UNITS
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.proposal import as_yaml, proposed
from hydro_diagnosis.io.sparkline import sparkline
from hydro_diagnosis.recording import InputError
from hydro_sim.model.bench import Bench

COLUMNS = {
    "recording": "",
    "column": "name in the file",
    "unit": "as the file states it",
    "count": "numbers in it",
    "rate": "per second, by its own times",
    "low": "smallest",
    "high": "largest",
    "shape": "over the recording, from the smallest to the largest",
    "used": "the field that it becomes; `?`: a field that it may be, map it by --columns",
}


def listed(path: Path, columns: ColumnMap | None, table: Table, bench: Bench) -> ColumnMap:
    """Add a row per column; returns the map, proposed if none is given.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    from hydro_diagnosis.io.table import columns_of  # late: pandas and scipy are not for --help or a slip

    found = columns_of(path)
    chosen = proposed(found, bench) if columns is None else columns.completed(found.series)
    becomes = {source.column: field for field, source in chosen.sources.items()}
    for name, values in found.series.items():
        field = becomes.get(name, "")
        sure = columns is not None or name == field
        table.add(
            recording=path.name,
            column=name,
            unit=found.units.get(name, ""),
            **_range(values),
            rate=_rate(name, found, chosen),
            shape=sparkline(values),
            used=field if sure or not field else f"{field}?",
        )
    for name, number in found.constants.items():
        _add_plain(table, path, name, 1, number, "a number for --columns")
    for name in found.other:
        _add_plain(table, path, name, 0, np.nan, "not numbers, or another length")
    return chosen


def _add_plain(table: Table, path: Path, name: str, count: int, number: float, used: str) -> None:
    table.add(
        recording=path.name,
        column=name,
        unit="",
        count=count,
        rate=np.nan,
        low=number,
        high=number,
        shape="",
        used=used,
    )


def _range(values: FloatArray) -> Mapping[str, float]:
    finite = values[np.isfinite(values)]
    return {"count": len(finite), "low": float(finite.min(initial=np.inf)), "high": float(finite.max(initial=-np.inf))}


def _rate(name: str, found: Columns, chosen: ColumnMap) -> float:
    """Samples per second, by a column's clock, else by the column that the map takes for the time."""
    mapped = chosen.sources.get("time")
    clock = found.clocks.get(name) or (mapped.column if mapped else "")
    if not clock and named_like_time(name) and runs_forward(found.series[name]):
        clock = name
    if clock not in found.series or len(found.series[clock]) != len(found.series[name]):
        return float("nan")
    steps = np.diff(found.series[clock])
    steps = steps[steps > 0.0]
    unit = found.units.get(clock) or (mapped.unit if mapped and mapped.column == clock else "")
    return float(1.0 / (np.median(steps) * UNITS.get(unit, 1.0))) if len(steps) else float("nan")


def arguments() -> argparse.ArgumentParser:
    """The command line."""
    options = argparse.ArgumentParser(
        prog="inspect", description="List what recordings hold, and propose a column map."
    )
    options.add_argument("recordings", nargs="+", type=Path, metavar="FILE", help="as for diagnose")
    options.add_argument("--columns", metavar="MAP", help="as for diagnose: shows what it would make of the columns")
    options.add_argument("--bench", type=Path, metavar="FILE", help="as for diagnose: what numbers are likely")
    options.add_argument(
        "--write", type=writable, metavar="FILE", help="write the proposed map of the first FILE, YAML"
    )
    add_json_argument(options)
    return options


@command(InputError, ValueError)
def main() -> int:
    """Entry point."""
    chosen = arguments().parse_args(sys.argv[1:])
    columns = ColumnMap.load(chosen.columns)
    bench = Bench.load(chosen.bench) if chosen.bench else Bench.nominal()
    table = Table(COLUMNS)
    maps = [listed(path, columns, table, bench) for path in chosen.recordings]
    table.show(chosen.json)
    if columns is None:
        for path, proposal in zip(chosen.recordings, maps, strict=True):
            print(_advice(path, proposal))
    if chosen.write:
        Path(chosen.write).parent.mkdir(parents=True, exist_ok=True)
        write_whole(Path(chosen.write), as_yaml(maps[0]).encode())
        print(f"{chosen.write}: the map of {chosen.recordings[0].name}")
    return 0


def _advice(path: Path, proposal: ColumnMap) -> str:
    if not proposal.sources:
        return f"{path.name}: no column looks like a field: map them by --columns time=NAME,piston_position=NAME,..."
    if not proposal.corrections().sources:
        return f"{path.name}: its columns carry the fields' own names: no map is needed"
    return f'{path.name}: proposed, to be checked: --columns "{proposal}"'


if __name__ == "__main__":
    main()
