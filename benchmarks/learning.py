# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic updates per second against the same algorithm in ordinary torch, and one policy step in numpy.

The peer is what one writes first: nn.Linear, two critics, autograd, torch.optim.Adam. Both learn the paper's sizes (13
observations, 2 actions, 2 x 32 ReLU) from the same buffer on one thread, in turn, in one process.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks._report import line, percentiles
from hydro_bridge.cli.console import Table, add_json_argument
from hydro_bridge.signals import FloatArray
from hydro_policy.sac.algorithm import Sac
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.replay import Batch, ReplayBuffer
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import OBSERVATIONS, GainRange, observe

ROUNDS, UPDATES, STEPS = 5, 400, 50_000


class OrdinarySac:
    """The same losses by autograd."""

    def __init__(self, settings: SacSettings) -> None:
        self.settings = settings
        self.actor = _network(OBSERVATIONS, 4)
        self.critics = [_network(OBSERVATIONS + 2, 1) for _ in range(2)]
        self.targets = [_network(OBSERVATIONS + 2, 1) for _ in range(2)]
        for target, critic in zip(self.targets, self.critics, strict=True):
            target.load_state_dict(critic.state_dict())
        self.log_alpha = torch.tensor(-5.3, requires_grad=True)
        critic_parameters = [p for critic in self.critics for p in critic.parameters()]
        self.optimizers = [
            torch.optim.Adam(p, lr=1e-3) for p in (self.actor.parameters(), critic_parameters, [self.log_alpha])
        ]

    def update(self, batch: Batch) -> None:
        """One gradient step of all."""
        settings = self.settings
        actor_optimizer, critic_optimizer, entropy_optimizer = self.optimizers
        alpha = self.log_alpha.exp().detach()
        with torch.no_grad():
            action, log_probability = self._sample(batch.next_observation)
            following = torch.min(*(q(torch.cat((batch.next_observation, action), 1)).squeeze(1) for q in self.targets))
            target = settings.reward_scale * batch.reward
            target += settings.discount * (1 - batch.terminated) * (following - alpha * log_probability)
        inputs = torch.cat((batch.observation, batch.action), 1)
        critic_loss = sum(
            (0.5 * (q(inputs).squeeze(1) - target).square().mean() for q in self.critics), torch.zeros(())
        )
        _descend(critic_optimizer, critic_loss)
        action, log_probability = self._sample(batch.observation)
        value = torch.min(*(q(torch.cat((batch.observation, action), 1)).squeeze(1) for q in self.critics))
        _descend(actor_optimizer, (alpha * log_probability - value).mean())
        entropy_loss = -self.log_alpha * (log_probability.detach() + settings.target_entropy).mean()
        _descend(entropy_optimizer, entropy_loss)
        with torch.no_grad():
            for target_critic, critic in zip(self.targets, self.critics, strict=True):
                for old, new in zip(target_critic.parameters(), critic.parameters(), strict=True):
                    old.lerp_(new, settings.target_rate)

    def _sample(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_std = self.actor(observation).chunk(2, dim=1)
        normal = torch.distributions.Normal(mean, log_std.clamp(-5.0, 2.0).exp())
        squashed = normal.rsample()
        action = squashed.tanh()
        correction = 2.0 * (np.log(2.0) - squashed - nn.functional.softplus(-2.0 * squashed))
        return action, (normal.log_prob(squashed) - correction).sum(1)  # type: ignore[no-untyped-call]


def _network(inputs: int, outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, 32), nn.ReLU(), nn.Linear(32, 32), nn.ReLU(), nn.Linear(32, outputs))


def _descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()


def rate(update: Callable[[Batch], None], replay: ReplayBuffer, batch_size: int) -> float:
    """Updates per second, drawing included; median over the rounds is taken by the caller."""
    generator = torch.Generator().manual_seed(0)
    begin = time.perf_counter()
    for _ in range(UPDATES):
        update(replay.sample(batch_size, generator))
    return UPDATES / (time.perf_counter() - begin)


def updates(table: Table) -> None:
    """Fill the table of updates per second."""
    replay = ReplayBuffer(OBSERVATIONS, 2, 20_000)
    rows = np.random.default_rng(0).normal(size=(20_000, 30)).astype(np.float32)
    rows[:, 26:28] = np.tanh(rows[:, 26:28])
    rows[:, -1] = 0.0
    replay.extend(rows)
    for batch_size in (64, 128, 256):
        settings = SacSettings(batch_size=batch_size)
        ours, peer = Sac(OBSERVATIONS, 2, settings), OrdinarySac(settings)
        pairs = [(rate(ours.update, replay, batch_size), rate(peer.update, replay, batch_size)) for _ in range(ROUNDS)]
        fast, slow = np.median(np.array(pairs), axis=0)
        table.add(batch=batch_size, ours=round(fast), ordinary=round(slow), ratio=float(fast / slow))


def inference() -> FloatArray:
    """Duration [s] of observe, act (with exploration) and map to gains, once for each of many steps."""
    sac, policy, gains = Sac(OBSERVATIONS, 2, SacSettings()), Policy(32), GainRange()
    policy.load_flat(sac.actor_network.parameters.numpy().astype(np.float64))
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(256, 14))
    action: FloatArray = np.zeros(2)
    durations = np.empty(STEPS)
    for k in range(STEPS):
        begin = time.perf_counter()
        action = policy.act(observe(samples[k % 256], action), rng)
        gains.gains(action)
        durations[k] = time.perf_counter() - begin
    return durations


def main() -> int:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_json_argument(parser)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    columns = {
        "batch": "transitions",
        "ours": "updates/s",
        "ordinary": "updates/s, autograd",
        "ratio": "ours / ordinary",
    }
    table = Table(columns, title="Soft Actor-Critic, 13 observations, 2 actions, 2 x 32 ReLU")
    updates(table)
    table.show(asked.json)
    print(line("one policy step: observe, act, gains", percentiles(inference()), "us"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
