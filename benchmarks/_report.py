# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks share: percentiles and how they are shown, and work that goes on where it was."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from hydro_bridge.cli.console import progress

PERCENTILES = (50.0, 99.0, 99.9)


def parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """Every benchmark takes `--json FILE`."""
    made = argparse.ArgumentParser(
        prog=f"python -m benchmarks.{name}", description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    made.add_argument("--json", type=Path, metavar="FILE", help="write the result there as well")
    return made


def percentiles(seconds: npt.ArrayLike) -> dict[str, float]:
    """Percentiles and maximum [us] of durations [s]."""
    durations = 1e6 * np.asarray(seconds, np.float64)
    values = {f"p{percent:g}": float(np.percentile(durations, percent)) for percent in PERCENTILES}
    return values | {"max": float(durations.max())}


def line(name: str, values: Mapping[str, float], unit: str) -> str:
    """One row for people."""
    return f"{name:<44}" + "".join(f"{key:>8} {value:<9.4g}" for key, value in values.items()) + unit


def finish(result: Mapping[str, object], file: Path | None) -> None:
    """Write the result if that was asked for."""
    if file:
        file.write_text(json.dumps(result, indent=2) + "\n")


def resumable(
    run: Callable[..., Any], jobs: Mapping[str, tuple[Any, ...]], kept: Path | None, label: str, workers: int = 0
) -> dict[str, Any]:
    """What `run(*arguments)` gives (plain values), by key, on all cores; what `kept` has, a line each, is not run.

    After Ctrl-C the same call goes on where it was.
    """
    lines = kept.read_text(encoding="utf-8").splitlines() if kept is not None and kept.exists() else []
    found = {entry["key"]: entry["value"] for entry in map(json.loads, lines)}
    missing = [key for key in jobs if key not in found]
    tasks = Parallel(workers or os.cpu_count(), return_as="generator_unordered")(
        delayed(_keyed)(run, key, jobs[key]) for key in missing
    )
    for key, value in progress(tasks, total=len(missing), label=label, unit="run"):
        found[key] = value
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key, "value": value}) + "\n")
    return {key: found[key] for key in jobs}


def _keyed(run: Callable[..., Any], key: str, arguments: tuple[Any, ...]) -> tuple[str, Any]:
    return key, run(*arguments)
