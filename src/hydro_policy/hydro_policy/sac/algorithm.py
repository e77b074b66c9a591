# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic (Haarnoja et al. 2018) with the paper's Table training_agent as defaults.

training.md gives the equations line by line. Independent of hydraulics, ROS and processes. Many updates are one
compiled call, whose batches and noise are drawn beforehand::

    inputs     a buffer (`network_kernel`) with rows o_1 .. o_n, a_1 .. a_m, zeros: actor and critics read the same rows
    update     gather, targets, critics, actor, temperature, and soft update of the targets

At 2 x 32 units an update on 256 transitions takes 13 MFLOP, computed here from the caches at vector speed, without
Python between two updates. `test_sac` compares it with the equations in torch.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from hydro_core.signals import FloatArray
from hydro_policy.sac import network_kernel
from hydro_policy.sac.network_kernel import BATCH_MAX, Adam, Floats, Layers
from hydro_policy.sac.replay import ReplayBuffer
from hydro_policy.sac.settings import SacSettings
from hydro_sim.jit import njit


class Networks(NamedTuple):
    """Weights and gradients of all networks: views of the flat vectors."""

    actor: Layers
    actor_gradient: Layers
    critics: tuple[Layers, ...]
    critic_gradients: tuple[Layers, ...]
    targets: tuple[Layers, ...]
    target_parameters: Floats


class Hyperparameters(NamedTuple):
    """Settings of the algorithm."""

    observations: int
    actions: int
    discount: float
    target_rate: float
    target_entropy: float
    reward_scale: float
    log_std_min: float
    log_std_max: float


class Draw(NamedTuple):
    """Actions a = tanh(u) sampled for a batch, and the terms of their gradient.

    With epsilon held: d(log pi)/du = 2a, d(log pi)/d(log sigma) = -1 + 2a sigma epsilon, da/du = 1 - a^2.
    """

    action: Floats
    log_probability: Floats
    deviation: Floats
    """sigma epsilon = u - mu."""
    inside: Floats
    """1 where log sigma is within its bounds, 0 where it is clamped."""


@njit
def learn(networks, actor_adam, critic_adam, entropy_adam, numbers, rows, places, noise, losses):
    """Make one update for each row of `places`, shape (updates, batch): indices into the replay buffer's `rows`.

    `noise`: standard normal, shape (updates, 2, batch, actions), first for the targets, then for the actor.
    `losses`: output of the losses of critics, actor and temperature before each update, shape (updates, 3).
    """
    count, kind, inputs = places.shape[1], networks.target_parameters.dtype, numbers.observations + numbers.actions
    width = network_kernel.four(inputs)
    now, following = network_kernel.buffer(width, kind), network_kernel.buffer(width, kind)
    reward, end, target = np.empty(count, kind), np.empty(count, kind), np.empty(count, kind)
    actor_pass = network_kernel.pass_buffers(networks.actor, kind)
    first = network_kernel.pass_buffers(networks.critics[0], kind)
    second = network_kernel.pass_buffers(networks.critics[1], kind)
    draw = _draw(numbers.actions, count, kind)
    for k in range(len(places)):
        alpha = kind.type(math.exp(entropy_adam.parameters[0]))
        _gather(numbers, rows, places[k], now, following, reward, end)
        _targets(networks, numbers, following, noise[k, 0], reward, end, alpha, actor_pass, first, second, draw, target)
        losses[k, 0] = _critics(networks, now, target, first, second)
        network_kernel.adam_step(critic_adam, k + 1)
        losses[k, 1] = _actor(networks, numbers, now, noise[k, 1], alpha, actor_pass, first, second, draw)
        network_kernel.adam_step(actor_adam, k + 1)
        entropy_adam.gradient[0] = -(draw.log_probability.sum() / kind.type(count) + numbers.target_entropy)
        losses[k, 2] = entropy_adam.parameters[0] * entropy_adam.gradient[0]
        network_kernel.adam_step(entropy_adam, k + 1)
        network_kernel.soft_update(networks.target_parameters, critic_adam.parameters, numbers.target_rate)


@njit
def _gather(numbers, rows, places, now, following, reward, end):
    """Transpose the drawn rows of the replay buffer into buffers."""
    n, m = numbers.observations, numbers.actions
    for k in range(len(places)):
        row = rows[places[k]]
        for i in range(n):
            now[i * network_kernel.ROW + k] = row[i]
            following[i * network_kernel.ROW + k] = row[n + i]
        for j in range(m):
            now[(n + j) * network_kernel.ROW + k] = row[2 * n + j]
        reward[k], end[k] = row[2 * n + m], row[2 * n + m + 1]


@njit
def _targets(networks, numbers, following, noise, reward, end, alpha, actor_pass, first, second, draw, target):
    """y = c r + gamma (1 - d) (min_i Q_target,i(o', a') - alpha log pi(a'|o'))."""
    kind = target.dtype.type
    scale, discount, one = kind(numbers.reward_scale), kind(numbers.discount), kind(1.0)
    _sample(networks.actor, numbers, following, noise, actor_pass, draw)
    network_kernel.forward(network_kernel.padded(networks.targets[0]), following, first, len(target))
    network_kernel.forward(network_kernel.padded(networks.targets[1]), following, second, len(target))
    for k in range(len(target)):
        value = min(first.y[k], second.y[k]) - alpha * draw.log_probability[k]
        target[k] = scale * reward[k] + discount * (one - end[k]) * value


@njit
def _critics(networks, now, target, first, second):
    """Gradients of 1/2 sum_i mean (Q_i(o, a) - y)^2, and its value."""
    count, squares = len(target), 0.0
    share = target.dtype.type(1.0 / count)
    for member in range(2):
        buffers, layers, gradient = first, networks.critics[0], networks.critic_gradients[0]
        if member == 1:
            buffers, layers, gradient = second, networks.critics[1], networks.critic_gradients[1]
        padded = network_kernel.padded(layers)
        network_kernel.forward(padded, now, buffers, count)
        for k in range(count):
            buffers.g[k] = (buffers.y[k] - target[k]) * share
            squares += (buffers.y[k] - target[k]) ** 2
        network_kernel.backward(padded, now, buffers, count, gradient)
    return 0.5 * squares / count


@njit
def _actor(networks, numbers, now, noise, alpha, actor_pass, first, second, draw):
    """Gradient of mean(alpha log pi(a|o) - min_i Q_i(o, a)), and its value; draws a into the inputs' action rows."""
    count, actions, n = len(draw.log_probability), numbers.actions, numbers.observations
    loss = 0.0
    kind = draw.action.dtype.type
    zero, one, two, share = kind(0.0), kind(1.0), kind(2.0), kind(1.0 / count)
    _sample(networks.actor, numbers, now, noise, actor_pass, draw)
    critic_1, critic_2 = network_kernel.padded(networks.critics[0]), network_kernel.padded(networks.critics[1])
    network_kernel.forward(critic_1, now, first, count)
    network_kernel.forward(critic_2, now, second, count)
    for k in range(count):  # only the smaller critic passes its gradient on
        smaller = first.y[k] <= second.y[k]
        first.g[k], second.g[k] = (one, zero) if smaller else (zero, one)
        loss += alpha * draw.log_probability[k] - min(first.y[k], second.y[k])
    network_kernel.backpropagate(critic_1, first, count)
    network_kernel.backpropagate(critic_2, second, count)
    slopes = np.zeros((2, network_kernel.four(actions) * network_kernel.ROW), draw.action.dtype)
    network_kernel.whole_product(
        network_kernel.input_rows(networks.critics[0].w1, n, actions), first.g1, slopes[0], count
    )
    network_kernel.whole_product(
        network_kernel.input_rows(networks.critics[1].w1, n, actions), second.g1, slopes[1], count
    )
    for j in range(actions):
        for k in range(count):
            a = draw.action[j, k]
            slope = slopes[0, j * network_kernel.ROW + k] + slopes[1, j * network_kernel.ROW + k]
            to_mean = two * alpha * a - slope * (one - a * a)
            actor_pass.g[j * network_kernel.ROW + k] = to_mean * share
            to_log_std = (to_mean * draw.deviation[j, k] - alpha) * draw.inside[j, k]
            actor_pass.g[(actions + j) * network_kernel.ROW + k] = to_log_std * share
    network_kernel.backward(network_kernel.padded(networks.actor), now, actor_pass, count, networks.actor_gradient)
    return loss / count


@njit
def _sample(layers, numbers, inputs, noise, buffers, draw):
    """a = tanh(u), u = mu + sigma eps, into `draw` and into the inputs' action rows; log pi."""
    count, actions = len(draw.log_probability), numbers.actions
    kind = draw.action.dtype.type
    zero, half, one, two = kind(0.0), kind(0.5), kind(1.0), kind(2.0)
    low, high = kind(numbers.log_std_min), kind(numbers.log_std_max)
    log_2, half_log_2pi = kind(math.log(2.0)), kind(0.5 * math.log(2.0 * math.pi))
    network_kernel.forward(network_kernel.padded(layers), inputs, buffers, count)
    draw.log_probability[:] = zero
    for j in range(actions):
        for k in range(count):
            raw, eps = buffers.y[(actions + j) * network_kernel.ROW + k], kind(noise[k, j])
            log_std = min(max(raw, low), high)
            deviation = math.exp(log_std) * eps
            u = buffers.y[j * network_kernel.ROW + k] + deviation
            fading = math.exp(-two * abs(u))  # both tanh and log(1 - tanh^2) from one exponential
            a = math.copysign((one - fading) / (one + fading), u)
            softplus = math.log1p(fading) + max(-two * u, zero)  # of -2u
            density = -half * eps * eps - log_std - half_log_2pi
            draw.log_probability[k] += density + two * (u + softplus - log_2)
            draw.action[j, k], draw.deviation[j, k] = a, deviation
            draw.inside[j, k] = one if raw == log_std else zero
            inputs[(numbers.observations + j) * network_kernel.ROW + k] = a


@njit
def _draw(actions, count, kind):
    shape = (actions, count)
    return Draw(np.zeros(shape, kind), np.zeros(count, kind), np.zeros(shape, kind), np.zeros(shape, kind))


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
        self._hyperparameters = Hyperparameters(
            observations, actions, settings.discount, settings.target_rate, settings.target_entropy,
            settings.reward_scale, settings.log_std_min, settings.log_std_max,
        )  # fmt: skip
        self._networks = Networks(
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
        learn(self._networks, *adams, self._hyperparameters, replay.rows, places.numpy(), noise.numpy(), losses)
        self.losses = Losses(*losses.mean(axis=0).tolist())
        for optimizer in optimizers:
            optimizer.steps += updates
        self.updates += updates
