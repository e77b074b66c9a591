# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic (Haarnoja et al. 2018) with the paper's Table training_agent as defaults.

training.md gives the equations line by line. The gradients of the two losses are written out (reasons in `mlp`).
Independent of hydraulics, ROS and processes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from hydro_bridge.signals import FloatArray
from hydro_policy.sac import kernel, network_kernel
from hydro_policy.sac.mlp import FlatAdam, StackedMlp
from hydro_policy.sac.network_kernel import Layers
from hydro_policy.sac.replay import Batch, ReplayBuffer
from hydro_policy.sac.settings import SacSettings


class Losses(NamedTuple):
    """Losses of one update, each evaluated on its batches before the update; NaN before the first."""

    critics: float = math.nan
    """1/2 sum_i mean (Q_i(o, a) - y)^2"""
    actor: float = math.nan
    """mean(alpha log pi(a|o) - min_i Q_i(o, a))"""
    temperature: float = math.nan
    """-log(alpha) (mean log pi(a|o) + target entropy)"""


@dataclass(frozen=True, kw_only=True)
class PolicySample:
    """Batch of actions with the terms of its gradient; all [batch, actions] but `log_probability` [batch]."""

    action: Tensor
    log_probability: Tensor
    deviation: Tensor  # sigma * epsilon = u - mu
    inside: Tensor  # 1 where log sigma is within its bounds, 0 where it is clamped


class SquashedGaussian:
    """Actor a = tanh(u), u ~ N(mu(o), sigma(o)^2); mu and log sigma are the halves of a perceptron's output."""

    def __init__(self, network: StackedMlp, settings: SacSettings) -> None:
        self.network, self._low, self._high = network, settings.log_std_min, settings.log_std_max

    def sample(self, observation: Tensor, noise: Tensor) -> PolicySample:
        """Draw an action for each row of `observation` [batch, n] with standard normal `noise` [batch, actions]."""
        mean, raw = self.network.forward(observation.unsqueeze(0))[0].chunk(2, dim=1)
        log_std = raw.clamp(self._low, self._high)
        deviation = log_std.exp().mul_(noise)
        squashed = mean + deviation
        # log pi = sum_j log N(u_j) - log(1 - tanh(u_j)^2), the latter 2 (log 2 - u - softplus(-2u)) for large |u|
        correction = torch.nn.functional.softplus(-2.0 * squashed).add_(squashed).sub_(math.log(2.0)).mul_(2.0)
        density = noise.square().mul_(-0.5).sub_(log_std).sub_(0.5 * math.log(2.0 * math.pi))
        return PolicySample(
            action=squashed.tanh(),
            log_probability=density.add_(correction).sum(1),
            deviation=deviation,
            inside=(raw == log_std).to(raw.dtype),
        )

    def backward(self, sample: PolicySample, action_gradient: Tensor, entropy_coefficient: float) -> None:
        """Backpropagate mean(alpha log pi - Q) at the last `sample` into the network, given dQ/da [batch, actions].

        With epsilon held: d(log pi)/du = 2a, d(log pi)/d(log sigma) = -1 + 2a sigma epsilon, da/du = 1 - a^2.
        """
        action = sample.action
        to_mean = 2.0 * entropy_coefficient * action - action_gradient * (1.0 - action * action)
        to_log_std = (to_mean * sample.deviation - entropy_coefficient) * sample.inside
        self.network.backward(torch.cat((to_mean, to_log_std), dim=1).div_(len(action)).unsqueeze(0))


class Sac:
    """Complete state of the algorithm: actor, twin critics, targets, temperature, optimisers, random generator.

    Parameters
    ----------
    observations, actions
        Sizes of the observation and of the action; actions lie in (-1, 1).
    settings
        See `SacSettings`.
    """

    def __init__(
        self, observations: int, actions: int, settings: SacSettings, dtype: torch.dtype = torch.float32
    ) -> None:
        self.settings = settings
        self.generator = torch.Generator().manual_seed(settings.seed)
        hidden = (settings.hidden_size, settings.hidden_size)
        self.actor_network = StackedMlp(1, (observations, *hidden, 2 * actions), self.generator, dtype)
        self.critics = StackedMlp(2, (observations + actions, *hidden, 1), self.generator, dtype)
        self.target_critics = StackedMlp(2, self.critics.sizes, None, dtype)
        self.target_critics.parameters.copy_(self.critics.parameters)
        self.log_entropy_coefficient = torch.full((1,), math.log(settings.initial_entropy_coefficient), dtype=dtype)
        self.actor = SquashedGaussian(self.actor_network, settings)
        self.actor_optimizer = FlatAdam(self.actor_network.parameters, settings.actor_learning_rate)
        self.critic_optimizer = FlatAdam(self.critics.parameters, settings.critic_learning_rate)
        self.entropy_optimizer = FlatAdam(self.log_entropy_coefficient, settings.entropy_learning_rate)
        self.updates = 0
        self.losses = Losses()
        """Mean over the updates of the last `learn`, or those of the last `update`."""
        self._actions, self._dtype = actions, dtype
        self._hyperparameters = kernel.Hyperparameters(
            observations, actions, settings.discount, settings.target_rate, settings.target_entropy,
            settings.reward_scale, settings.log_std_min, settings.log_std_max,
        )  # fmt: skip
        self._networks = kernel.Networks(
            _layers(self.actor_network)[0], _layers(self.actor_network, gradient=True)[0], _layers(self.critics),
            _layers(self.critics, gradient=True), _layers(self.target_critics), self.target_critics.parameters.numpy(),
        )  # fmt: skip

    @property
    def entropy_coefficient(self) -> float:
        """alpha, the temperature."""
        return float(self.log_entropy_coefficient.exp())

    def actor_parameters(self) -> FloatArray:
        """Return a copy of the actor's flat parameters, float64, for `Policy.load_flat`."""
        return np.asarray(self.actor_network.parameters.numpy(), np.float64).copy()

    def learn(self, replay: ReplayBuffer, updates: int) -> None:
        """Draw a batch and update, `updates` times, in one compiled call (`kernel`).

        Batches larger than `network_kernel.BATCH_MAX` go through `update`.
        """
        batch = self.settings.batch_size
        if batch > network_kernel.BATCH_MAX:
            for _ in range(updates):
                self.update(replay.sample(batch, self.generator))
            return
        places = replay.draw(updates * batch, self.generator).view(updates, batch)
        noise = torch.randn(updates, 2, batch, self._actions, generator=self.generator, dtype=self._dtype)
        optimizers = (self.actor_optimizer, self.critic_optimizer, self.entropy_optimizer)
        gradients = (self.actor_network.gradient, self.critics.gradient, torch.zeros(1, dtype=self._dtype))
        adams = [optimizer.views(gradient) for optimizer, gradient in zip(optimizers, gradients, strict=True)]
        losses = np.empty((updates, len(self.losses)))
        kernel.learn(self._networks, *adams, self._hyperparameters, replay.rows, places.numpy(), noise.numpy(), losses)
        self.losses = Losses(*losses.mean(axis=0).tolist())
        for optimizer in optimizers:
            optimizer.steps += updates
        self.updates += updates

    @torch.no_grad()
    def update(self, batch: Batch) -> None:
        """Make one gradient step of critics, actor and temperature, then update the targets; reference of `learn`."""
        alpha = self.entropy_coefficient
        critics = self._update_critics(batch, alpha)
        actor, log_probability = self._update_actor(batch.observation, alpha)
        # temperature: descend -log(alpha) (log pi + target entropy)
        slope = -(log_probability.mean() + self.settings.target_entropy).view(1)
        self.losses = Losses(critics, actor, float(self.log_entropy_coefficient * slope))
        self.entropy_optimizer.step(slope)
        self.target_critics.parameters.lerp_(self.critics.parameters, self.settings.target_rate)
        self.updates += 1

    def target_value(self, batch: Batch, alpha: float) -> Tensor:
        """y = r + gamma (1 - terminated) (min_i Q_target,i(o', a') - alpha log pi(a'|o')), a' ~ pi(o'); [batch]."""
        following = self.actor.sample(batch.next_observation, self._noise(len(batch.reward)))
        value = self._values(self.target_critics, batch.next_observation, following.action).amin(0)
        value.sub_(following.log_probability, alpha=alpha).mul_(self.settings.discount).mul_(1.0 - batch.terminated)
        return value.add_(batch.reward, alpha=self.settings.reward_scale)

    def _update_critics(self, batch: Batch, alpha: float) -> float:
        """Make a descent step on 1/2 sum_i mean (Q_i(o, a) - y)^2; returns its value."""
        target = self.target_value(batch, alpha)
        error = self._values(self.critics, batch.observation, batch.action).sub_(target)
        loss = 0.5 * float(error.square().mean(1).sum())
        self.critics.backward(error.div_(len(target)).unsqueeze(2))
        self.critic_optimizer.step(self.critics.gradient)
        return loss

    def _update_actor(self, observation: Tensor, alpha: float) -> tuple[float, Tensor]:
        """Make a descent step on mean(alpha log pi(a|o) - min_i Q_i(o, a)); returns it, and log pi(a|o), [batch]."""
        drawn = self.actor.sample(observation, self._noise(len(observation)))
        values = self._values(self.critics, observation, drawn.action)
        loss = float((alpha * drawn.log_probability - values.amin(0)).mean())
        first = (values[0] <= values[1]).to(self._dtype)  # only the smaller critic passes its gradient on
        selected = torch.stack((first, 1.0 - first)).unsqueeze(2)
        gradient = self.critics.input_gradient(selected).sum(0)[:, -self._actions :]
        self.actor.backward(drawn, gradient, alpha)
        self.actor_optimizer.step(self.actor_network.gradient)
        return loss, drawn.log_probability

    def _values(self, critics: StackedMlp, observation: Tensor, action: Tensor) -> Tensor:
        """Q_i(o, a) of both critics, [2, batch]."""
        inputs = torch.cat((observation, action), dim=1)
        return critics.forward(inputs.expand(2, -1, -1)).squeeze(2)

    def _noise(self, rows: int) -> Tensor:
        return torch.randn(rows, self._actions, generator=self.generator, dtype=self._dtype)


def _layers(network: StackedMlp, gradient: bool = False) -> tuple[Layers, ...]:
    """Return each member's weights, or their gradients, as views for compiled code."""
    weights, biases = network.gradients if gradient else (network.weights, network.biases)
    arrays = [t.numpy() for pair in zip(weights, biases, strict=True) for t in pair]
    return tuple(
        Layers(*(array[m] if k % 2 == 0 else array[m, 0] for k, array in enumerate(arrays)))
        for m in range(network.members)
    )
