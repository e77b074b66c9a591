# SPDX-License-Identifier: Apache-2.0
"""Training on the bench, seed after seed: whether the force passes the box's limit, and how soon (90, 15) is beaten.

Each run is a bench of its own (the learned model) and learns as `trainer` does from untrained networks: one episode
after the other, an update for each step, the mean action examined on the four sines after each episode.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from benchmarks._report import parser
from hydro_core.cli.console import Table, command, progress
from hydro_policy.envs.environment import Transitions
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.pretraining.training import Pretraining, PretrainSettings
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

LIMIT = 700.0
"""N, of the box."""


def train(kind: str, episodes: int, seed: int) -> tuple[int, float, float, float]:
    """Trips, largest force [N], episodes until (90, 15) was beaten at all four sines, best score."""
    training = replace(configuration("wide", seed), episodes=episodes, replay_capacity=100_000)
    exam = EvaluationSettings(settle=1.0, measure=1.0)
    settings = PretrainSettings(training=training, benches=1, filter=kind, evaluation=exam)
    run, passed, peak = Pretraining(settings, load_model(), Bench.nominal()), np.inf, [0.0]

    def look(transitions: Transitions) -> None:
        peak[0] = max(peak[0], float(np.abs(transitions.samples["load_force"]).max()))

    while not run.finished:
        run.run_round(look)
        if np.all(np.array(run.history[-1]["rmse"]) < run.reference_rmse):
            passed = min(passed, run.episode)
    return sum(entry["trips"] for entry in run.history), peak[0], passed, run.best_score


@command()
def main() -> None:
    """Run all seeds and show."""
    options = parser("training_seeds", __doc__)
    options.add_argument("--seeds", type=int, default=20, metavar="N", help="default 20")
    options.add_argument("--episodes", type=int, default=2, metavar="N", help="of 18 s in each run (2)")
    options.add_argument("--filter", choices=("none", "learned"), nargs="+", default=["none", "learned"])
    asked = options.parse_args()
    torch.set_num_threads(1)
    columns = {"filter": "", "over_limit": "runs whose force passed the limit", "trips": "of the box, all runs",
               "peak": "largest load force [N]", "passed": "runs whose mean action beat (90, 15) at all four sines",
               "episodes_to_pass": "median of those",
               "score": "median of the best RMSE over that of (90, 15)"}  # fmt: skip
    table = Table(columns, title=f"{asked.seeds} trainings, wide authority, {asked.episodes} episodes each")
    for kind in asked.filter:
        runs = [train(kind, asked.episodes, seed) for seed in progress(range(asked.seeds), label=kind, unit="run")]
        trips, peaks, passed, scores = map(np.array, zip(*runs, strict=True))
        beaten = passed[np.isfinite(passed)]
        table.add(
            filter=kind, over_limit=int((peaks > LIMIT).sum()), trips=int(trips.sum()), peak=float(peaks.max()),
            passed=len(beaten), episodes_to_pass=float(np.median(beaten)) if len(beaten) else np.nan,
            score=float(np.median(scores)),
        )  # fmt: skip
    table.show(asked.json)


if __name__ == "__main__":
    main()
