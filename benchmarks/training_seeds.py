# SPDX-License-Identifier: Apache-2.0
"""Training on the bench, seed after seed: whether the force passes the box's limit, and which fixed gains are beaten.

Each run is a bench of its own (the learned model) and learns as `trainer --from scratch` does: untrained networks, one
episode after the other, the mean action examined on the four sines before the first and after each. What three
episodes of `make train ARGS="--from scratch"` are worth:

    python -m benchmarks.training_seeds --episodes 3 --updates-per-step 8 --filter learned
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks._report import parser
from hydro_core.cli.console import Table, command, progress
from hydro_policy.envs import vector_runs
from hydro_policy.envs.environment import Transitions
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.pretraining.training import REFERENCE_GAINS, Pretraining, PretrainSettings
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

LIMIT = 700.0
"""N, of the box."""


FIXED = (15.0, 5.0), REFERENCE_GAINS
"""Fixed gains (K_p, K_i) to beat: of the box by itself, and the paper's controller III."""


def train(kind: str, episodes: int, rate: float, seed: int) -> tuple[int, float, list[float], list[float]]:
    """Trips, largest force [N], episodes until each of `FIXED` was beaten at all four sines, score by episodes."""
    training = replace(configuration("wide", seed), episodes=episodes, updates_per_step=rate, replay_capacity=100_000)
    exam = EvaluationSettings(settle=1.0, measure=1.0)
    settings = PretrainSettings(training=training, benches=1, filter=kind, evaluation=exam)
    run, passed, peak = Pretraining(settings, load_model(), Bench.nominal()), [np.inf] * len(FIXED), [0.0]
    base = settings.box.base_kp, settings.box.base_ki
    fixed = [run.rmse(vector_runs.fixed_gains(np.array(gains), base), [None])[0] for gains in FIXED]

    def look(transitions: Transitions) -> None:
        peak[0] = max(peak[0], float(np.abs(transitions.samples["load_force"]).max()))

    run.examine()
    while not run.finished:
        run.run_round(look)
        for k, rmse in enumerate(fixed):
            if np.all(np.array(run.history[-1]["rmse"]) < rmse):
                passed[k] = min(passed[k], run.episode)
    return sum(entry["trips"] for entry in run.history), peak[0], passed, [entry["score"] for entry in run.history]


@command()
def main() -> None:
    """Run all seeds and show."""
    options = parser("training_seeds", __doc__)
    options.add_argument("--seeds", type=int, default=20, metavar="N", help="default 20")
    options.add_argument("--episodes", type=int, default=2, metavar="N", help="of 18 s in each run (2)")
    options.add_argument("--updates-per-step", type=float, default=1.0, metavar="X", help="default 1")
    options.add_argument("--filter", choices=("none", "learned"), nargs="+", default=["none", "learned"])
    asked = options.parse_args()
    columns = {"filter": "", "over_limit": "runs whose force passed the limit", "trips": "of the box, all runs",
               "peak": "largest load force [N]",
               "beat_15_5": "runs whose mean action beat (15, 5) at all four sines",
               "beat_90_15": "runs whose mean action beat (90, 15) at all four sines",
               "episodes_to_pass": "median of those",
               "scores": "RMSE over that of (90, 15), untrained and after each episode, median"}  # fmt: skip
    table = Table(columns, title=f"{asked.seeds} trainings, wide authority, {asked.episodes} episodes each")
    for kind in asked.filter:
        seeds = progress(range(asked.seeds), label=kind, unit="run")
        runs = [train(kind, asked.episodes, asked.updates_per_step, seed) for seed in seeds]
        trips, peaks, passed, scores = map(np.array, zip(*runs, strict=True))
        beaten = np.isfinite(passed)
        table.add(
            filter=kind, over_limit=int((peaks > LIMIT).sum()), trips=int(trips.sum()), peak=float(peaks.max()),
            beat_15_5=int(beaten[:, 0].sum()), beat_90_15=int(beaten[:, 1].sum()),
            episodes_to_pass=float(np.median(passed[beaten[:, 1], 1])) if beaten[:, 1].any() else np.nan,
            scores=", ".join(f"{score:.2f}" for score in np.median(scores, axis=0)),
        )  # fmt: skip
    table.show(asked.json)


if __name__ == "__main__":
    main()
