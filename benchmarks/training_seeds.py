# SPDX-License-Identifier: Apache-2.0
"""Training on the bench, seed after seed: whether the force passes the box's limit, and how soon III is beaten.

Each run is a bench of its own and learns as `trainer` does: one episode after the other, an update for each step, the
mean action examined on the four sines after each episode. Plant: the learned model (0.02 N from the emulated bench in a
minute's free run), or with `--emulator` the emulated bench itself, some ten times slower.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from benchmarks._truth_fleet import TruthPlant
from hydro_bridge.cli.console import Table, add_json_argument, progress
from hydro_policy.envs.environment import Transitions
from hydro_policy.pretraining.configurations import CONFIGURATIONS, configuration
from hydro_policy.pretraining.training import Pretraining, PretrainSettings, Simulated
from hydro_policy.runs.initial_agent import InitialAgent, shipped_agent
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.emulator.truth.config import profile
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench

EXAM = EvaluationSettings(settle=1.0, measure=1.0)


@dataclass
class Peak:
    """The largest load force of a run."""

    force: float = 0.0

    def __call__(self, transitions: Transitions) -> None:
        """Look at a step."""
        self.force = max(self.force, float(np.abs(transitions.samples["load_force"]).max()))


@dataclass(frozen=True)
class Outcome:
    """One seed."""

    trips: int
    peak: float
    passed: float
    """Episodes until the mean action beat fixed (90, 15) at all four sines; infinite: not in this run."""
    score: float
    """Best so far."""


def train(source: Simulated, name: str, start: InitialAgent | None, kind: str, episodes: int, seed: int) -> Outcome:
    """One run."""
    training = replace(configuration(name, seed), episodes=episodes, replay_capacity=100_000)
    if start is not None:
        training = replace(start.adopted(training), warmup_steps=training.task.steps_per_episode)
    settings = PretrainSettings(training=training, benches=1, filter=kind, evaluation=EXAM)
    run, peak = Pretraining(settings, source, Bench.nominal()), Peak()
    passed = np.inf
    if start is not None:
        run.start_from(start.agent)
        run.examine()
        passed = 0.0 if _beats(run) else np.inf
    while not run.finished:
        run.round(peak)
        passed = min(passed, run.episode if _beats(run) else np.inf)
    return Outcome(sum(entry["trips"] for entry in run.history), peak.force, passed, run.best_score)


def _beats(run: Pretraining) -> bool:
    return bool(np.all(np.array(run.history[-1]["rmse"]) < run.reference_rmse))


def main() -> int:
    """Run all seeds and show."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.training_seeds", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="default 20")
    parser.add_argument("--episodes", type=int, default=4, metavar="N", help="of 18 s in each run (4)")
    parser.add_argument("--configuration", choices=CONFIGURATIONS, default="wide")
    parser.add_argument("--emulator", action="store_true", help="the emulated bench instead of the learned model")
    parser.add_argument("--start", choices=("scratch", "shipped"), nargs="+", default=["scratch", "shipped"])
    parser.add_argument("--filter", choices=("none", "constant", "learned"), nargs="+", default=["none", "learned"])
    add_json_argument(parser)
    options = parser.parse_args()
    torch.set_num_threads(1)
    columns = {
        "start": "untrained, or the shipped agent",
        "filter": "",
        "over_limit": f"runs of {options.seeds} in which the load force passed the box's 700 N",
        "trips": "times the box tripped, all runs together",
        "peak": "largest load force [N] of all runs",
        "passed": f"runs whose mean action beat fixed (90, 15) at all four sines within {options.episodes} episodes",
        "episodes_to_pass": "median of those; 0: before the first",
        "score": "median of the best RMSE over that of fixed (90, 15), mean over the sines",
    }
    table = Table(columns, title=f"configuration {options.configuration}, {options.episodes} episodes a run")
    learned = Learned.load(None)
    truth: Callable[[], TruthPlant] = lambda: TruthPlant(profile("default"))  # noqa: E731
    for name in options.start:
        start = shipped_agent(options.configuration) if name == "shipped" else None
        for kind in options.filter:
            runs = [
                train(
                    truth if options.emulator else learned, options.configuration, start, kind, options.episodes, seed
                )
                for seed in progress(range(options.seeds), label=f"{name}, filter {kind}", unit="run")
            ]
            _add(table, name, kind, runs)
    table.show(options.json)
    return 0


def _add(table: Table, name: str, kind: str, runs: list[Outcome]) -> None:
    passed = [run.passed for run in runs if np.isfinite(run.passed)]
    table.add(
        start=name, filter=kind, over_limit=sum(run.peak > 700.0 for run in runs), trips=sum(run.trips for run in runs),
        peak=max(run.peak for run in runs), passed=len(passed),
        episodes_to_pass=float(np.median(passed)) if passed else np.nan,
        score=float(np.median([run.score for run in runs])),
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
