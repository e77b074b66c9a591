# SPDX-License-Identifier: Apache-2.0
"""The diagnosis on damaged recordings: each is refused in a sentence or gets a report, and no stage may fail.

    python -m benchmarks.fuzz_recordings --data FOLDER --json FILE
    python -m benchmarks.fuzz_recordings --data FOLDER --cases 20 --seed 3

FOLDER holds recordings, or a folder for each machine: with a bench file for each recording (RECORDING.yaml) or for all
(bench.yaml), and a column map (map.yaml) unless the columns carry the fields' names. Each case is one recording, of at
most 6,000 rows, after one to three mutations. Any lost stage gives exit status 1.
"""

from __future__ import annotations

import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks._report import parser
from hydro_core.cli.console import Table, UserError, command, progress
from hydro_core.files.atomic import encode_json, write_atomic
from hydro_diagnosis import InputError, diagnose
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import read_table
from hydro_diagnosis.recording import RECORDING_SUFFIXES
from hydro_diagnosis.report.page import write_files
from hydro_diagnosis.stage_border import StageError

COLUMNS = {
    "recording": "", "mutations": "in this order", "outcome": "verdict, refused, or lost: stages that failed",
    "cpu": "s of CPU",
}  # fmt: skip
BUDGET = 5.0
"""Budget of work of each diagnosis, s of CPU as counted."""
Mutation = Callable[[pd.DataFrame, np.random.Generator], pd.DataFrame]


def _channel(data: pd.DataFrame, rng: np.random.Generator) -> str:
    return str(rng.choice([name for name in data.columns if name != "time"]))


def _scaled(factor: float) -> Mutation:
    def mutate(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
        name = _channel(data, rng)
        return data.assign(**{name: data[name] * factor})

    return mutate


def _dropped(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    return data[rng.random(len(data)) > rng.choice([0.02, 0.3, 0.8])]


def _cut_out(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    gone = np.zeros(len(data), dtype=bool)
    for begin in rng.integers(0, len(data), 8):
        gone[begin : begin + int(rng.integers(1, max(len(data) // 10, 2)))] = True
    return data[~gone]


def _constant(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    name = _channel(data, rng)
    return data.assign(**{name: float(data[name].iloc[len(data) // 2])})


def _one_way(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    if "piston_position" not in data:
        return data
    speed = np.gradient(data["piston_position"].to_numpy())
    return data[speed * rng.choice([-1.0, 1.0]) > 0.0]


def _without_numbers(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    name, begin = _channel(data, rng), int(rng.integers(0, len(data)))
    values = data[name].to_numpy(dtype=float, copy=True)
    values[begin : begin + int(rng.integers(1, max(len(data) // 2, 2)))] = rng.choice([np.nan, np.inf])
    return data.assign(**{name: values})


def _repeated(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    span = float(data["time"].max() - data["time"].min()) * (1.0 + 1.0 / len(data))
    return (
        pd.concat([data, data.assign(time=data["time"] + span)])
        if rng.random() < 0.5
        else data.loc[data.index.repeat(2)]
    )


def _coarse(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    name = _channel(data, rng)
    quantum = float(np.ptp(data[name])) / float(rng.choice([3.0, 30.0])) or 1.0
    return data.assign(**{name: quantum * np.round(data[name] / quantum)})


def _spiked(data: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    name = _channel(data, rng)
    values = data[name].to_numpy(dtype=float, copy=True)
    values[rng.integers(0, len(values), 20)] *= 1e6
    return data.assign(**{name: values})


MUTATIONS: Mapping[str, Mutation] = {
    "rows dropped": _dropped,
    "stretches cut out": _cut_out,
    "constant channel": _constant,
    "one direction": _one_way,
    "tiny": _scaled(1e-9),
    "huge": _scaled(1e9),
    "reversed": _scaled(-1.0),
    "zero": _scaled(0.0),
    "no numbers": _without_numbers,
    "repeated": _repeated,
    "coarse": _coarse,
    "spikes": _spiked,
    "short": lambda data, rng: data.iloc[: int(rng.integers(2, max(len(data) // 4, 3)))],
    "channel gone": lambda data, rng: data.drop(columns=_channel(data, rng)) if len(data.columns) > 2 else data,
    "slow": lambda data, rng: data.assign(time=data["time"] * float(rng.choice([20.0, 1000.0]))),
    "fast": lambda data, rng: data.assign(time=data["time"] / float(rng.choice([20.0, 1000.0]))),
}  # fmt: skip
"""What is done to a recording, by name."""


@dataclass
class Case:
    """Outcome of one mutated recording."""

    recording: str
    mutations: list[str]
    outcome: str
    lost: list[str]
    """Tracebacks of the stages that failed."""
    cpu: float


def mutated(data: pd.DataFrame, seed: int) -> tuple[pd.DataFrame, list[str]]:
    """Return a recording after one to three mutations, and their names."""
    rng = np.random.default_rng(seed)
    names = [str(one) for one in rng.choice(list(MUTATIONS), int(rng.integers(1, 4)), replace=False)]
    for name in names:
        data = MUTATIONS[name](data, rng) if len(data) > 1 else data
    return data, names


def outcome(data: pd.DataFrame, bench: Any) -> tuple[str, list[str]]:
    """Diagnose a recording and write its report: the verdict, `refused` or `lost`, and tracebacks of lost stages."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "run.csv"
        data.to_csv(path, index=False)
        try:
            found = diagnose([path], bench=bench, seconds=BUDGET)
            write_files(found, Path(scratch) / "out")
        except InputError:
            return "refused", []
        except StageError as error:
            return "lost", error.border.tracebacks
        except Exception:  # beyond every border
            return "lost", [traceback.format_exc()]
    tracebacks = found.border.tracebacks
    return ("lost" if tracebacks else found.report.verdict), tracebacks


def recordings(folder: Path) -> dict[str, tuple[pd.DataFrame, Path]]:
    """Recordings of a folder and its subfolders that can be read, with their bench files, by path."""
    found: dict[str, tuple[pd.DataFrame, Path]] = {}
    for path in sorted(folder.rglob("*")):
        own, every = path.with_suffix(".yaml"), path.parent / "bench.yaml"
        bench = own if own.exists() else every if every.exists() else None
        if path.suffix.lower() not in RECORDING_SUFFIXES or bench is None:
            continue
        maps = path.parent / "map.yaml"
        with suppress(InputError):
            table = read_table(path, ColumnMap.load(maps) if maps.exists() else None)
            data = pd.DataFrame({"time": table.time, **table.columns})
            found[str(path.relative_to(folder))] = data.iloc[:6_000], bench
    return found


@command(InputError)
def main() -> int:
    """Diagnose mutated recordings and print the table of those that lost a stage, with the counts of all outcomes."""
    options = parser("fuzz_recordings", __doc__)
    options.add_argument("--data", type=Path, required=True, metavar="FOLDER", help="recordings with bench files")
    options.add_argument("--cases", type=int, default=200, metavar="N", help="mutated recordings (default: 200)")
    options.add_argument("--seed", type=int, default=0, metavar="N", help="of the first case")
    chosen = options.parse_args()
    there = recordings(chosen.data)
    if not there:
        raise UserError(f"{chosen.data}: there is no recording with a bench file")
    cases: list[Case] = []
    for seed in progress(range(chosen.seed, chosen.seed + chosen.cases), label="fuzz", unit="recording"):
        name = list(there)[seed % len(there)]
        data, mutations = mutated(there[name][0], seed)
        begun = time.process_time()
        said, lost = outcome(data, there[name][1])
        cases.append(Case(name, mutations, said, lost, time.process_time() - begun))
        if chosen.json:
            write_atomic(chosen.json, encode_json({"cases": [asdict(one) for one in cases]}))
    table = Table(COLUMNS)
    for one in cases:
        if one.lost:
            table.add(recording=one.recording, mutations=", ".join(one.mutations), outcome="lost", cpu=one.cpu)
            print(one.lost[0])
    print(table.text())
    counts = Counter(one.outcome for one in cases)
    times = [one.cpu for one in cases]
    print(", ".join(f"{count} {name}" for name, count in counts.most_common()),
          f"; CPU median {np.median(times):.1f} s, most {max(times):.1f} s", sep="")  # fmt: skip
    return 1 if counts["lost"] else 0


if __name__ == "__main__":
    main()
