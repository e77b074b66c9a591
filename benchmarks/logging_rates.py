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
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks import _report
from benchmarks.foreign_truth.logger import logged
from benchmarks.foreign_truth.plant import FloatArray
from hydro_bridge.cli.console import Table, command, progress
from hydro_diagnosis.pipeline import diagnose
from hydro_diagnosis.recording import InputError

SECONDS = 20.0
FINEST = 1e-4
"""s between the states that are kept."""
COLUMNS = {"hydraulic_force": 0, "load_force": 2, "pressure_a": 4, "pressure_b": 5, "piston_position": 6,
           "valve_current": 8}  # fmt: skip
BENCHES: dict[str, tuple[dict[str, float], str, str, float]] = {
    "clean": ({}, "", "", 0.0),
    "friction": ({"coulomb": 10.0}, "friction_coulomb", "force", 10.0),
    "leak": ({"leak_internal": 1e-13}, "leakage_internal", "coefficient", 1e-13),
}
"""By name: fields of the truth, and the cause that must be named with a parameter's true value."""


@dataclass(frozen=True, kw_only=True)
class Logger:
    """How rows are taken."""

    rate: float
    """Hz."""
    stamps: float = 0.0
    """s, largest error of a time stamp; the samples are evenly spaced."""
    sampling: float = 0.0
    """s, largest error of the instant at which a sample is taken; its stamp is right."""
    lost: float = 0.0
    """Share of the rows."""
    second: float = 0.0
    """Hz of the second half, as a recording of its own; 0: one recording."""


CONDITIONS: dict[str, Logger] = {
    **{f"{rate:g} Hz": Logger(rate=rate) for rate in (50.0, 100.0, 200.0, 250.0, 500.0)},
    **{f"{rate / 1e3:g} kHz": Logger(rate=rate) for rate in (1e3, 2e3, 5e3, 1e4)},
    "1 kHz, stamps off by 0.1 ms": Logger(rate=1e3, stamps=1e-4),
    "1 kHz, stamps off by 0.3 ms": Logger(rate=1e3, stamps=3e-4),
    "200 Hz, stamps off by 0.3 ms": Logger(rate=200.0, stamps=3e-4),
    "1 kHz, sampled 0.3 ms off": Logger(rate=1e3, sampling=3e-4),
    "200 Hz, sampled 0.3 ms off": Logger(rate=200.0, sampling=3e-4),
    "1 kHz, 1 % lost": Logger(rate=1e3, lost=0.01),
    "1 kHz, 5 % lost": Logger(rate=1e3, lost=0.05),
    "200 Hz, 5 % lost": Logger(rate=200.0, lost=0.05),
    "1 kHz, 0.3 ms and 5 % lost": Logger(rate=1e3, stamps=3e-4, lost=0.05),
    "1 kHz and 200 Hz": Logger(rate=1e3, second=200.0),
}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One diagnosis."""

    condition: str
    bench: str
    seed: int
    verdict: str
    claims: list[str]
    value: float | None
    """Of the cause that is there, if it was named."""
    low: float | None
    high: float | None
    truth: float
    cpu: float
    """s."""
    message: str = ""
    """Of a refusal or a failure."""


@cache
def _states(bench: str, number: int, seed: int) -> FloatArray:
    return logged(BENCHES[bench][0], number, seed, SECONDS)[:, list(COLUMNS.values())].astype(np.float64)


def rows(states: FloatArray, logger: Logger, seed: int, rate: float = 0.0) -> pd.DataFrame:
    """What a logger writes of the states, in columns by BenchState name."""
    random, step = np.random.default_rng([seed, 7]), 1.0 / (rate or logger.rate)
    due = np.arange(0.0, (len(states) - 20) * FINEST, step)
    taken = np.sort(due + random.uniform(-1.0, 1.0, len(due)) * logger.sampling)
    stamps = np.sort(taken + random.uniform(-1.0, 1.0, len(due)) * logger.stamps)
    at = np.clip(np.rint(taken / FINEST).astype(np.int64), 0, len(states) - 1)
    stamps = stamps if logger.sampling == 0.0 else at * FINEST
    kept = random.uniform(size=len(due)) >= logger.lost
    found = pd.DataFrame(states[at], columns=list(COLUMNS))
    found.insert(0, "time", np.round(stamps, 7))
    return found[kept]


def _outcome(name: str, bench: str, seed: int, folder: Path) -> Outcome:
    logger, (_, cause, parameter, truth) = CONDITIONS[name], BENCHES[bench]
    first, held = (_states(bench, number, seed) for number in (0, 1))
    half = len(first) // 2 if logger.second else len(first)
    tables = {"held": rows(held, logger, seed + 1), "first": rows(first[:half], logger, seed)}
    if logger.second:
        tables["second"] = rows(first[half:], logger, seed, logger.second)
    for table, content in tables.items():
        content.to_csv(folder / f"{table}.csv", index=False)
    begun, fitted = time.process_time(), [folder / f"{table}.csv" for table in tables if table != "held"]
    about: dict[str, Any] = {"condition": name, "bench": bench, "seed": seed, "truth": truth}
    about |= {"value": None, "low": None, "high": None, "claims": []}
    try:
        report = diagnose(fitted, holdout=[folder / "held.csv"]).report
    except InputError as error:
        return Outcome(**about, verdict="refused", cpu=time.process_time() - begun, message=str(error))
    except Exception as error:  # a traceback is what is counted here
        return Outcome(**about, verdict="traceback", cpu=time.process_time() - begun, message=repr(error))
    about["claims"] = [effect.id for effect in report.effects]
    for effect in report.effects:
        if effect.id == cause and parameter in effect.parameters:
            estimate = effect.parameters[parameter]
            about["value"] = estimate.value
            about["low"], about["high"] = estimate.ci95 or (None, None)
    return Outcome(**about, verdict=report.verdict, cpu=time.process_time() - begun)


@command()
def main() -> None:
    """Run the conditions that are asked for, and print a row for each."""
    options = _report.parser("logging_rates", __doc__)
    options.add_argument("--conditions", nargs="+", choices=list(CONDITIONS), default=list(CONDITIONS), metavar="NAME",
                         help="; ".join(CONDITIONS))  # fmt: skip
    options.add_argument("--benches", nargs="+", choices=list(BENCHES), default=list(BENCHES))
    options.add_argument("--seeds", type=int, default=3, help="clean benches per condition (default: 3)")
    options.add_argument("--first", type=int, default=1, help="the first seed (default: 1)")
    chosen = options.parse_args()
    table = Table({
        "condition": "",
        "clean": "clean benches without a claim",
        "silent": "clean benches with the verdict no_mismatch",
        "friction": "10 N of dry friction: named, and its interval holds the truth, of those diagnosed",
        "leak": "an internal leak of 1e-13 m3/s/Pa: likewise",
        "others": "claims of anything that is not there, in all benches",
        "cpu": "s of CPU, median",
    })  # fmt: skip
    outcomes: list[Outcome] = []
    for name in progress(chosen.conditions, total=len(chosen.conditions), label="loggers", unit="logger"):
        found = []
        for bench in chosen.benches:
            for seed in range(chosen.first, chosen.first + chosen.seeds):
                with tempfile.TemporaryDirectory() as folder:
                    found.append(_outcome(name, bench, seed, Path(folder)))
        table.add(**_row(name, found))
        outcomes += found
        result = {"columns": table.columns, "rows": table.rows, "outcomes": [asdict(one) for one in outcomes]}
        _report.finish(result, chosen.json)
    print(table.text())


def _row(name: str, found: Sequence[Outcome]) -> dict[str, Any]:
    clean = [one for one in found if one.bench == "clean"]
    row: dict[str, Any] = {
        "condition": name,
        "clean": f"{sum(not one.claims and one.verdict not in _FAILED for one in clean)}/{len(clean)}",
        "silent": f"{sum(one.verdict == 'no_mismatch' for one in clean)}/{len(clean)}",
        "others": sum(sum(claim != BENCHES[one.bench][1] for claim in one.claims) for one in found),
        "cpu": round(float(np.median([one.cpu for one in found])), 1),
    }
    for bench in ("friction", "leak"):
        own = [one for one in found if one.bench == bench]
        named = [one for one in own if one.value is not None]
        held = [
            one for one in named if one.low is not None and one.high is not None and one.low <= one.truth <= one.high
        ]
        row[bench] = f"{len(named)}, {len(held)} of {len(own)}"
    return row


_FAILED = ("refused", "traceback")


if __name__ == "__main__":
    main()
