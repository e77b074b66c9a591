# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks share: their options, jobs that an interrupted call goes on with, the means of their tables."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scipy.stats import trim_mean

from hydro_core.cli.console import make_parser, writable_file
from hydro_diagnosis import jobs


def parser(name: str, description: str | None, *, parallel: bool = False) -> argparse.ArgumentParser:
    """Every benchmark takes `--json FILE`; one whose runs are jobs also `--jobs` and `--scheduler`."""
    made = make_parser(f"python -m benchmarks.{name}", description)
    made.add_argument(
        "--json", type=lambda name: Path(writable_file(name)), metavar="FILE", help="write the result there as well"
    )
    if parallel:
        jobs.add_arguments(made)
    return made


def results(
    function: Callable[..., Any], arguments: jobs.JobArguments, asked: argparse.Namespace, version: object,
    results_file: Path | None = None, **shown: str,
) -> dict[str, Any]:  # fmt: skip
    """Return the results of jobs by name, in the order of the names.

    Those of this version that an interrupted call has left are not run again.

    Parameters
    ----------
    asked
        Options of a parallel `parser`.
    version
        All that decides a result beside the arguments' names: the code's version, options.
    results_file
        File of the results (default: .rows beside the file of --json).
    shown
        `label` and `unit` of the progress bar.
    """
    digest = hashlib.sha256(repr(version).encode()).hexdigest()[:12]
    results_file = results_file or (asked.json.with_suffix(".rows") if asked.json else None)
    keyed = {f"{digest} {name}": values for name, values in arguments.items()}
    found = jobs.run_all(function, keyed, results_file=results_file, **jobs.job_options(asked), **shown)
    return dict(zip(arguments, found.values(), strict=True))


def interquartile_mean(values: Any, axis: int | None = None) -> Any:
    """Mean of the middle half."""
    return trim_mean(values, 0.25, axis=axis)
