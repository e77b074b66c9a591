# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_diagnosis inspect FILE...`: contents of recordings, and a proposed column map (`column_matching`)."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags import is_bag, split_location
from hydro_core.cli.console import Table, add_json_argument, command, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import FloatArray
from hydro_diagnosis.bench_parameters import EQUATION_REQUIREMENTS, read_bench
from hydro_diagnosis.column_matching import as_yaml, propose_sources
from hydro_diagnosis.io.column_map import ColumnMap, Source
from hydro_diagnosis.io.columns import Columns, is_time
from hydro_diagnosis.io.table import columns_of, table_of
from hydro_diagnosis.io.units import quantity, split_unit, to_si
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.wiring import check_plausibility
from hydro_sim.model.bench import Bench

IDENTIFIED_EFFECTS = {
    "pressure equations": "leaks, valve, oil and volumes",
    "motion equation": "friction, mass and end stops",
    "load equation": "the load's damping and play, and the load cell",
    "force of the pressures": "the pressure sensors and the hydraulic force's scale",
}
"""Effects that each equation identifies."""


def read_beginning(path: Path) -> Columns:
    """Read the columns of a file; of a bag of which no part is named, those of its first 600 s. Raises InputError."""
    whole = not is_bag(path) or split_location(path)[1] is not None
    return columns_of(path if whole else Path(f"{path}#t=,600"))


def sparkline(values: FloatArray) -> str:
    """Sparkline of the medians of 24 equal parts, smallest (▁) to largest (█); parts without numbers are blank."""
    levels, parts = "▁▂▃▄▅▆▇█", np.array_split(values, min(24, len(values))) if len(values) else []
    middles = np.array([np.nanmedian(part) if np.isfinite(part).any() else np.nan for part in parts])
    if not np.isfinite(middles).any():
        return ""
    low, high = float(np.nanmin(middles)), float(np.nanmax(middles))
    span = high - low if high > low else 1.0
    return "".join(
        " " if not np.isfinite(one) else levels[min(int((one - low) / span * len(levels)), len(levels) - 1)]
        for one in middles
    )


COLUMNS = {
    "recording": "",
    "column": "name in the file",
    "unit": "as the file states it",
    "count": "numbers in it",
    "rate": "per second, by its own times",
    "low": "smallest",
    "high": "largest",
    "shape": "over the recording, from the smallest to the largest",
    "used": "the field that it becomes; `?`: proposed, to be confirmed by --columns",
}


def list_columns(name: str, found: Columns, columns: ColumnMap | None, table: Table, bench: Bench) -> ColumnMap:
    """Add a row per column of a recording to `table`; returns the column map, proposed if `columns` is None."""
    chosen = propose_sources(found, bench) if columns is None else columns.completed(found.series)
    becomes = {source.column: field for field, source in chosen.sources.items()}

    def add(column: str, used: str, values: npt.ArrayLike = (), unit: str = "", rate: float = np.nan) -> None:
        numbers = np.asarray(values, np.float64)
        finite = numbers[np.isfinite(numbers)]
        low, high = (finite.min(), finite.max()) if len(finite) else (np.nan, np.nan)
        table.add(recording=name, column=column, unit=unit, count=len(finite), rate=rate, low=float(low),
                  high=float(high), shape=sparkline(numbers) if len(numbers) > 1 else "", used=used)  # fmt: skip

    for column, values in found.series.items():
        field = becomes.get(column, "")
        sure = columns is not None or column == field
        used = field if sure or not field else f"{field}?"
        add(column, used, values, found.units.get(column, ""), _rate(column, found, chosen))
    for column, number in found.constants.items():
        add(column, "one number: a factor or offset in --columns", [number])
    for column in found.other:
        add(column, "not numbers, or another length")
    for column in found.broken:
        add(column, "not read: see below")
    return chosen


def _rate(name: str, found: Columns, chosen: ColumnMap) -> float:
    """Sampling rate [Hz] of a column, by its clock, else by the mapped time; NaN if unknown."""
    mapped = chosen.sources.get("time")
    clock = found.clocks.get(name) or (mapped.column if mapped else "")
    if not clock and is_time(name, found.series[name]):
        clock = name
    if clock not in found.series or len(found.series[clock]) != len(found.series[name]):
        return float("nan")
    steps = np.diff(found.series[clock])
    steps = steps[steps > 0.0]
    unit = found.unit(clock) or (mapped.unit if mapped else "")
    every = np.diff(found.series[clock]).size / max(len(steps), 1)
    return float(every / (np.median(steps) * to_si(unit))) if len(steps) and quantity(unit or "s") else float("nan")


def arguments() -> argparse.ArgumentParser:
    """Return the command-line parser."""
    options = argparse.ArgumentParser(
        prog="inspect", description="List what recordings hold, and propose a column map."
    )
    options.add_argument(
        "recordings", nargs="+", type=Path, metavar="FILE", help="as for diagnose; of a bag its first 600 s are listed"
    )
    options.add_argument("--columns", metavar="MAP", help="as for diagnose: shows what it would make of the columns")
    options.add_argument("--bench", type=Path, metavar="FILE", help="as for diagnose: what numbers are likely")
    options.add_argument(
        "--write", type=writable_file, metavar="FILE", help="write the proposed map of the first FILE, YAML"
    )
    add_json_argument(options)
    return options


@command(InputError, ValueError)
def main() -> int:
    """Entry point."""
    chosen = arguments().parse_args(sys.argv[1:])
    columns = ColumnMap.load(chosen.columns)
    bench = read_bench(chosen.bench) if chosen.bench else Bench.nominal()
    table, maps, remarks = Table(COLUMNS), [], []
    for path in chosen.recordings:
        found = read_beginning(path)
        maps.append(list_columns(path.name, found, columns, table, bench))
        said = plausibility_warnings(path, found, maps[-1], bench)
        if columns is None:
            said += [_advice(maps[-1]), *missing_equations(maps[-1])]
        said += [*found.notes, *found.broken.values(), *found.unsure.values()]
        if columns is None:
            said += unit_mismatches(found, maps[-1], bench)
        remarks += [f"{path.name}: {sentence}" for sentence in said]
    table.show(chosen.json)
    for remark in remarks:
        print(remark)
    if chosen.write and maps[0].sources.keys() <= {"time"}:
        raise InputError(f"{chosen.write} was not written: no signal of {chosen.recordings[0].name} is known")
    if chosen.write:
        try:
            table_of(chosen.recordings[0], read_beginning(chosen.recordings[0]), maps[0])
        except InputError as error:
            raise InputError(f"{chosen.write} was not written, since diagnose could not read by it: {error}") from None
        Path(chosen.write).parent.mkdir(parents=True, exist_ok=True)
        write_atomic(Path(chosen.write), as_yaml(maps[0]).encode())
        print(f"{chosen.write}: the map of {chosen.recordings[0].name}")
    return 0


def _advice(proposal: ColumnMap) -> str:
    if not proposal.sources:
        return "no column looks like a field: map them by --columns time=NAME,piston_position=NAME,..."
    if not proposal.corrections().sources:
        return "its columns carry the fields' own names: no map is needed"
    if set(proposal.sources) == {"time"}:
        return f'no signal is known by name or unit: map them by --columns "{proposal},piston_position=NAME[mm],..."'
    return f'proposed, to be checked: --columns "{proposal}"'


def plausibility_warnings(path: Path, found: Columns, columns: ColumnMap, bench: Bench) -> list[str]:
    """Return a warning for each mapped field with values that are implausible for the bench; `found`: the columns."""
    try:
        doubts = check_plausibility(table_of(path, found, columns), bench).doubts
    except InputError:
        return []
    return [
        f"{doubt[0].field} has numbers that this bench cannot have: perhaps "
        + ", or ".join(one.sentence for one in doubt)
        for doubt in doubts
    ]


def unit_mismatches(found: Columns, proposal: ColumnMap, bench: Bench) -> list[str]:
    """Return a sentence per unmapped field with a column of matching name, but with a unit of another quantity."""
    taken = {source.column for source in proposal.sources.values()}
    left = {split_unit(name)[0]: name for name in found.series if name not in taken and found.unit(name)}
    bare = replace(found, units={}, series={own: found.series[name] for own, name in left.items()})
    likely = (
        {field: left[source.column] for field, source in propose_sources(bare, bench).sources.items()} if left else {}
    )
    return [
        f"{name!r} may be the {field}, but is in {found.unit(name)}: give a factor to SI, as in "
        f"{field}={Source(name, factor=0.001)}"
        for field, name in likely.items()
        if field not in proposal.sources and field != "time"
    ]


def missing_equations(proposal: ColumnMap) -> list[str]:
    """Return a clause per equation that cannot be checked, with the fields that it lacks."""
    there = proposal.sources.keys()
    lacking: dict[str, list[str]] = {}
    for one in EQUATION_REQUIREMENTS:
        lacking.setdefault(one.equation, []).append(", ".join(sorted(one.channels - there)))
    return [
        f"{IDENTIFIED_EFFECTS[equation]} cannot be identified without {' or '.join(ways)}"
        for equation, ways in lacking.items()
        if all(ways)
    ]


if __name__ == "__main__":
    main()
