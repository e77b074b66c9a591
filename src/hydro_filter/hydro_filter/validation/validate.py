# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_filter validate: the paper's Table val_cont, with and without the filter, on emulator and simulation.

Every case runs with several seeds, each once without and once with the filter, sample by sample in this process: the
emulator's own plant and box, without the serial line. `--plots DIR` draws the paper's tracking figure, first seed.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from itertools import product
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from hydro_core.cli import jobs
from hydro_core.cli.console import Table, add_json_argument, bounded_number, command, writable_folder
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.validation.runs import CASES, FILTERS, PLANTS, Outcome, Run, Task, evaluate_task, simulate
from hydro_sim.files.pairing import raise_if_mismatched
from hydro_sim.files.weights import WeightsError
from hydro_sim.plotting import BLUE, GRAY, GREEN, ORANGE, RED, add_legend, figure, plot_field

COLUMNS = {
    "plant": "",
    "case": "",
    "filter": "none: bypassed, evaluated only",
    "runs": "",
    "bounded": "%, runs in which the box never tripped (700 N, sensor ranges)",
    "peak": "N, largest |f_l| of all runs",
    "rmse": "N, median over runs of the RMSE of f_r - f_l, first 2 s left out, until the end or the trip",
    "chatter": "A/s, median over runs of the RMS of u'",
    "gamma_1": "%, mean |delta_u| over u_max",
    "gamma_2": "%, samples with M_c > 0 (violated) before the correction",
    "verified_2": "%, samples with M_c <= 0 (verified) before",
    "gamma_3": "1/s, mean M_c before",
    "gamma_4": "%, violated after the correction",
    "verified_4": "%, verified after",
    "gamma_5": "1/s, mean M_c after",
    "failed": "%, samples whose certificate could not be restored",
    "osqp": "%, corrections on which OSQP agrees with the filter's closed form",
}


@command(WeightsError, ValueError)
def main() -> None:
    """Entry point."""
    options = parse_args(sys.argv[1:])
    choice = FilterChoice.from_files(metric=options.metric, model=options.model, bench=options.bench)
    raise_if_mismatched(choice.pairing_error())  # before the work
    lines = list(product(options.plants, options.cases, FILTERS))
    runs = {line: [f"{', '.join(line)}, seed {seed}" for seed in range(options.seeds)] for line in lines}
    make = partial(Task, seconds=options.seconds, metric=options.metric, model=options.model, bench=options.bench)
    tasks = {name: (make(plant=plant, case=case, filter=chosen, seed=seed),)
             for plant, case, chosen in lines for seed, name in enumerate(runs[plant, case, chosen])}  # fmt: skip
    table, done = Table(COLUMNS, title=f"Table val_cont: {options.seconds:g} s a run"), dict[str, Outcome]()
    for name, result in jobs.run(evaluate_task, tasks, **jobs.job_options(options), label="runs", unit="run"):
        done[name] = result
        whole = [line for line in lines if done.keys() >= set(runs[line])]
        if len(whole) > len(table.rows):
            table.rows = [table_row(*line, [done[one] for one in runs[line]]) for line in whole]
            if options.json:
                table.write_json(options.json)  # finished rows are saved in case of an interruption
    table.show(options.json)
    print("\n" + "\n".join(f"{name}: {CASES[name].description}" for name in options.cases))
    for plant, case in product(options.plants, options.cases) if options.plots else ():
        without, filtered = (simulate(make(plant=plant, case=case, filter=name, seed=0)) for name in FILTERS)
        plot_tracking(
            without, filtered, f"{plant}: {CASES[case].description}", Path(options.plots) / f"{plant}_{case}.png"
        )


def table_row(plant: str, case: str, chosen: str, outcomes: list[Outcome]) -> dict[str, Any]:
    """Return a row of the table: shares and means over all samples of all runs."""
    weights = np.array([one.samples for one in outcomes], float)
    gammas = np.average(np.array([tuple(one.gammas) for one in outcomes]), axis=0, weights=weights)
    agreed, differed = sum(one.agreed for one in outcomes), sum(one.differed for one in outcomes)
    return {
        "plant": plant, "case": case, "filter": chosen, "runs": len(outcomes),
        "bounded": 100.0 * sum(one.bounded for one in outcomes) / len(outcomes),
        "peak": max(one.peak for one in outcomes), "rmse": float(np.median([one.rmse for one in outcomes])),
        "chatter": float(np.median([one.chattering for one in outcomes])),
        "gamma_1": 100.0 * gammas[0], "gamma_2": 100.0 * gammas[1], "verified_2": 100.0 * (1.0 - gammas[1]),
        "gamma_3": gammas[2], "gamma_4": 100.0 * gammas[3], "verified_4": 100.0 * (1.0 - gammas[3]),
        "gamma_5": gammas[4], "failed": 100.0 * sum(one.failed for one in outcomes) / weights.sum(),
        "osqp": 100.0 * agreed / (agreed + differed) if agreed + differed else nan,
    }  # fmt: skip


def plot_tracking(without: Run, filtered: Run, title: str, path: Path) -> None:
    """Plot the paper's figure unstable_track: both forces, the gain, the correction and the certificate over time."""
    with figure(path, 4, size=(8.0, 8.0), sharex=True, height_ratios=(3, 1.5, 1.5, 1.5)) as (drawing, axes):
        force, gain, valve, certificate = axes
        drawing.suptitle(title, x=0.01, ha="left", weight="semibold")
        plot_field(force, filtered.states, "reference_force", color=GRAY, linestyle="--")
        tripped = "" if without.bounded else ", until the box tripped"
        plot_field(force, without.states, "load_force", color=RED, label="without filter" + tripped, linewidth=0.9)
        plot_field(force, filtered.states, "load_force", color=BLUE, label="with filter")
        force.set(ylabel="load force [N]", ylim=(-720.0, 720.0))
        plot_field(gain, filtered.states, "proportional_gain", color=GREEN, drawstyle="steps-post", linewidth=0.7)
        gain.set(ylabel="[1/s]")
        time = filtered.states["time"]
        correction = np.array([result.delta_u for result in filtered.results])
        valve.plot(time, 1e3 * correction, color=ORANGE, label="correction", linewidth=0.7)
        valve.set(ylabel="[mA]")
        before, after = (np.array([getattr(r, name) for r in filtered.results]) for name in ("before", "after"))
        certificate.plot(time, before, color=RED, label=r"$M_c$ before", linewidth=0.7)
        certificate.plot(time, after, color=BLUE, label=r"$M_c$ after", linewidth=0.7)
        certificate.set(ylabel="[1/s]", xlabel="time [s]", yscale="symlog", xlim=(time[0], time[-1]))
        for panel in axes:
            add_legend(panel)


def parse_args(given: list[str]) -> argparse.Namespace:
    """Parse the command line."""
    listed = "\n".join(f"  {name:14} {case.description}" for name, case in CASES.items())
    parser = argparse.ArgumentParser(
        prog="validate", description=__doc__, epilog=f"cases:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--metric", metavar="METRIC", help="of `learn_metric`; the shipped one by default")
    parser.add_argument("--model", metavar="FILE", help="bench file of the learned bench; default: the shipped one")
    parser.add_argument(
        "--bench", metavar="FILE", help="bench.yaml that box and filter believe; the nominal one by default"
    )
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS), metavar="PLANT",
                        help=f"of {', '.join(PLANTS)}")  # fmt: skip
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), metavar="CASE", help="see below; all")
    parser.add_argument("--seeds", type=bounded_number(1), default=20, help="runs of each line")
    parser.add_argument("--seconds", type=bounded_number(1.0), default=18.0, help="s, of each run; the paper's episode")
    jobs.add_arguments(parser)
    parser.add_argument("--plots", type=writable_folder, metavar="DIR", help="draw the tracking figures into DIR")
    add_json_argument(parser)
    return parser.parse_args(given)
