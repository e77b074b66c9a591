# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic updates per second at the paper's sizes, drawing included, and one policy step, on one core.

Beside its peers: `benchmarks.sac_peers`.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import torch

from benchmarks._report import finish, line, parser, percentiles
from hydro_policy.sac.algorithm import Sac
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.replay import ReplayBuffer
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import OBSERVATIONS, GainRange, observe
from hydro_sim.model.bench import NOMINAL

ROUNDS, UPDATES, STEPS = 5, 400, 50_000


def updates_per_second(batch: int) -> float:
    """Median of the rounds."""
    replay, sac = ReplayBuffer(OBSERVATIONS, 2, 20_000), Sac(OBSERVATIONS, 2, SacSettings(batch_size=batch))
    rows = np.random.default_rng(0).normal(size=(20_000, 30)).astype(np.float32)
    rows[:, 26:28], rows[:, -1] = np.tanh(rows[:, 26:28]), 0.0
    replay.extend(rows)
    took = []
    for _ in range(ROUNDS + 1):  # the first compiles
        began = time.perf_counter()
        sac.learn(replay, UPDATES)
        took.append(time.perf_counter() - began)
    return float(UPDATES / np.median(took[1:]))


def policy_steps() -> list[float]:
    """Duration [s] of observe, act (with exploration) and map to gains, once for each of many steps."""
    sac, policy, gains = Sac(OBSERVATIONS, 2, SacSettings()), Policy(SacSettings()), GainRange()
    policy.load_flat(sac.actor_network.parameters.numpy().astype(np.float64))
    rng = np.random.default_rng(0)
    samples, action, took = rng.normal(size=(256, 14)), np.zeros(2), []
    for k in range(STEPS):
        began = time.perf_counter()
        action = policy.act(observe(samples[k % 256], action, NOMINAL), rng)
        gains.gains(action)
        took.append(time.perf_counter() - began)
    return took


def main() -> int:
    """Measure, print, write."""
    asked = parser("learning", __doc__).parse_args()
    torch.set_num_threads(1)
    rates = {str(batch): updates_per_second(batch) for batch in (64, 128, 256)}
    for batch, rate in rates.items():
        print(f"updates of {batch:>3} transitions: {rate:.0f} per second")
    step = percentiles(policy_steps())
    print(line("one policy step: observe, act, gains", step, "us"))
    finish({"updates_per_second": rates, "policy_step_us": step}, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
