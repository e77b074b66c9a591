# SPDX-License-Identifier: Apache-2.0
"""`Sac.update` many times over in one compiled call: the same equations, batches drawn beforehand.

::

    a buffer   row of one neuron | transitions 0 .. 127 | 128 .. 255 | ...   flat, see `hydro_sim.learned.dense`
    inputs     rows o_1 .. o_n, a_1 .. a_m, zeros up to a multiple of four: actor and critics read the same rows
    networks   `Layers` padded to multiples of four, and their transposes for the way back

At 2 x 32 units the arithmetic of an update on 256 transitions is 13 MFLOP; here it runs from the caches at vector
speed, and between two updates there is no Python. `test_sac` holds it to `Sac.update`, which `torch` code spells out.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from hydro_sim.learned import dense
from hydro_sim.learned.mlp import LOOSE, Layers

BATCH_MAX = dense.BLOCK * dense.CHUNK
"""Transitions that one buffer holds."""

_BLOCK = np.uint64(dense.BLOCK)
_BETA_1, _BETA_2, _EPSILON = 0.9, 0.999, 1e-8

Floats = npt.NDArray[Any]


class Adam(NamedTuple):
    """One optimizer: flat vectors, changed in place."""

    parameters: Floats
    gradient: Floats
    first_moment: Floats
    second_moment: Floats
    learning_rate: float
    steps: int


class Networks(NamedTuple):
    """Views of the flat vectors, as `Layers`."""

    actor: Layers
    actor_gradient: Layers
    critics: tuple[Layers, ...]
    critic_gradients: tuple[Layers, ...]
    targets: tuple[Layers, ...]
    target_parameters: Floats


class Numbers(NamedTuple):
    """Settings of the algorithm."""

    observations: int
    actions: int
    discount: float
    target_rate: float
    target_entropy: float
    reward_scale: float
    log_std_min: float
    log_std_max: float


class Pass(NamedTuple):
    """Buffers of one network's way forward and back."""

    a1: Floats
    a2: Floats
    y: Floats
    g: Floats
    g1: Floats
    g2: Floats


class Draw(NamedTuple):
    """Actions drawn for a batch: see `hydro_policy.sac.PolicySample`."""

    action: Floats
    log_probability: Floats
    deviation: Floats
    inside: Floats


@njit(cache=True)
def learn(networks, actor_adam, critic_adam, entropy_adam, numbers, rows, places, noise):
    """One update for each row of `places`, shape (updates, batch), of the replay buffer's `rows`.

    `noise`: standard normal, shape (updates, 2, batch, actions), first for the targets, then for the actor.
    """
    count, kind, inputs = places.shape[1], networks.target_parameters.dtype, numbers.observations + numbers.actions
    width = _four(inputs)
    now, following = _buffer(width, kind), _buffer(width, kind)
    reward, end, target = np.empty(count, kind), np.empty(count, kind), np.empty(count, kind)
    actor_pass = _pass(networks.actor, kind)
    first, second = _pass(networks.critics[0], kind), _pass(networks.critics[1], kind)
    draw = _draw(numbers.actions, count, kind)
    for k in range(len(places)):
        alpha = kind.type(math.exp(entropy_adam.parameters[0]))
        _gather(numbers, rows, places[k], now, following, reward, end)
        _targets(networks, numbers, following, noise[k, 0], reward, end, alpha, actor_pass, first, second, draw, target)
        _critics(networks, now, target, first, second)
        _adam(critic_adam, k + 1)
        _actor(networks, numbers, now, noise[k, 1], alpha, actor_pass, first, second, draw)
        _adam(actor_adam, k + 1)
        entropy_adam.gradient[0] = -(draw.log_probability.sum() / kind.type(count) + numbers.target_entropy)
        _adam(entropy_adam, k + 1)
        _follow(networks.target_parameters, critic_adam.parameters, numbers.target_rate)


@njit(cache=True)
def _gather(numbers, rows, places, now, following, reward, end):
    """Transpose the drawn rows of the replay buffer into buffers."""
    n, m = numbers.observations, numbers.actions
    for k in range(len(places)):
        row = rows[places[k]]
        for i in range(n):
            now[i * dense.ROW + k] = row[i]
            following[i * dense.ROW + k] = row[n + i]
        for j in range(m):
            now[(n + j) * dense.ROW + k] = row[2 * n + j]
        reward[k], end[k] = row[2 * n + m], row[2 * n + m + 1]


@njit(cache=True)
def _targets(networks, numbers, following, noise, reward, end, alpha, actor_pass, first, second, draw, target):
    """y = c r + gamma (1 - d) (min_i Q_target,i(o', a') - alpha log pi(a'|o'))."""
    kind = target.dtype.type
    scale, discount, one = kind(numbers.reward_scale), kind(numbers.discount), kind(1.0)
    _sample(networks.actor, numbers, following, noise, actor_pass, draw)
    _forward(_padded(networks.targets[0]), following, first, len(target))
    _forward(_padded(networks.targets[1]), following, second, len(target))
    for k in range(len(target)):
        value = min(first.y[k], second.y[k]) - alpha * draw.log_probability[k]
        target[k] = scale * reward[k] + discount * (one - end[k]) * value


@njit(cache=True)
def _critics(networks, now, target, first, second):
    """Gradients of 1/2 sum_i mean (Q_i(o, a) - y)^2."""
    count = len(target)
    share = target.dtype.type(1.0 / count)
    for member in range(2):
        way, layers, gradient = first, networks.critics[0], networks.critic_gradients[0]
        if member == 1:
            way, layers, gradient = second, networks.critics[1], networks.critic_gradients[1]
        padded = _padded(layers)
        _forward(padded, now, way, count)
        for k in range(count):
            way.g[k] = (way.y[k] - target[k]) * share
        _backward(padded, now, way, count, gradient)


@njit(cache=True)
def _actor(networks, numbers, now, noise, alpha, actor_pass, first, second, draw):
    """Gradient of mean(alpha log pi(a|o) - min_i Q_i(o, a)); draws a into the inputs' action rows."""
    count, actions, n = len(draw.log_probability), numbers.actions, numbers.observations
    kind = draw.action.dtype.type
    zero, one, two, share = kind(0.0), kind(1.0), kind(2.0), kind(1.0 / count)
    _sample(networks.actor, numbers, now, noise, actor_pass, draw)
    critic_1, critic_2 = _padded(networks.critics[0]), _padded(networks.critics[1])
    _forward(critic_1, now, first, count)
    _forward(critic_2, now, second, count)
    for k in range(count):  # only the smaller critic passes its gradient on
        smaller = first.y[k] <= second.y[k]
        first.g[k], second.g[k] = (one, zero) if smaller else (zero, one)
    _to_inputs(critic_1, first, count)
    _to_inputs(critic_2, second, count)
    slopes = np.zeros((2, _four(actions) * dense.ROW), draw.action.dtype)
    _product(_action_rows(networks.critics[0].w1, n, actions), first.g1, slopes[0], count)
    _product(_action_rows(networks.critics[1].w1, n, actions), second.g1, slopes[1], count)
    for j in range(actions):
        for k in range(count):
            a = draw.action[j, k]
            slope = slopes[0, j * dense.ROW + k] + slopes[1, j * dense.ROW + k]
            to_mean = two * alpha * a - slope * (one - a * a)
            actor_pass.g[j * dense.ROW + k] = to_mean * share
            to_log_std = (to_mean * draw.deviation[j, k] - alpha) * draw.inside[j, k]
            actor_pass.g[(actions + j) * dense.ROW + k] = to_log_std * share
    _backward(_padded(networks.actor), now, actor_pass, count, networks.actor_gradient)


@njit(cache=True)
def _sample(layers, numbers, inputs, noise, way, draw):
    """a = tanh(u), u = mu + sigma eps, into `draw` and into the inputs' action rows; log pi."""
    count, actions = len(draw.log_probability), numbers.actions
    kind = draw.action.dtype.type
    zero, half, one, two = kind(0.0), kind(0.5), kind(1.0), kind(2.0)
    low, high = kind(numbers.log_std_min), kind(numbers.log_std_max)
    log_2, half_log_2pi = kind(math.log(2.0)), kind(0.5 * math.log(2.0 * math.pi))
    _forward(_padded(layers), inputs, way, count)
    draw.log_probability[:] = zero
    for j in range(actions):
        for k in range(count):
            raw, eps = way.y[(actions + j) * dense.ROW + k], kind(noise[k, j])
            log_std = min(max(raw, low), high)
            deviation = math.exp(log_std) * eps
            u = way.y[j * dense.ROW + k] + deviation
            fading = math.exp(-two * abs(u))  # both tanh and log(1 - tanh^2) from one exponential
            a = math.copysign((one - fading) / (one + fading), u)
            softplus = math.log1p(fading) + max(-two * u, zero)  # of -2u
            density = -half * eps * eps - log_std - half_log_2pi
            draw.log_probability[k] += density + two * (u + softplus - log_2)
            draw.action[j, k], draw.deviation[j, k] = a, deviation
            draw.inside[j, k] = one if raw == log_std else zero
            inputs[(numbers.observations + j) * dense.ROW + k] = a


@njit(cache=True)
def _forward(layers, x, way, count):
    """Outputs of a padded network into way.y."""
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.fill(way.a1, at, layers.b1)
        dense.product(layers.w1, x, at, way.a1, at)
        dense.relu(way.a1, at, len(layers.b1))
        dense.fill(way.a2, at, layers.b2)
        dense.product(layers.w2, way.a1, at, way.a2, at)
        dense.relu(way.a2, at, len(layers.b2))
        dense.fill(way.y, at, layers.b3)
        dense.product(layers.w3, way.a2, at, way.y, at)


@njit(cache=True)
def _to_inputs(layers, way, count):
    """From way.g, the gradient by the outputs, to those by both layers' sums, way.g2 and way.g1."""
    w3, w2 = layers.w3.T.copy(), layers.w2.T.copy()
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.clear(way.g2, at, len(layers.b2))
        dense.product(w3, way.g, at, way.g2, at)
        dense.mask(way.g2, way.a2, at, len(layers.b2))
        dense.clear(way.g1, at, len(layers.b1))
        dense.product(w2, way.g2, at, way.g1, at)
        dense.mask(way.g1, way.a1, at, len(layers.b1))


@njit(cache=True)
def _backward(layers, x, way, count, gradient):
    """Gradients of a padded network by its weights, given way.g, into `gradient` (not padded)."""
    _to_inputs(layers, way, count)
    sums = dense.zeros(layers)
    dense.outer(way.a2, way.g, sums.w3, sums.b3, count)
    dense.outer(way.a1, way.g2, sums.w2, sums.b2, count)
    dense.outer(x, way.g1, sums.w1, sums.b1, count)
    n, h1 = gradient.w1.shape
    h2, m = gradient.w3.shape
    gradient.w1[:], gradient.b1[:] = sums.w1[:n, :h1], sums.b1[:h1]
    gradient.w2[:], gradient.b2[:] = sums.w2[:h1, :h2], sums.b2[:h2]
    gradient.w3[:], gradient.b3[:] = sums.w3[:h2, :m], sums.b3[:m]


@njit(cache=True)
def _product(w, x, y, count):
    for block in range(_blocks(count)):
        at = np.uint64(block) * _BLOCK
        dense.product(w, x, at, y, at)


@njit(cache=True)
def _action_rows(w1, observations, actions):
    """Transpose of the first layer's rows of the actions, padded: shape (h1, actions)."""
    result = np.zeros((_four(w1.shape[1]), _four(actions)), w1.dtype)
    for j in range(actions):
        result[: w1.shape[1], j] = w1[observations + j]
    return result


@njit(cache=True)
def _padded(layers):
    """A copy whose sizes are multiples of four."""
    n, h1 = layers.w1.shape
    h2, m = layers.w3.shape
    kind = layers.w1.dtype
    w1, b1 = np.zeros((_four(n), _four(h1)), kind), np.zeros(_four(h1), kind)
    w2, b2 = np.zeros((_four(h1), _four(h2)), kind), np.zeros(_four(h2), kind)
    w3, b3 = np.zeros((_four(h2), _four(m)), kind), np.zeros(_four(m), kind)
    w1[:n, :h1], b1[:h1] = layers.w1, layers.b1
    w2[:h1, :h2], b2[:h2] = layers.w2, layers.b2
    w3[:h2, :m], b3[:m] = layers.w3, layers.b3
    return Layers(w1, b1, w2, b2, w3, b3)


@njit(cache=True, fastmath=LOOSE)
def _adam(adam, step):
    """torch.optim.Adam's step, `step` of this call."""
    kind = adam.parameters.dtype.type
    number = adam.steps + step
    rate = kind(adam.learning_rate / (1.0 - _BETA_1**number))
    root = kind(1.0 / math.sqrt(1.0 - _BETA_2**number))
    old_1, new_1, old_2, new_2 = kind(_BETA_1), kind(1.0 - _BETA_1), kind(_BETA_2), kind(1.0 - _BETA_2)
    epsilon = kind(_EPSILON)
    for i in range(len(adam.parameters)):
        g = adam.gradient[i]
        adam.first_moment[i] = old_1 * adam.first_moment[i] + new_1 * g
        adam.second_moment[i] = old_2 * adam.second_moment[i] + new_2 * g * g
        adam.parameters[i] -= rate * adam.first_moment[i] / (math.sqrt(adam.second_moment[i]) * root + epsilon)


@njit(cache=True, fastmath=LOOSE)
def _follow(targets, parameters, rate):
    share = targets.dtype.type(rate)
    for i in range(len(targets)):
        targets[i] += share * (parameters[i] - targets[i])


@njit(cache=True)
def _four(count):
    return (count + 3) // 4 * 4


@njit(cache=True)
def _blocks(count):
    return (count + dense.BLOCK - 1) // dense.BLOCK


@njit(cache=True)
def _buffer(rows, kind):
    return np.zeros(rows * dense.ROW, kind)


@njit(cache=True)
def _pass(layers, kind):
    h1, h2, m = _four(layers.w1.shape[1]), _four(layers.w3.shape[0]), _four(layers.w3.shape[1])
    return Pass(
        _buffer(h1, kind), _buffer(h2, kind), _buffer(m, kind), _buffer(m, kind), _buffer(h1, kind), _buffer(h2, kind)
    )


@njit(cache=True)
def _draw(actions, count, kind):
    shape = (actions, count)
    return Draw(np.zeros(shape, kind), np.zeros(count, kind), np.zeros(shape, kind), np.zeros(shape, kind))
