# SPDX-License-Identifier: Apache-2.0
"""The diagnosis on one recording in other units, directions and orders: the answer must stay the same.

    python -m benchmarks.invariances --data FOLDER --json FILE

FOLDER: as of `benchmarks.fuzz_recordings`. Names must be equal, and sizes up to the known factor, to 1 % or a tenth of
their interval. Any other answer gives exit status 1.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import resample_poly

from benchmarks._report import parser
from benchmarks.fuzz_recordings import recordings
from hydro_core.bench_scales import BenchScales, unit_ratio
from hydro_core.cli.console import Table, UserError, command, progress
from hydro_core.files.atomic import encode_json, write_atomic
from hydro_core.settings import read_yaml
from hydro_diagnosis import InputError, diagnose
from hydro_diagnosis.report_json import Report
from hydro_sim.model.bench import Bench

COLUMNS = {
    "recording": "", "change": "", "answer": "same, or what differs",
}  # fmt: skip
UNIT = BenchScales(force=1.0, pressure=1.0, length=1.0, current=1.0)
FORCES, PRESSURES = ("hydraulic_force", "load_force"), ("pressure_a", "pressure_b")
OFFSETS = ("force_offset", "load_cell_bias", "spring_rest")
"""Effects that an added force changes."""
BenchFile = Mapping[str, Any]


@dataclass(frozen=True)
class Change:
    """Change of a recording and its bench file that must not change the answer but by known factors."""

    apply: Callable[[pd.DataFrame], pd.DataFrame]
    scales: BenchScales = UNIT
    """Factors of forces, pressures, lengths and currents."""
    except_for: tuple[str, ...] = ()
    """Effects that it may change."""


def _times(names: tuple[str, ...], factor: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda data: data.assign(**{name: data[name] * factor for name in names if name in data})


def _with_force(data: pd.DataFrame) -> pd.DataFrame:
    return data.assign(**{name: data[name] + 3.0 * np.ptp(data[name]) for name in FORCES if name in data})


def _halved(data: pd.DataFrame) -> pd.DataFrame:
    whole = data.iloc[: len(data) // 2 * 2]
    halves = {name: resample_poly(whole[name], 1, 2, padtype="line") for name in whole if name != "time"}
    return pd.DataFrame({"time": whole["time"].iloc[::2].to_numpy()} | halves)


def changes(data: pd.DataFrame) -> dict[str, Change]:
    """Changes that apply to a recording, by name."""
    found = {
        f"forces times {factor:g}": Change(_times((*FORCES, *PRESSURES), factor),
                                           replace(UNIT, force=factor, pressure=factor))
        for factor in (1e-3, 1.0 / 7.0, 20.0, 1e3)
    } | {
        f"lengths times {factor:g}": Change(_times(("piston_position",), factor), replace(UNIT, length=factor))
        for factor in (1.0 / 7.0, 20.0)
    } | {
        "time shifted": Change(lambda one: one.assign(time=one["time"] + 100.0)),
        "columns reordered": Change(lambda one: one[one.columns[::-1]]),
        "channel more": Change(lambda one: one.assign(temperature=np.linspace(20.0, 30.0, len(one)))),
        "every second row": Change(_halved),
    }  # fmt: skip
    if not {*PRESSURES} & {*data}:
        found["force added"] = Change(_with_force, except_for=OFFSETS)
        found["directions reversed"] = Change(_times(("piston_position", *FORCES), -1.0), except_for=OFFSETS)
    if "valve_current" in data:
        found["currents times 20"] = Change(_times(("valve_current",), 20.0), replace(UNIT, current=20.0))
    return found


def changed_bench(bench: BenchFile, scales: BenchScales) -> BenchFile:
    """Return a bench file's content in other scales; areas are forces over pressures, volumes areas times lengths."""
    area, units = scales.force / scales.pressure, {name: one.unit for name, one in Bench.quantities().items()}
    further = {"m2": area, "m3": area * scales.length, "m3/s": area * scales.length}
    return {
        name: value * further.get(units[name], unit_ratio(units[name], UNIT, scales))
        if isinstance(value, float | int) and name in units
        else value
        for name, value in bench.items()
    }


@dataclass
class Answer:
    """Names and sizes of a diagnosis, or why there is none."""

    names: list[str] = field(default_factory=list)
    sizes: dict[str, tuple[float, float, str]] = field(default_factory=dict)
    """Value, half width of the interval (infinite: not identified), and unit, by cause and parameter."""
    refused: str = ""


def answer(data: pd.DataFrame, bench: BenchFile, *, copies: int = 1) -> Answer:
    """Diagnose a recording, given `copies` times."""
    with tempfile.TemporaryDirectory() as scratch:
        paths = [Path(scratch) / f"run{one}.csv" for one in range(copies)]
        for path in paths:
            data.to_csv(path, index=False)
        try:
            report: Report = diagnose(paths, bench=bench).report
        except InputError as error:
            return Answer(refused=str(error))
    found = Answer(sorted(" ".join([one.id, *one.options.values()]) for one in report.effects))
    for one in report.effects:
        for name, size in one.parameters.items():
            half = 0.5 * (size.ci95[1] - size.ci95[0]) if size.ci95 else np.inf
            found.sizes[f"{one.id} {name}"] = size.value, half, size.unit
    return found


def difference(before: Answer, after: Answer, change: Change) -> str:
    """Return what differs between the answers before and after a change; empty if nothing does."""
    if before.refused or after.refused:
        return "" if before.refused and after.refused else after.refused or before.refused
    names = [[one for one in answer.names if not one.startswith(change.except_for)] for answer in (before, after)]
    if names[0] != names[1]:
        return f"{', '.join(names[1]) or 'nothing'} in place of {', '.join(names[0]) or 'nothing'}"
    for name, (value, half, unit) in before.sizes.items():
        if name.startswith(change.except_for) or name not in after.sizes:
            continue
        there = after.sizes[name][0] / unit_ratio(unit, UNIT, change.scales)
        if abs(there - value) > max(0.01 * abs(value), 0.1 * half):
            return f"{name} {there:.5g} in place of {value:.5g}"
    return ""


def check(data: pd.DataFrame, bench: BenchFile, only: tuple[str, ...] = ()) -> dict[str, str]:
    """Return what differs, by change; `only`: names of the changes, empty for all. A copy must be refused."""
    before, found = answer(data, bench), dict[str, str]()
    for name, change in changes(data).items():
        if not only or name in only:
            after = answer(change.apply(data), changed_bench(bench, change.scales))
            found[name] = difference(before, after, change)
    if not only or "given twice" in only:
        found["given twice"] = "" if answer(data, bench, copies=2).refused else "a copy counts as a recording"
    return found


@command(InputError)
def main() -> int:
    """Check all recordings of a folder and print the table."""
    options = parser("invariances", __doc__)
    options.add_argument("--data", type=Path, required=True, metavar="FOLDER", help="recordings with bench files")
    chosen = options.parse_args()
    there = recordings(chosen.data)
    if not there:
        raise UserError(f"{chosen.data}: there is no recording with a bench file")
    found = {name: check(data, read_yaml(bench)) for name, (data, bench) in progress(
        there.items(), label="invariances", unit="recording")}  # fmt: skip
    if chosen.json:
        write_atomic(chosen.json, encode_json({"columns": COLUMNS, "recordings": found}))
    table = Table(COLUMNS)
    for recording, differences in found.items():
        for change, differs in differences.items():
            if differs:
                table.add(recording=recording, change=change, answer=differs)
    count = sum(bool(one) for differences in found.values() for one in differences.values())
    print(table.text() if count else "", f"{count} of {sum(map(len, found.values()))} answers differ", sep="\n")
    return 1 if count else 0


if __name__ == "__main__":
    main()
