# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic (Haarnoja et al. 2018) with the paper's Table training_agent as defaults.

training.md gives the equations line by line, `kernel` makes the updates. Independent of hydraulics, ROS and processes.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from hydro_bridge.signals import FloatArray
from hydro_policy.sac import kernel
from hydro_policy.sac.network_kernel import BATCH_MAX, Adam, Layers
from hydro_policy.sac.replay import ReplayBuffer
from hydro_policy.sac.settings import SacSettings


class Losses(NamedTuple):
    """Losses of one update, each evaluated on its batches before the update; NaN before the first."""

    critics: float = math.nan
    """1/2 sum_i mean (Q_i(o, a) - y)^2"""
    actor: float = math.nan
    """mean(alpha log pi(a|o) - min_i Q_i(o, a))"""
    temperature: float = math.nan
    """-log(alpha) (mean log pi(a|o) + target entropy)"""


class StackedMlp:
    """Parameters of `members` independent ReLU perceptrons of one shape, and their gradients.

    Both are one vector: W_1 b_1 W_2 b_2 ..., each of all members; W_k [member, fan_in, fan_out], b_k [member, 1,
    fan_out]; `weights[k]` and `biases[k]` are views.

    Parameters
    ----------
    members
        Number of perceptrons.
    sizes
        Units from the input to the output, e.g. (15, 32, 32, 1).
    generator
        Source of the initial weights, uniform within +-1/sqrt(fan_in). None leaves zeros (weights come from elsewhere).
    dtype
        float32 in use; float64 for checks.
    """

    def __init__(
        self, members: int, sizes: tuple[int, ...], generator: torch.Generator | None, dtype: torch.dtype
    ) -> None:
        self.members, self.sizes = members, sizes
        self._shapes = [shape for i, o in pairwise(sizes) for shape in ((members, i, o), (members, 1, o))]
        self.parameters = torch.zeros(sum(math.prod(shape) for shape in self._shapes), dtype=dtype)
        self.gradient = torch.zeros_like(self.parameters)
        views = self._views(self.parameters)
        self.weights, self.biases = views[0::2], views[1::2]
        if generator is not None:
            for weight, bias in zip(self.weights, self.biases, strict=True):
                bound = 1.0 / math.sqrt(weight.shape[1])
                for tensor in (weight, bias):
                    tensor.uniform_(-bound, bound, generator=generator)

    def layers(self, gradient: bool = False) -> tuple[Layers, ...]:
        """Return each member's weights, or their gradients, as views for compiled code."""
        arrays = [view.numpy() for view in self._views(self.gradient if gradient else self.parameters)]
        return tuple(
            Layers(*(array[m] if k % 2 == 0 else array[m, 0] for k, array in enumerate(arrays)))
            for m in range(self.members)
        )

    def _views(self, flat: Tensor) -> list[Tensor]:
        pieces = flat.split([math.prod(shape) for shape in self._shapes])
        return [piece.view(shape) for piece, shape in zip(pieces, self._shapes, strict=True)]


class FlatAdam:
    """State of Adam on one flat vector, with betas (0.9, 0.999) and epsilon 1e-8."""

    def __init__(self, parameters: Tensor, learning_rate: float) -> None:
        self.parameters, self.learning_rate = parameters, learning_rate
        self.first_moment, self.second_moment = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self.steps = 0

    def views(self, gradient: Tensor) -> Adam:
        """Return views of the same memory, which compiled code changes in place."""
        moments = self.first_moment.numpy(), self.second_moment.numpy()
        return Adam(self.parameters.numpy(), gradient.numpy(), *moments, self.learning_rate, self.steps)


class Sac:
    """Complete state of the algorithm: actor, twin critics, targets, temperature, optimisers, random generator.

    The actor is a = tanh(u), u ~ N(mu(o), sigma(o)^2); mu and log sigma are the halves of a perceptron's output.

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
        self.actor_optimizer = FlatAdam(self.actor_network.parameters, settings.actor_learning_rate)
        self.critic_optimizer = FlatAdam(self.critics.parameters, settings.critic_learning_rate)
        self.entropy_optimizer = FlatAdam(self.log_entropy_coefficient, settings.entropy_learning_rate)
        self.updates = 0
        self.losses = Losses()
        """Mean over the updates of the last `learn`."""
        self._actions, self._dtype = actions, dtype
        self._hyperparameters = kernel.Hyperparameters(
            observations, actions, settings.discount, settings.target_rate, settings.target_entropy,
            settings.reward_scale, settings.log_std_min, settings.log_std_max,
        )  # fmt: skip
        self._networks = kernel.Networks(
            self.actor_network.layers()[0], self.actor_network.layers(gradient=True)[0], self.critics.layers(),
            self.critics.layers(gradient=True), self.target_critics.layers(), self.target_critics.parameters.numpy(),
        )  # fmt: skip

    @property
    def entropy_coefficient(self) -> float:
        """alpha, the temperature."""
        return float(self.log_entropy_coefficient.exp())

    def actor_parameters(self) -> FloatArray:
        """Return a copy of the actor's flat parameters, float64, for `Policy.load_flat`."""
        return np.asarray(self.actor_network.parameters.numpy(), np.float64).copy()

    def learn(self, replay: ReplayBuffer, updates: int) -> None:
        """Draw a batch and update critics, actor, temperature and targets, `updates` times, in one compiled call."""
        batch = self.settings.batch_size
        if batch > BATCH_MAX:  # compiled code does not look
            raise ValueError(f"a batch of {batch} transitions does not fit the kernels' buffers of {BATCH_MAX}")
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
