# SPDX-License-Identifier: Apache-2.0
"""Which structure of the learned bench predicts best: all trained on the same recordings, judged on one held out.

The recordings are the emulator's, made here (`collect`'s schedules of these seeds, the same plant to the bit as over
the serial line): two of 150 s to train on, one of 60 s that stops the training, one of 60 s, seed 21, to be judged by.
Every structure gets the same windows, batches of 1024, at most 150 epochs, and stops early. A row that is done is kept
in the folder and not computed again, so that Ctrl-C costs one row; the table shows what is there.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks._learned_case import ALONE, HORIZON, Case, Row
from benchmarks._report import parser
from hydro_bridge.cli.console import Table
from hydro_bridge.signals import PLANT_FIELDS, FloatArray
from hydro_sim.identification import evaluation
from hydro_sim.identification.analytic import AnalyticModel
from hydro_sim.identification.evaluation import Predictor, Scales
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench
from hydro_sim.structured.model import StructuredModel

ROWS = (
    Row(structure="network", hidden=(32, 32)),
    Row(structure="network", hidden=(64, 64)),
    Row(structure="network", hidden=(64, 64, 64)),
    Row(structure="residual", hidden=(32, 32)),
    Row(structure="residual", hidden=(64, 64)),
    ALONE,
    Row(structure="structured", hidden=(32, 32)),
    Row(structure="structured", hidden=(64, 64)),
)
COLUMNS = {
    "structure": "what it is, and its hidden layers",
    **dict.fromkeys(PLANT_FIELDS, "RMSE of 70-sample predictions against the noise-free log, over the state's range"),
    "of_analytic": "that error over the analytic model's, geometric mean over the states",
    "over_noise": "RMSE against the recording over the recording's own noise, geometric mean over the states",
    "observed": "of_analytic again, from the start states that the structured model's observer gives",
    "weights": "of the network",
    "epochs": "trained, early stopping",
    "best_epoch": "the one that was kept",
    "cpu": "s of CPU for the training, identification of constants included",
}
FACTS = ("weights", "epochs", "best_epoch", "cpu")


def main(arguments: list[str] | None = None) -> int:
    """Train what is not there yet, judge, print, write."""
    options = parser("learned_structures", __doc__)
    options.add_argument("--folder", type=Path, default=Path("runs/structures"), help="of the weights, which are kept")
    options.add_argument("--truth", metavar="FILE", help="what the emulated bench is made of (default: the default)")
    options.add_argument("--epochs", type=int, default=150, help="at most (default 150)")
    options.add_argument("--only", nargs="+", choices=[row.name for row in ROWS], help="rows to train (default: all)")
    asked = options.parse_args(arguments)
    asked.folder.mkdir(parents=True, exist_ok=True)
    threadpool_limits(1, "blas")
    case = Case(asked.folder, asked.truth, asked.epochs)
    for row in (ALONE, *ROWS):
        if not case.model(row).exists() and (asked.only is None or row.name in asked.only or row == ALONE):
            case.train(row)
    table_of(case, [row for row in ROWS if case.model(row).exists()]).show(asked.json)
    return 0


def table_of(case: Case, rows: list[Row]) -> Table:
    """Normalized errors; the last row is the analytic model, from the structured one's start states."""
    table = Table(COLUMNS, title=f"{HORIZON}-sample predictions of a held-out recording")
    scored, judged = case.held_out(), {row.name: Learned.load(case.model(row)) for row in rows}
    span = Scales.of(np.concatenate([item.reference for item in scored])).span
    floor, analytic = evaluation.noise_floor(scored), AnalyticModel(Bench.nominal())
    own = [case.observer().estimate(item.run) for item in scored]
    base = case.errors(analytic, own)

    def add(name: str, model: Predictor, states: list[FloatArray], seen: list[FloatArray], **facts: Any) -> None:
        clean = case.errors(model, states)
        table.add(
            structure=name, **dict(zip(PLANT_FIELDS, map(float, clean / span), strict=True)),
            of_analytic=mean(clean / base), over_noise=mean(case.errors(model, states, recorded=True) / floor),
            observed=mean(case.errors(model, seen) / base), **facts,
        )  # fmt: skip

    for name, learned in judged.items():
        model, facts = learned.model, {key: learned.training[key] for key in FACTS}
        states = [model.estimate(item.run) for item in scored]
        add(name, model, states, states if isinstance(model, StructuredModel) else case.observed(), **facts)
    add("analytic", analytic, own, own, **dict.fromkeys(FACTS, 0))
    return table


def mean(ratios: FloatArray) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(ratios))))


if __name__ == "__main__":
    sys.exit(main())
