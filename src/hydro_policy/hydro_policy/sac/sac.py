# SPDX-License-Identifier: Apache-2.0
"""Soft Actor-Critic (Haarnoja et al. 2018), from top to bottom: replay buffer, networks, update, agent, its file.

::

    policy         a = tanh(u), u = mu(o) + sigma(o) eps, eps ~ N(0, I)
                   log pi(a|o) = sum_j [log N(u_j; mu_j, sigma_j) - log(1 - a_j^2)]
    targets        y = c r + gamma (1 - d) (min_i Q'_i(o', a') - alpha log pi(a'|o')), a' ~ pi(o')
    critics        descend 1/2 sum_i mean (Q_i(o, a) - y)^2
    actor          descends mean(alpha log pi(a|o) - min_i Q_i(o, a)), a ~ pi(o)
    temperature    log alpha descends -log alpha (mean log pi(a|o) + target entropy)
    Polyak         Q' <- Q' + tau (Q - Q')

Independent of hydraulics, ROS and processes. Gradients are written out, and many updates are one compiled call
(`learn`), whose batches and noise are drawn beforehand: at 2 x 32 units an update on 256 transitions takes 13 MFLOP,
less than the bookkeeping of an automatic differentiation. `test_sac` compares it with the equations in torch.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from hydro_core.files.tensors import check_finite, check_shapes
from hydro_core.settings import check
from hydro_core.signals import FloatArray
from hydro_policy.sac.dense import BATCH_MAX, BLOCK_SIZE, STRIDE, Floats, affine, outer, relu, relu_gradient
from hydro_policy.sac.settings import SacSettings
from hydro_sim.jit import njit

# ---------------------------------------------------------------------------------------------------- replay buffer

_COUNTER_BYTES = 64  # a separate cache line
_MARGIN_ROWS = 64  # oldest rows of a full buffer that are not drawn: the other process may be overwriting them


class ReplayBuffer:
    """Replay buffer of the last `capacity` transitions, one row each, so that a batch is one gather.

        row        [ observation | next observation | action | reward, terminated ]   float32
        example    13 + 13 + 2 + 2 = 30 numbers; 288 000 rows (the paper's 160 x 1800) are 35 MB

    It can be in memory shared between the acting process, which appends, and the learner process, which draws: nothing
    is sent, and nothing is lost when the learner dies.

    `observations`, `actions`: sizes of an observation and of an action. `capacity`: rows kept, more than 64; the oldest
    are overwritten. `memory`: writable buffer of `nbytes` bytes, initially zero. None: private memory.
    """

    def __init__(self, observations: int, actions: int, capacity: int, memory: object | None = None) -> None:
        self.widths = (observations, observations, actions, 1, 1)
        if memory is None:
            memory = bytearray(self.nbytes(observations, actions, capacity))
        self._counter = np.frombuffer(memory, np.int64, 1)  # type: ignore[call-overload]
        rows = np.frombuffer(memory, np.float32, capacity * sum(self.widths), _COUNTER_BYTES)  # type: ignore[call-overload]
        self.rows: NDArray[np.float32] = rows.reshape(capacity, -1)

    @staticmethod
    def nbytes(observations: int, actions: int, capacity: int) -> int:
        """Return the bytes needed for a buffer of these sizes."""
        return _COUNTER_BYTES + 4 * capacity * (2 * observations + actions + 2)

    @property
    def total_appended(self) -> int:
        """Number of transitions ever appended."""
        return int(self._counter[0])

    def __len__(self) -> int:
        return min(self.total_appended, len(self.rows))

    def extend(self, rows: NDArray[np.float32]) -> None:
        """Append rows [n, width] in order, overwriting the oldest. Only one process may do this.

        Raises ValueError: a row holds NaN or infinity, which would corrupt every network at the first batch with it.
        """
        if not np.isfinite(rows).all():
            raise ValueError("a transition holds a value that is not finite")
        kept = rows[-len(self.rows) :]
        first = self.total_appended + len(rows) - len(kept)
        self.rows[(first + np.arange(len(kept))) % len(self.rows)] = kept
        self._counter[0] = first + len(kept)  # after the rows: a reader that sees the count finds them complete

    def draw(self, shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.int64]:
        """Draw indices in `rows` of stored transitions, uniformly, with replacement."""
        produced, capacity = self.total_appended, len(self.rows)
        if produced < capacity:
            return rng.integers(produced, size=shape)
        return (produced - 1 - rng.integers(capacity - _MARGIN_ROWS, size=shape)) % capacity

    def snapshot(self) -> tuple[NDArray[np.float32], int]:
        """Return a copy of all stored rows, oldest first, and `total_appended` at that moment."""
        produced = self.total_appended
        if produced < len(self.rows):
            return self.rows[:produced].copy(), produced
        return np.roll(self.rows, -(produced % len(self.rows)), axis=0), produced

    def restore(self, rows: NDArray[np.float32], produced: int) -> None:
        """Restore the result of `snapshot`, so that appending continues at the same row."""
        self.rows[(produced - len(rows) + np.arange(len(rows))) % len(self.rows)] = rows
        self._counter[0] = produced


# ---------------------------------------------------------------------------------------------------------- networks

Indices = NDArray[np.int64]
"""Indices into a flat vector."""


@njit
def round_up_to_four(count):
    """Return `count` rounded up to a multiple of four, the layer sizes of `dense`."""
    return (count + 3) // 4 * 4


LayerIndices = tuple[Indices, Indices]
"""Indices of a layer's weights [member, fan_in, fan_out] and biases [member, fan_out] in the flat vector."""


def layers(members: int, inputs: tuple[int, ...], hidden: int, outputs: int) -> tuple[int, list[LayerIndices]]:
    """Return the layout of `members` perceptrons with two equal hidden layers: length of the flat vector, layers in it.

    Every layer is padded with zeros to a multiple of four, with gradients of zero, so that the padding stays zero.
    Files and `Policy.load_flat` have weights and biases in the order of the layers, without padding. `inputs`: sizes of
    the observation and, if it is an input, of the action; each is padded.
    """
    starts = np.cumsum([0, *map(round_up_to_four.py_func, inputs)])
    padded = int(starts[-1]), round_up_to_four.py_func(hidden), round_up_to_four.py_func(outputs)
    length = (padded[0] + padded[1] + 2) * padded[1] + (padded[1] + 1) * padded[2]
    of_inputs = np.concatenate([start + np.arange(n) for start, n in zip(starts, inputs, strict=False)])
    units = [of_inputs, np.arange(hidden), np.arange(hidden), np.arange(outputs)]
    networks = [network.py_func(flat, *padded) for flat in np.arange(members * length).reshape(members, -1)]
    found = [
        (
            np.stack([each[2 * k][np.ix_(units[k], units[k + 1])] for each in networks]),
            np.stack([each[2 * k + 1][units[k + 1]] for each in networks]),
        )
        for k in range(3)
    ]
    return members * length, found


class Network(NamedTuple):
    """Weights [fan_in, fan_out] and biases [fan_out] of one network, or their gradients."""

    w1: Floats
    b1: Floats
    w2: Floats
    b2: Floats
    w3: Floats
    b3: Floats


class Activations(NamedTuple):
    """Activations h1, h2, y of one network, and the loss's gradients g1, g2, gy by them, in the layout of `dense`."""

    h1: Floats
    h2: Floats
    y: Floats
    g1: Floats
    g2: Floats
    gy: Floats


@njit
def network(flat, inputs, hidden, outputs):
    """Return the weights and biases of one network, as views of its part of a flat vector."""
    a = inputs * hidden
    b = a + hidden + hidden * hidden
    c = b + hidden + hidden * outputs
    return Network(
        flat[:a].reshape(inputs, hidden), flat[a : a + hidden],
        flat[a + hidden : b].reshape(hidden, hidden), flat[b : b + hidden],
        flat[b + hidden : c].reshape(hidden, outputs), flat[c : c + outputs],
    )  # fmt: skip


@njit
def critic_networks(flat, inputs, hidden):
    """Return both critics, as views of their flat vector; their single output is padded to four."""
    half = len(flat) // 2
    return network(flat[:half], inputs, hidden, 4), network(flat[half:], inputs, hidden, 4)


@njit
def zero_activations(net):
    """Return zero activations and gradients for a network and the largest batch."""
    hidden, outputs = net.w3.shape
    kind = net.w1.dtype
    return Activations(
        np.zeros(hidden * STRIDE, kind), np.zeros(hidden * STRIDE, kind), np.zeros(outputs * STRIDE, kind),
        np.zeros(hidden * STRIDE, kind), np.zeros(hidden * STRIDE, kind), np.zeros(outputs * STRIDE, kind),
    )  # fmt: skip


@njit
def forward(net, x, p, batch):
    """Forward pass: h1 = relu(W1^T x + b1), h2 = relu(W2^T h1 + b2), y = W3^T h2 + b3, with x cut to the rows of W1."""
    for at in range(0, batch, BLOCK_SIZE):
        affine(net.w1, net.b1, x, p.h1, at)
        relu(p.h1, len(net.b1), at)
        affine(net.w2, net.b2, p.h1, p.h2, at)
        relu(p.h2, len(net.b2), at)
        affine(net.w3, net.b3, p.h2, p.y, at)


@njit
def backpropagate(net, p, batch):
    """Backward pass to the hidden layers: g2 = W3 gy and g1 = W2 g2, zero where the activation is."""
    w3, w2, zeros = net.w3.T.copy(), net.w2.T.copy(), np.zeros_like(net.b1)
    for at in range(0, batch, BLOCK_SIZE):
        affine(w3, zeros, p.gy, p.g2, at)
        relu_gradient(p.g2, p.h2, len(zeros), at)
        affine(w2, zeros, p.g2, p.g1, at)
        relu_gradient(p.g1, p.h1, len(zeros), at)


@njit
def backward(net, x, p, batch, gradient):
    """Backward pass: `gradient` of weights and biases from the gradient gy by the outputs."""
    backpropagate(net, p, batch)
    outer(p.h2, p.gy, gradient.w3, gradient.b3, batch)
    outer(p.h1, p.g2, gradient.w2, gradient.b2, batch)
    outer(x, p.g1, gradient.w1, gradient.b1, batch)


# ------------------------------------------------------------------------------------------------------------ update


class Adam(NamedTuple):
    """Parameters and their Adam state: flat vectors of one dtype, updated in place."""

    parameters: Floats
    first_moment: Floats
    second_moment: Floats
    gradient: Floats
    learning_rate: float


class Agent(NamedTuple):
    """Parameters and optimizer states that an update changes."""

    actor: Adam
    critics: Adam
    entropy: Adam
    """Optimizer of log alpha, the logarithm of the entropy coefficient."""
    targets: Floats


class Constants(NamedTuple):
    """Sizes of the networks, and hyperparameters in the networks' dtype."""

    observations: int
    actions: int
    hidden: int
    gamma: Any
    tau: Any
    reward_scale: Any
    target_entropy: Any
    log_std_min: Any
    log_std_max: Any


@njit
def learn(agent, c, steps, rows, indices, noise, losses):
    """Perform one update per row of `indices`: the batches, as rows of the buffer's `rows`, shape (updates, batch).

    `noise`: standard normal, shape (updates, 2, batch, actions), first for the targets, then for the actor.
    `steps`: optimizer steps before this call. `losses`: output, losses of critics, actor and temperature before each
    update, shape (updates, 3).
    """
    n, m, batch, kind = c.observations, c.actions, indices.shape[1], agent.targets.dtype
    zero, one, two, share = kind.type(0.0), kind.type(1.0), kind.type(2.0), kind.type(1.0 / batch)
    first_action = round_up_to_four(n)  # row of the inputs
    inputs, hidden = first_action + round_up_to_four(m), round_up_to_four(c.hidden)
    actor = network(agent.actor.parameters, first_action, hidden, round_up_to_four(2 * m))
    actor_gradient = network(agent.actor.gradient, first_action, hidden, round_up_to_four(2 * m))
    q = critic_networks(agent.critics.parameters, inputs, hidden)
    q_gradient = critic_networks(agent.critics.gradient, inputs, hidden)
    target = critic_networks(agent.targets, inputs, hidden)
    of_actor, of_q = zero_activations(actor), (zero_activations(q[0]), zero_activations(q[1]))
    now, following = np.zeros(inputs * STRIDE, kind), np.zeros(inputs * STRIDE, kind)  # [o, a] and [o', a'] as columns
    slope = np.zeros(round_up_to_four(m) * STRIDE, kind), np.zeros(round_up_to_four(m) * STRIDE, kind)
    reward, going_on = np.empty(batch, kind), np.empty(batch, kind)
    y, log_pi = np.empty(batch, kind), np.empty(batch, kind)
    deviation, inside = np.empty((m, batch), kind), np.empty((m, batch), kind)

    for update in range(len(indices)):
        step = steps + update + 1
        alpha = math.exp(agent.entropy.parameters[0])

        # a batch of transitions (o, o', a, r, d)
        for k in range(batch):
            row = rows[indices[update, k]]
            for i in range(n):
                now[i * STRIDE + k], following[i * STRIDE + k] = row[i], row[n + i]
            for j in range(m):
                now[(first_action + j) * STRIDE + k] = row[2 * n + j]
            reward[k], going_on[k] = row[2 * n + m], one - row[2 * n + m + 1]

        # targets: y = c r + gamma (1 - d) (min_i Q'_i(o', a') - alpha log pi(a'|o')), a' ~ pi(o')
        sample(actor, c, following, noise[update, 0], of_actor, log_pi, deviation, inside)
        for i in range(2):
            forward(target[i], following, of_q[i], batch)
        for k in range(batch):
            value = min(of_q[0].y[k], of_q[1].y[k]) - alpha * log_pi[k]
            y[k] = c.reward_scale * reward[k] + c.gamma * going_on[k] * value

        # critics: gradient of 1/2 sum_i mean (Q_i(o, a) - y)^2
        for i in range(2):
            forward(q[i], now, of_q[i], batch)
        squares = 0.0
        for k in range(batch):
            error_1, error_2 = of_q[0].y[k] - y[k], of_q[1].y[k] - y[k]
            of_q[0].gy[k], of_q[1].gy[k] = share * error_1, share * error_2
            squares += error_1 * error_1 + error_2 * error_2
        for i in range(2):
            backward(q[i], now, of_q[i], batch, q_gradient[i])
        adam(agent.critics, step)
        losses[update, 0] = 0.5 * squares / batch

        # actor: gradient of mean(alpha log pi(a|o) - min_i Q_i(o, a)), a = tanh(u), u = mu + sigma eps
        sample(actor, c, now, noise[update, 1], of_actor, log_pi, deviation, inside)
        for i in range(2):
            forward(q[i], now, of_q[i], batch)
        total = 0.0
        for k in range(batch):  # only the smaller critic passes its gradient on
            of_q[0].gy[k], of_q[1].gy[k] = (one, zero) if of_q[0].y[k] <= of_q[1].y[k] else (zero, one)
            total += alpha * log_pi[k] - min(of_q[0].y[k], of_q[1].y[k])
        for i in range(2):  # dQ_i/da
            backpropagate(q[i], of_q[i], batch)
            to_actions = q[i].w1[first_action:].T.copy()
            for at in range(0, batch, BLOCK_SIZE):
                affine(to_actions, np.zeros(round_up_to_four(m), kind), of_q[i].g1, slope[i], at)
        for j in range(m):
            for k in range(batch):
                # d log pi/du = 2 a, da/du = 1 - a^2, du/d log sigma = sigma eps, and log N has -log sigma
                a = now[(first_action + j) * STRIDE + k]
                to_u = two * alpha * a - (slope[0][j * STRIDE + k] + slope[1][j * STRIDE + k]) * (one - a * a)
                of_actor.gy[j * STRIDE + k] = share * to_u
                of_actor.gy[(m + j) * STRIDE + k] = share * (to_u * deviation[j, k] - alpha) * inside[j, k]
        backward(actor, now, of_actor, batch, actor_gradient)
        adam(agent.actor, step)
        losses[update, 1] = total / batch

        # temperature: gradient of -log alpha (mean log pi(a|o) + target entropy) by log alpha
        agent.entropy.gradient[0] = -(log_pi.sum() * share + c.target_entropy)
        losses[update, 2] = agent.entropy.parameters[0] * agent.entropy.gradient[0]
        adam(agent.entropy, step)

        # Polyak: Q' <- Q' + tau (Q - Q')
        polyak(agent.targets, agent.critics.parameters, c.tau)


@njit
def sample(actor, c, x, noise, p, log_pi, deviation, inside):
    """Draw a = tanh(u), u = mu + sigma eps into the action rows of x, and log pi(a|o).

    `deviation`: sigma eps. `inside`: 1 where log sigma is within its bounds, 0 where it is clamped.
    """
    m, batch, first_action, kind = c.actions, len(log_pi), len(actor.w1), log_pi.dtype
    zero, half, one, two = kind.type(0.0), kind.type(0.5), kind.type(1.0), kind.type(2.0)
    log_2, half_log_2pi = kind.type(math.log(2.0)), kind.type(0.5 * math.log(2.0 * math.pi))
    forward(actor, x, p, batch)
    log_pi[:] = zero
    for j in range(m):
        for k in range(batch):
            raw, eps = p.y[(m + j) * STRIDE + k], noise[k, j]
            log_std = min(max(raw, c.log_std_min), c.log_std_max)
            deviation[j, k], inside[j, k] = math.exp(log_std) * eps, one if raw == log_std else zero
            u = p.y[j * STRIDE + k] + deviation[j, k]
            fading = math.exp(-two * abs(u))  # both tanh and log(1 - tanh^2) from one exponential
            x[(first_action + j) * STRIDE + k] = math.copysign((one - fading) / (one + fading), u)
            log_1_minus_a2 = two * (log_2 - u - math.log1p(fading) - max(-two * u, zero))
            log_pi[k] += -half * eps * eps - log_std - half_log_2pi - log_1_minus_a2


@njit(fastmath={"reassoc", "contract"})
def adam(of, step):
    """Adam step (Kingma and Ba 2015, algorithm 1), as torch.optim.Adam: betas 0.9 and 0.999, epsilon 1e-8."""
    kind = of.parameters.dtype
    rate, root = kind.type(of.learning_rate / (1.0 - 0.9**step)), kind.type(1.0 / math.sqrt(1.0 - 0.999**step))
    keep_1, new_1, keep_2, new_2 = kind.type(0.9), kind.type(1.0 - 0.9), kind.type(0.999), kind.type(1.0 - 0.999)
    epsilon = kind.type(1e-8)
    for i in range(len(of.parameters)):
        g = of.gradient[i]
        of.first_moment[i] = keep_1 * of.first_moment[i] + new_1 * g
        of.second_moment[i] = keep_2 * of.second_moment[i] + new_2 * g * g
        of.parameters[i] -= rate * of.first_moment[i] / (math.sqrt(of.second_moment[i]) * root + epsilon)


@njit(fastmath={"reassoc", "contract"})
def polyak(targets, parameters, tau):
    """Polyak averaging: targets += tau (parameters - targets)."""
    for i in range(len(targets)):
        targets[i] += tau * (parameters[i] - targets[i])


# ------------------------------------------------------------------------------------------------------------- agent


class Losses(NamedTuple):
    """Losses of one update, each evaluated on its batches before the update; NaN before the first."""

    critics: float = math.nan
    """1/2 sum_i mean (Q_i(o, a) - y)^2"""
    actor: float = math.nan
    """mean(alpha log pi(a|o) - min_i Q_i(o, a))"""
    temperature: float = math.nan
    """-log(alpha) (mean log pi(a|o) + target entropy)"""


class Sac:
    """Soft Actor-Critic agent: actor, twin critics, targets, temperature and their optimizers.

    Batches and noise of an update follow from the seed and the number of the update: no generator has to be saved.

    `observations`, `actions`: sizes of the observation and of the action; actions lie in (-1, 1). `dtype`: float32 in
    use; float64 for checks.
    """

    def __init__(self, observations: int, actions: int, settings: SacSettings, dtype: Any = np.float32) -> None:
        self.settings = settings
        actor, of_actor = layers(1, (observations,), settings.hidden_size, 2 * actions)
        critics, of_critics = layers(2, (observations, actions), settings.hidden_size, 1)
        self.layers = {"actor": of_actor, "critics": of_critics}
        self.parameter_indices = {
            name: np.concatenate([indices.ravel() for layer in found for indices in layer])
            for name, found in self.layers.items()
        }
        """Indices of each network's parameters in its padded vector, in the order of files."""
        lengths = [actor] * 3 + [critics] * 3 + [1] * 3 + [critics]
        numbers = -(-sum(lengths) * np.dtype(dtype).itemsize // 8)
        self.state: NDArray[np.int64] = np.zeros(2 + numbers, np.int64)
        """Complete state: counters of updates and optimizer steps, then all vectors of `agent`, which are its views."""
        vectors = np.split(self.state[2:].view(dtype), np.cumsum(lengths))
        rates = settings.actor_learning_rate, settings.critic_learning_rate, settings.entropy_learning_rate
        optimizers = [
            Adam(vectors[k], vectors[k + 1], vectors[k + 2], np.zeros_like(vectors[k]), rate)
            for k, rate in zip((0, 3, 6), rates, strict=True)
        ]
        self.agent = Agent(optimizers[0], optimizers[1], optimizers[2], vectors[9])
        rng = np.random.default_rng(settings.seed).spawn(1)[0]  # exploration has the seed itself
        for found, optimizer in ((of_actor, self.agent.actor), (of_critics, self.agent.critics)):
            for layer in found:
                bound = 1.0 / math.sqrt(layer[0].shape[1])
                for indices in layer:
                    optimizer.parameters[indices] = rng.uniform(-bound, bound, indices.shape)
        self.agent.targets[:] = self.agent.critics.parameters
        self.agent.entropy.parameters[:] = math.log(settings.initial_entropy_coefficient)
        s, kind = settings, np.dtype(dtype).type
        self._constants = Constants(
            observations, actions, s.hidden_size, kind(s.gamma), kind(s.tau), kind(s.reward_scale),
            kind(s.target_entropy), kind(s.log_std_min), kind(s.log_std_max),
        )  # fmt: skip
        self.losses = Losses()
        """Losses, mean over the updates of the last `learn`."""

    @property
    def updates(self) -> int:
        """Number of updates in this run."""
        return int(self.state[0])

    @updates.setter
    def updates(self, count: int) -> None:
        self.state[0] = count

    @property
    def steps(self) -> int:
        """Number of optimizer steps, those of earlier runs included."""
        return int(self.state[1])

    @property
    def entropy_coefficient(self) -> float:
        """alpha, the temperature."""
        return math.exp(self.agent.entropy.parameters[0])

    def actor_parameters(self) -> FloatArray:
        """Return a copy of the actor's flat parameters, float64, for `Policy.load_flat`."""
        return np.asarray(self.agent.actor.parameters[self.parameter_indices["actor"]], np.float64)

    def draw(self, replay: ReplayBuffer, updates: int) -> tuple[NDArray[np.int64], Floats]:
        """Draw the batches and the noise of the next updates (`learn`)."""
        rng = np.random.default_rng((self.settings.seed, self.updates))
        indices = replay.draw((updates, self.settings.batch_size), rng)
        shape = (updates, 2, self.settings.batch_size, self._constants.actions)
        return indices, rng.standard_normal(shape, self.agent.targets.dtype)

    def learn(self, replay: ReplayBuffer, updates: int) -> None:
        """Update critics, actor, temperature and targets, `updates` times, in one compiled call."""
        if self.settings.batch_size > BATCH_MAX:  # compiled code does not look
            raise ValueError(f"batch_size {self.settings.batch_size} is above {BATCH_MAX}")
        losses = np.empty((updates, 3))
        learn(self.agent, self._constants, self.steps, replay.rows, *self.draw(replay, updates), losses)
        self.losses = Losses(*losses.mean(axis=0).tolist())
        self.state[:2] += updates


# ---------------------------------------------------------------------------------------------------------- its file

_OPTIMISER_NAMES = ("actor", "critics", "entropy")
_OPTIMISER_VECTORS = ("parameters", "first_moment", "second_moment")


def dump(sac: Sac) -> bytes:
    """Return the complete state of an agent as the content of a safetensors file (no pickle).

    Each network and each moment is one flat tensor without padding; counters and settings are JSON under the header key
    "hydro".
    """
    tensors = {key: vector[indices] for key, vector, indices in _vectors(sac)}
    counters = {"updates": sac.updates, **{f"{name}.steps": sac.steps for name in _OPTIMISER_NAMES}}
    return bytes(save(tensors, {"hydro": json.dumps({"counters": counters, "settings": asdict(sac.settings)})}))


def restore(sac: Sac, blob: bytes) -> None:
    """Restore an agent from the result of `dump`: later updates are bit-identical.

    Raises ValueError: the bytes are not a dump, are of networks of another shape, or hold invalid numbers.
    """
    tensors, header = _opened(blob)
    check_shapes(tensors, {key: vector[indices].shape for key, vector, indices in _vectors(sac)})
    for key, vector, indices in _vectors(sac):
        vector[indices] = tensors[key]
    sac.state[:2] = header["counters"]["updates"], header["counters"]["actor.steps"]


def actor_parameters(blob: bytes) -> FloatArray:
    """Return the actor's flat parameters in a dump, float64, for `Policy.load_flat`."""
    return np.asarray(_opened(blob)[0]["actor.parameters"], np.float64)


def settings_of(blob: bytes) -> SacSettings:
    """Return the settings of the agent in a dump."""
    settings = SacSettings(**_opened(blob)[1]["settings"])
    check(settings)
    return settings


def _vectors(sac: Sac) -> list[tuple[str, Floats, Any]]:
    """Return the name in a file of each vector, the vector, and where in it the numbers of the file are."""
    indices = {**sac.parameter_indices, "entropy": slice(None)}
    kept = [
        (f"{name}.{key}", getattr(getattr(sac.agent, name), key), indices[name])
        for name in _OPTIMISER_NAMES
        for key in _OPTIMISER_VECTORS
    ]
    return [*kept, ("target_critics", sac.agent.targets, indices["critics"])]


def _opened(blob: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return tensors and header; raises ValueError if they are truncated or damaged."""
    try:
        tensors = load(blob)
        length = int.from_bytes(blob[:8], "little")
        header: dict[str, Any] = json.loads(json.loads(blob[8 : 8 + length])["__metadata__"]["hydro"])
    except (SafetensorError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"not a whole agent: {' '.join(str(error).split())}") from error
    check_finite(tensors)
    return tensors, header
