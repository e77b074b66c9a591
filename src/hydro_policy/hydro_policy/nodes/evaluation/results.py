# SPDX-License-Identifier: Apache-2.0
"""Files and page of an evaluation, including that at the end of a training."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hydro_bridge.bags.recording_run import code_version
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.pages import Section, results_page
from hydro_bridge.ros.companion import CompanionError
from hydro_bridge.viewer.runs import refresh_index
from hydro_policy.evaluation import report
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.nodes.graph.node import GraphNode
from hydro_policy.runs.run import RunDirectory


@contextmanager
def new_evaluation(parent: Path, name: str | None) -> Iterator[RunDirectory]:
    """Create runs/NAME, by default evaluate- with date and time; it is removed if it stays empty.

    Raises
    ------
    FileExistsError
        The name is taken.
    OSError
        The folder cannot be created.
    """
    run = RunDirectory(parent / (name or f"evaluate-{datetime.now():%Y%m%d-%H%M%S}"))
    first = not parent.exists()
    try:
        run.path.mkdir(parents=True)
    except FileExistsError:
        raise FileExistsError(f"{run.path} is there already: choose another --name") from None
    try:
        yield run
    finally:
        if run.bag.exists():
            print(f"recording: {run.bag}", file=sys.stderr)
        for folder in (run.path, parent) if first else (run.path,):
            with suppress(OSError):  # not empty, or gone already
                folder.rmdir()


@contextmanager
def remove_rejected_evaluation(run: RunDirectory, node: GraphNode) -> Iterator[None]:
    """Remove the folder of an evaluation whose companions rejected their input."""
    try:
        yield
    except CompanionError:
        lost = node.companions.lost and not node.refused  # ended by itself: its recording is worth keeping
        if not lost and node.timing.response.count == 0:  # no gains have ever gone out
            shutil.rmtree(run.path, ignore_errors=True)
        raise


def conditions(options: argparse.Namespace, **more: Any) -> dict[str, Any]:
    """Conditions of the measurement: plant, filter and bench as given on the command line, and the code version."""
    told: dict[str, Any] = {"plant": options.plant}
    if options.plant != "external":  # else those of the running graph
        told |= {"filter": options.filter or "the default one", "bench": str(options.bench or "the nominal one")}
    if options.plant == "emulator":
        told |= {"truth": str(options.truth or "the default one"), "faults of the line": options.faults or "none"}
    if options.load_cell:
        told["load cell"] = str(options.load_cell)
    if options.base_gains:
        told["base gains"] = "{:g} {:g}".format(*options.base_gains)
    return {**told, **more, "code_version": code_version()}


def show_results(
    results: EvaluationSession, run: RunDirectory, notes: Mapping[str, Any], *,
    json: Path | None = None, plot: Path | None = None,
) -> None:  # fmt: skip
    """Print the table; write figures and plot into the run's folder, and to `json` and `plot`."""
    if not results.scores:
        return
    under = ", ".join(f"{name} {value}" for name, value in notes.items())
    print("\n".join(filter(None, ("", report.table(results).text(), report.best(results), under))))
    for file in filter(None, (run.evaluation, json)):
        report.write_json(results, file, notes)
    report.plot(results, run.tracking_plot)
    if plot is not None:
        report.plot(results, plot)
    told = {"figures of every run": json or run.evaluation, "plot": plot or run.tracking_plot}
    for name, file in told.items():
        if file.is_file():
            print(f"{name}: {file}", file=sys.stderr)


def write_page(run: RunDirectory, title: str, about: Mapping[str, Any], sections: list[Section]) -> None:
    """Write report.html and the index page of all runs; a failure is reported, never raised."""
    when = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    try:
        write_whole(run.page, results_page(title, {"written": when, **about}, sections).encode())
    except OSError as error:
        print(f"no page of the run: {error.strerror or error}", file=sys.stderr)
    refresh_index(run.path)
