# SPDX-License-Identifier: Apache-2.0
"""The diagnosis on recordings of slow, fast, jittery and lossy loggers, of benches written apart from it.

    python -m benchmarks.logging_rates --json rates.json
    python -m benchmarks.logging_rates --conditions "200 Hz" "1 kHz, 5 % lost" --seeds 1

Each bench runs once, its states kept every 100 us; from that each logger takes its rows. A table of the first run is
fitted, one of the second held out. Clean benches must give no claim; dry friction and a leak must be right wherever
they are claimed, and nothing else may be.
"""

from __future__ import annotations

import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numba import njit

from benchmarks._report import parser
from benchmarks.foreign_truth import plant
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.equations import PERIOD, POSITION, PRESSURE_A, PRESSURE_B, STATES, command, sense
from benchmarks.foreign_truth.plant import FloatArray
from hydro_core.cli import console
from hydro_core.cli.console import Table, progress
from hydro_diagnosis.pipeline import diagnose
from hydro_diagnosis.recording import InputError

SECONDS = 20.0
ROWS = 10
"""States that are kept in a millisecond, of which any rate and any jitter can be taken: 10 kHz."""
FINEST = PERIOD / ROWS
"""s between them."""
SUBSTEPS = 10
"""Of a row: 10 us."""
COLUMNS = {"hydraulic_force": 0, "load_force": 2, "pressure_a": 4, "pressure_b": 5, "piston_position": 6,
           "valve_current": 8}  # fmt: skip
BENCHES: dict[str, tuple[dict[str, float], str, str, float]] = {
    "clean": ({}, "", "", 0.0),
    "friction": ({"coulomb": 10.0}, "friction_coulomb", "force", 10.0),
    "leak": ({"leak_internal": 1e-13}, "leakage_internal", "coefficient", 1e-13),
}
"""By name: fields of the truth, and the cause that must be named with a parameter's true value."""


class Logger(NamedTuple):
    """How rows are taken: Hz; largest errors [s] of a stamp, and of the instant of a sample; share of lost rows."""

    rate: float
    stamps: float = 0.0
    sampling: float = 0.0
    lost: float = 0.0


CONDITIONS: dict[str, Logger] = {
    **{f"{rate:g} Hz": Logger(rate) for rate in (50.0, 100.0, 200.0, 250.0, 500.0)},
    **{f"{rate / 1e3:g} kHz": Logger(rate) for rate in (1e3, 2e3, 5e3, 1e4)},
    "1 kHz, stamps off by 0.3 ms": Logger(1e3, stamps=3e-4),
    "200 Hz, stamps off by 0.3 ms": Logger(200.0, stamps=3e-4),
    "1 kHz, sampled 0.3 ms off": Logger(1e3, sampling=3e-4),
    "1 kHz, 5 % lost": Logger(1e3, lost=0.05),
}


@njit
def _run(bench, box, wanted, gains, noise, quantum, start, out):
    step, integral = PERIOD / ROWS / SUBSTEPS, 0.0
    state, work, before = np.zeros(STATES), np.zeros((3, STATES)), np.zeros(plant.LOGGED)
    state[PRESSURE_A], state[PRESSURE_B] = start, start / bench.area_ratio
    state[POSITION] = bench.spring_rest_position
    for k in range(len(out)):
        row = out[k]
        sense(bench, state, noise[k], quantum, row)
        if k % ROWS == 0:
            tick = k // ROWS
            row[7] = before[7] + 0.5 * ((row[6] - before[6]) / PERIOD - before[7])
            row[10], row[11], row[12], row[13] = wanted[tick, 0], wanted[tick, 1], gains[0], gains[1]
            integral = command(box, row, integral)
            before = row
        row[8] = before[8]
        for j in range(SUBSTEPS):
            plant.advance(plant.NONE, bench, k * PERIOD / ROWS + j * step, row[8], state, step, work)


@cache
def states(bench: str, number: int, seed: int) -> FloatArray:
    """What a bench shows in a run of this number, shape (10000 `SECONDS`, 6), by `COLUMNS`.

    At the box's milliseconds a row is what the box itself has read and decided; between them the sensors have fresh
    noise and the current is held.
    """
    kind, gain = list(plant.RUNS.items())[number]
    count = round(SECONDS / PERIOD)
    noise = plant.NOISE * np.random.default_rng([seed, number]).standard_normal((count * ROWS, 4))
    out = np.zeros((count * ROWS, plant.LOGGED))
    wanted = plant.reference(kind, count, 10 * seed + number)
    _run(numbers(**BENCHES[bench][0]), numbers(), wanted, (gain, 15.0), noise, plant.QUANTUM, 6e6 + 4e5 * number, out)
    if not np.all(np.isfinite(out[-1])):
        raise ArithmeticError("the foreign plant diverges")
    return out[:, list(COLUMNS.values())]


def rows(kept: FloatArray, logger: Logger, seed: int) -> pd.DataFrame:
    """What a logger writes of the states, in columns by BenchState name."""
    random, step = np.random.default_rng([seed, 7]), 1.0 / logger.rate
    due = np.arange(0.0, (len(kept) - 20) * FINEST, step)
    taken = np.sort(due + random.uniform(-1.0, 1.0, len(due)) * logger.sampling)
    stamps = np.sort(taken + random.uniform(-1.0, 1.0, len(due)) * logger.stamps)
    at = np.clip(np.rint(taken / FINEST).astype(np.int64), 0, len(kept) - 1)
    stamps = stamps if logger.sampling == 0.0 else at * FINEST
    found = pd.DataFrame(kept[at], columns=list(COLUMNS))
    found.insert(0, "time", np.round(stamps, 7))
    return found[random.uniform(size=len(due)) >= logger.lost]


def outcome(name: str, bench: str, seed: int) -> dict[str, Any]:
    """A row of the table."""
    _, cause, parameter, true = BENCHES[bench]
    row: dict[str, Any] = {"condition": name, "bench": bench, "value": "", "holds": "", "others": 0}
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / "first.csv", Path(folder) / "held.csv"]
        for number, file in enumerate(files):
            rows(states(bench, number, seed), CONDITIONS[name], seed + number).to_csv(file, index=False)
        begun = time.process_time()
        try:
            report = diagnose(files[:1], holdout=files[1:]).report
        except InputError as error:
            return {**row, "verdict": f"refused: {error}", "cpu": time.process_time() - begun}
    for effect in report.effects:
        if effect.id == cause and parameter in effect.parameters:
            estimate = effect.parameters[parameter]
            low, high = estimate.ci95 or (np.nan, np.nan)
            row |= {"value": f"{estimate.value:.4g} ({low:.4g} to {high:.4g})", "holds": bool(low <= true <= high)}
        else:
            row["others"] += 1
    return {**row, "verdict": report.verdict, "cpu": round(time.process_time() - begun, 1)}


@console.command()
def main() -> None:
    """Run the conditions that are asked for, and print a row for each diagnosis."""
    options = parser("logging_rates", __doc__)
    options.add_argument("--conditions", nargs="+", choices=list(CONDITIONS), default=list(CONDITIONS), metavar="NAME",
                         help="; ".join(CONDITIONS).replace("%", "%%"))  # fmt: skip
    options.add_argument("--benches", nargs="+", choices=list(BENCHES), default=list(BENCHES))
    options.add_argument("--seeds", type=int, default=3, help="benches of each kind per condition (default: 3)")
    chosen = options.parse_args()
    meanings = {"condition": "", "bench": "10 N of dry friction, an internal leak of 1e-13 m3/s/Pa, or nothing",
                "verdict": "", "value": "of what is there, if it is named", "holds": "whether its interval does",
                "others": "claims of anything that is not there", "cpu": "s"}  # fmt: skip
    table = Table(meanings)
    runs = [(name, bench, 1 + n) for name in chosen.conditions for bench in chosen.benches for n in range(chosen.seeds)]
    for name, bench, seed in progress(runs, label="loggers", unit="diagnosis"):
        table.add(**outcome(name, bench, seed))
    table.show(chosen.json)


if __name__ == "__main__":
    main()
