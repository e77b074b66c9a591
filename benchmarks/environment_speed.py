# SPDX-License-Identifier: Apache-2.0
"""Steps per second of the Gymnasium environment beside the fleet inside it, on one core, in turns.

A step is 10 ms of one bench: ten samples of box and plant. Gymnasium comes with what `make test` installs.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks._report import parser
from hydro_core.cli.console import Table, command
from hydro_policy.envs.environment import Environment
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.task.mdp import ACTION_SIZE, TaskSettings, events
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

ROUNDS = 5


def fleet(count: int) -> Callable[[], Any]:
    """Step of the environment that pretraining uses."""
    bench, task = Bench.nominal(), TaskSettings()
    environment = Environment(VectorBench([bench] * count, [AnalyticPlant(bench) for _ in range(count)]), task)
    environment.reset([events.reference(task, index, 0) for index in range(count)], list(range(count)))
    actions = np.zeros((count, ACTION_SIZE))
    return lambda: environment.step(actions)


def gymnasium_step(count: int, mode: str) -> Callable[[], Any]:
    """Step of the Gymnasium environment: `make` for one bench, `make_vec` in this mode for several."""
    import gymnasium

    from hydro_policy.env import ENVIRONMENT_ID

    if mode == "make":
        environment = gymnasium.make(ENVIRONMENT_ID)
    else:
        environment = gymnasium.make_vec(ENVIRONMENT_ID, num_envs=count, vectorization_mode=mode)
    environment.reset(seed=0)
    actions = 0.0 * environment.action_space.sample()
    return lambda: environment.step(actions)


@command()
def main() -> None:
    """Time and show."""
    options = parser("environment_speed", __doc__)
    options.add_argument("--steps", type=int, default=3000, metavar="N", help="of all benches in a turn (%(default)s)")
    asked = options.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    steps = {("make", 1): gymnasium_step(1, "make")}
    for count in (1, 8, 64):
        steps[("inner environment", count)] = fleet(count)
        steps[("make_vec, compiled benches", count)] = gymnasium_step(count, "vector_entry_point")
    steps[("make_vec, sync", 8)] = gymnasium_step(8, "sync")
    seconds: dict[tuple[str, int], list[float]] = {key: [] for key in steps}
    for turn in range(ROUNDS + 1):
        for key, step in steps.items():
            calls = max(asked.steps // key[1], 20)
            begin = time.perf_counter()
            for _ in range(calls):
                step()
            if turn:  # the first compiles
                seconds[key].append((time.perf_counter() - begin) / (calls * key[1]))
    columns = {"environment": "", "benches": "side by side",
               "steps_per_second": f"of all benches, median of {ROUNDS} turns"}  # fmt: skip
    table = Table(columns, title="Environment steps per second, one core, no learner")
    for (name, count), spent in sorted(seconds.items(), key=lambda entry: (entry[0][1], entry[0][0])):
        table.add(environment=name, benches=count, steps_per_second=round(1.0 / float(np.median(spent))))
    table.show(asked.json)


if __name__ == "__main__":
    main()
