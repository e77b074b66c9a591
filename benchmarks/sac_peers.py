# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic against stable-baselines3, skrl and SBX: updates and environment steps per second, final return.

All learn the same environment (one bench, the learned model) with the paper's sizes and values, one update a step, on
one core of one process. Updates per second are timed in turns after that, many updates a call, which each library
offers. Seconds are of processor time: other work on the machine counts little. Peers: `make bench-peers`. Returns over
seeds, which go on where an earlier call ended:

    make bench-peers ARGS="--returns-only --batch 256 --seeds 20 21 22 --json returns.json"
"""

from __future__ import annotations

import importlib.util
import os
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import numpy as np
import torch
from scipy.stats import bootstrap

from benchmarks._report import interquartile_mean, parser, results
from hydro_bridge.bags.writer import code_version
from hydro_core.cli.console import Table, command, progress

PEERS = ("gymnasium", "stable_baselines3", "skrl", "sbx")
LEARNERS = ("ours", "stable-baselines3", "skrl", "SBX")
FREQUENCIES = (0.5, 1.0, 1.5, 2.0)
EXAM = 500  # steps of an examination at one frequency
ROUNDS, UPDATES = 7, 256
RETURN = "of the mean action, 4 sines of 300 N, 5 s each, reward / 50"


@command()
def main() -> None:
    """Run."""
    options = parser("sac_peers", __doc__, parallel=True)
    options.add_argument("--steps", type=int, default=9000, metavar="N", help="environment steps of a training (9000)")
    options.add_argument("--batch", type=int, nargs="+", default=[64, 256], metavar="N", help="default 64 and 256")
    options.add_argument("--seeds", type=int, nargs="+", default=[0], metavar="N", help="trainings of each learner (0)")
    options.add_argument("--returns-only", action="store_true", help="no timing; trainings are jobs, and are kept")
    options.add_argument("--learners", nargs="+", choices=LEARNERS, default=LEARNERS, help="with --returns-only")
    asked = options.parse_args()
    missing = [name for name in PEERS if importlib.util.find_spec(name) is None]
    if missing:
        print(f"{', '.join(missing)} not installed here: `make bench-peers` compares with the peers", file=sys.stderr)
        return
    if asked.returns_only:
        compare_returns(asked)
        return
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    columns = {
        "batch": "transitions per update", "seed": "", "learner": "",
        "updates_per_second": f"of processor time, median of {ROUNDS} turns of {UPDATES} updates",
        "ours_over_it": "our updates per second over its",
        "steps_per_second": f"environment steps per second of {asked.steps} steps, an update in each that learns",
        "final_return": RETURN,
    }  # fmt: skip
    table = Table(columns, title="Soft Actor-Critic: 13 observations, 2 actions, 2 x 32 ReLU, one core")
    for batch in asked.batch:
        for seed in asked.seeds:
            compare(table, batch, asked.steps, seed)
    table.show(asked.json)


def makers(batch: int, seed: int) -> dict[str, Callable[[], Any]]:
    """Return what makes each learner anew."""
    import sbx
    import stable_baselines3

    from benchmarks._sac_learners import Baselines, Ours, Skrl

    return {
        "ours": lambda: Ours(batch, seed),
        "stable-baselines3": lambda: Baselines(stable_baselines3, batch, seed),
        "skrl": lambda: Skrl(batch, seed),
        "SBX": lambda: Baselines(sbx, batch, seed),
    }


def compare(table: Table, batch: int, steps: int, seed: int) -> None:
    """Rows of one batch size and seed."""
    from benchmarks._sac_learners import STARTS, force_control

    made = makers(batch, seed)
    learners = {name: make() for name, make in made.items()}
    rates: dict[str, float] = {}
    for name in progress(list(learners), label=f"batch {batch}", unit="learner"):
        learners[name].train(force_control(seed), STARTS + 20)  # compiles; counted by nobody
        learners[name].update(1)
        learners[name] = made[name]()
        begin = time.process_time()
        learners[name].train(force_control(seed), steps)
        rates[name] = steps / (time.process_time() - begin)
    # medians over rounds in which the learners take turns
    seconds: dict[str, list[float]] = {name: [] for name in learners}
    for turn in range(ROUNDS + 1):
        for name, learner in learners.items():
            begin = time.process_time()
            learner.update(UPDATES)
            if turn:  # the first compiles for this number of updates
                seconds[name].append(time.process_time() - begin)
    timed = {name: UPDATES / float(np.median(values)) for name, values in seconds.items()}
    for name, learner in learners.items():
        table.add(
            batch=batch, seed=seed, learner=name, updates_per_second=round(timed[name]),
            steps_per_second=round(rates[name]), ours_over_it=timed["ours"] / timed[name],
            final_return=examine(learner),
        )  # fmt: skip


def final_return(batch: int, steps: int, seed: int, name: str) -> float:
    """Train one learner and examine it."""
    from benchmarks._sac_learners import force_control

    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    learner = makers(batch, seed)[name]()
    learner.train(force_control(seed), steps)
    return examine(learner)


def compare_returns(asked: Any) -> None:
    """Train each learner on each seed, then compare their returns."""
    runs = [(b, asked.steps, s, name) for b in asked.batch for s in asked.seeds for name in asked.learners]
    wanted = {" ".join(map(str, run)): run for run in runs}
    found = results(final_return, wanted, asked, code_version(), label="returns", unit="training")
    returns = dict(zip(runs, found.values(), strict=True))
    table = Table({"batch": "", "steps": "", "seed": "", "learner": "", "final_return": RETURN})
    for (batch, steps, seed, name), value in returns.items():
        table.add(batch=batch, steps=steps, seed=seed, learner=name, final_return=value)
    if asked.json:
        table.write_json(asked.json)
    for batch in asked.batch:
        print(f"batch {batch}")
        by_seed = [{name: returns[batch, asked.steps, s, name] for name in asked.learners} for s in asked.seeds]
        summarise(by_seed, asked.seeds)


def summarise(by_seed: list[dict[str, float]], seeds: list[int]) -> None:
    """Print returns per seed, and per learner the interquartile mean and in how many seeds it was worst of all."""
    names = list(by_seed[0])
    each = Table({"seed": "", **dict.fromkeys(names, "")}, title=f"final return, {RETURN}")
    for seed, row in zip(seeds, by_seed, strict=True):
        each.add(seed=seed, **{name: round(row[name]) for name in names})
    each.show()
    table = Table({
        "learner": "",
        "mean": f"interquartile mean over {len(seeds)} seeds",
        "low": "bootstrap 95 % interval of it", "high": "",
        "worst": "seeds in which it was the worst",
        "best": "seeds in which it was the best",
    })  # fmt: skip
    for name in names:
        values = np.array([row[name] for row in by_seed])
        low = high = float("nan")
        if len(values) > 1:
            low, high = bootstrap((values,), interquartile_mean, method="percentile", rng=0).confidence_interval
        table.add(
            learner=name, mean=round(float(interquartile_mean(values))), low=low, high=high,
            worst=sum(min(row, key=row.__getitem__) == name for row in by_seed),
            best=sum(max(row, key=row.__getitem__) == name for row in by_seed),
        )  # fmt: skip
    table.show()


def examine(learner: Any) -> float:
    """Return of the mean action over the four sines."""
    from benchmarks._sac_learners import force_control

    total = 0.0
    for frequency in FREQUENCIES:
        environment = force_control(reference={"amplitude": 300.0, "frequency": frequency}, max_episode_steps=EXAM)
        observation, _ = environment.reset(seed=0)
        over = terminated = False
        while not (over or terminated):
            action = learner.act(observation)
            observation, reward, terminated, over, _ = environment.step(action)
            total += float(reward)
    return total


if __name__ == "__main__":
    main()
