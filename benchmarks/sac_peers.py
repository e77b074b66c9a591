# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic against stable-baselines3, skrl and SBX: updates and environment steps per second, final return.

All learn the same environment (one bench, the learned model) with the paper's sizes and values, one
update a step, on one core of one process. Updates per second are timed in turns after that, many updates a call, which
each library offers. Peers: `make bench-peers`.
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

from benchmarks._report import parser
from hydro_core.cli.console import Table, progress

PEERS = ("gymnasium", "stable_baselines3", "skrl", "sbx")
FREQUENCIES = (0.5, 1.0, 1.5, 2.0)
EXAM = 500  # steps of an examination at one frequency
ROUNDS, UPDATES = 7, 256


def main() -> int:
    """Run."""
    asked = parser("sac_peers", __doc__)
    asked.add_argument("--steps", type=int, default=9000, metavar="N", help="environment steps of a training (9000)")
    asked.add_argument("--batch", type=int, nargs="+", default=[64, 256], metavar="N", help="default 64 and 256")
    asked.add_argument("--seed", type=int, default=0, metavar="N")
    options = asked.parse_args()
    missing = [name for name in PEERS if importlib.util.find_spec(name) is None]
    if missing:
        print(f"{', '.join(missing)} not installed here: `make bench-peers` compares with the peers", file=sys.stderr)
        return 0
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    columns = {
        "batch": "transitions per update",
        "learner": "",
        "updates_per_second": f"median of {ROUNDS} turns of {UPDATES} updates",
        "ours_over_it": "our updates per second over its",
        "steps_per_second": f"environment steps per second of a training of {options.steps} steps, an update each",
        "final_return": "of the mean action, 4 sines of 300 N, 5 s each, reward / 50",
    }
    table = Table(columns, title="Soft Actor-Critic: 13 observations, 2 actions, 2 x 32 ReLU, one core")
    for batch in options.batch:
        compare(table, batch, options.steps, options.seed)
    table.show(options.json)
    return 0


def compare(table: Table, batch: int, steps: int, seed: int) -> None:
    """Rows of one batch size."""
    import sbx
    import stable_baselines3

    from benchmarks._sac_learners import Baselines, Ours, Skrl, force_control

    makers: dict[str, Callable[[], Any]] = {
        "ours": lambda: Ours(batch, seed),
        "stable-baselines3": lambda: Baselines(stable_baselines3, batch, seed),
        "skrl": lambda: Skrl(batch, seed),
        "SBX": lambda: Baselines(sbx, batch, seed),
    }
    learners = {name: make() for name, make in makers.items()}
    rates: dict[str, float] = {}
    for name in progress(list(learners), label=f"batch {batch}", unit="learner"):
        learners[name].train(force_control(seed), 2 * 500)  # compiles; counted by nobody
        learners[name] = makers[name]()
        begin = time.perf_counter()
        learners[name].train(force_control(seed), steps)
        rates[name] = steps / (time.perf_counter() - begin)
    timed = updates_per_second(learners)
    for name, learner in learners.items():
        table.add(
            batch=batch, learner=name, updates_per_second=round(timed[name]), steps_per_second=round(rates[name]),
            ours_over_it=timed["ours"] / timed[name], final_return=examine(learner, force_control),
        )  # fmt: skip


def updates_per_second(learners: dict[str, Any]) -> dict[str, float]:
    """Medians over rounds in which the learners take turns: what else the machine does meets all alike."""
    seconds: dict[str, list[float]] = {name: [] for name in learners}
    for turn in range(ROUNDS + 1):
        for name, learner in learners.items():
            begin = time.perf_counter()
            learner.update(UPDATES)
            if turn:  # the first compiles for this number of updates
                seconds[name].append(time.perf_counter() - begin)
    return {name: UPDATES / float(np.median(values)) for name, values in seconds.items()}


def examine(learner: Any, make: Callable[..., Any]) -> float:
    """Return of the mean action over the four sines."""
    total = 0.0
    for frequency in FREQUENCIES:
        environment = make(reference={"amplitude": 300.0, "frequency": frequency}, max_episode_steps=EXAM)
        observation, _ = environment.reset(seed=0)
        over = terminated = False
        while not (over or terminated):
            action = learner.act(observation)
            observation, reward, terminated, over, _ = environment.step(action)
            total += reward
    return total


if __name__ == "__main__":
    sys.exit(main())
