# SPDX-License-Identifier: Apache-2.0
"""The updates against torch's distributions and optimizer, compiled against not; a problem whose optimum is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.linalg import solve_discrete_are
from torch import Tensor
from torch.optim import Adam

from hydro_policy.sac.agent import ReplayBuffer
from hydro_policy.sac.sac import Sac, compile_update
from hydro_policy.sac.settings import SacSettings


def leaves(sac: Sac, name: str) -> list[Tensor]:
    """Copies of weights [member, fan_in, fan_out] and biases [member, 1, fan_out] of `actor` or `critics`, in turn."""
    return [torch.from_numpy(part.copy()).requires_grad_() for part in sac.parts(name)]


def forward(layers: Sequence[Tensor], inputs: Tensor) -> Tensor:
    """Outputs of all members, shape (members, batch, outputs)."""
    for k in range(0, len(layers), 2):
        inputs = inputs @ layers[k] + layers[k + 1]
        inputs = torch.relu(inputs) if k < len(layers) - 2 else inputs
    return inputs


def descend(optimizer: Adam, loss: Tensor) -> float:
    optimizer.zero_grad()
    loss.backward(inputs=optimizer.param_groups[0]["params"])
    optimizer.step()
    return float(loss.detach())


class Equations:
    """training.md's equations by autograd, torch.distributions and torch.optim.Adam, from a `Sac`'s beginning."""

    def __init__(self, begun: Sac) -> None:
        self.settings, s = begun.settings, begun.settings
        self.actor, self.critics = leaves(begun, "actor"), leaves(begun, "critics")
        self.targets = [tensor.detach().clone() for tensor in self.critics]
        self.log_alpha = torch.from_numpy(begun.vectors["entropy.parameters"].copy()).requires_grad_()
        self.actor_adam = Adam(self.actor, lr=s.actor_learning_rate)
        self.critic_adam = Adam(self.critics, lr=s.critic_learning_rate)
        self.alpha_adam = Adam([self.log_alpha], lr=s.entropy_learning_rate)

    def sample(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """a = tanh(u) and log pi(a|o), u = mu + sigma noise."""
        mean, raw = forward(self.actor, observation)[0].chunk(2, dim=1)
        log_std = raw.clamp(self.settings.log_std_min, self.settings.log_std_max)
        u = mean + log_std.exp() * noise
        squash = torch.distributions.TanhTransform()
        density = torch.distributions.Normal(mean, log_std.exp()).log_prob(u)
        return torch.tanh(u), (density - squash.log_abs_det_jacobian(u, torch.tanh(u))).sum(1)

    def update(self, batch: Sequence[Tensor], noise: Tensor) -> tuple[float, float, float]:
        """One update; `batch`: o, o', a, r, terminated; `noise`: of the targets, the actor. Returns the losses."""
        s, (o, following, a, r, terminated) = self.settings, batch
        alpha = float(self.log_alpha.detach().exp())
        with torch.no_grad():
            action, density = self.sample(following, noise[0])
            value = forward(self.targets, torch.cat((following, action), 1))[..., 0].amin(0) - alpha * density
            y = s.reward_scale * r[:, 0] + s.gamma * (1.0 - terminated[:, 0]) * value
        critics = 0.5 * (forward(self.critics, torch.cat((o, a), 1))[..., 0] - y).square().mean(1).sum()
        of_critics = descend(self.critic_adam, critics)
        action, density = self.sample(o, noise[1])
        values = forward(self.critics, torch.cat((o, action), 1))[..., 0]
        of_actor = descend(self.actor_adam, (alpha * density - values.amin(0)).mean())
        temperature = -(self.log_alpha * (density.detach().mean() + s.target_entropy)).sum()
        for target, critic in zip(self.targets, self.critics, strict=True):
            target.lerp_(critic.detach(), s.tau)
        return of_critics, of_actor, descend(self.alpha_adam, temperature)


@pytest.mark.parametrize("dtype", [pytest.param(torch.float64, marks=pytest.mark.study), torch.float32])
@pytest.mark.parametrize("rows", [256, 100, 3])
def test_updates_are_those_of_the_equations(rows: int, dtype: torch.dtype) -> None:
    """Five updates on the same draws: equal to rounding; a buffer's tail, and a sigma at its bound, do not count."""
    sac = Sac(5, 2, SacSettings(batch_size=rows, hidden_size=30, seed=4), torch.empty(0, dtype=dtype).numpy().dtype)
    if rows == 100:
        sac.parts("actor")[-1][0, 0, 2] = -8.0  # sigma at its lower bound
    equations = Equations(sac)
    rng, memory = np.random.default_rng(1), ReplayBuffer(5, 2, 500)
    table = rng.normal(size=(400, 14)).astype(np.float32)
    table[:, 10:12], table[:, 13] = np.tanh(table[:, 10:12]), rng.random(400) < 0.2
    memory.extend(table)
    batches, noise = sac.draw(memory, 5)
    sac.learn(memory, 5)
    drawn = [torch.from_numpy(batch).to(dtype).split((5, 5, 2, 1, 1), dim=1) for batch in batches]
    losses = [equations.update(*each) for each in zip(drawn, torch.from_numpy(noise), strict=True)]
    tolerance = {"rtol": 1e-11, "atol": 1e-13} if dtype == torch.float64 else {"rtol": 1e-3, "atol": 2e-5}
    for key, name in (("actor.parameters", "actor"), ("critics.parameters", "critics"), ("target_critics", "targets")):
        want = torch.cat([each.detach().ravel() for each in getattr(equations, name)])
        torch.testing.assert_close(torch.from_numpy(sac.vectors[key]), want, **tolerance)
    assert sac.entropy_coefficient == pytest.approx(float(equations.log_alpha.detach().exp()), rel=1e-6)
    assert sac.losses == pytest.approx(np.mean(losses, axis=0), rel=1e-9 if dtype == torch.float64 else 1e-3)
    assert (sac.updates, sac.steps) == (5, 5)


@pytest.mark.parametrize("rows", [256, 3])
def test_compiled_updates_are_those_of_the_same_function(rows: int) -> None:
    """Twenty updates of the sizes that set-up compiles; resumed after ten to the same bits."""
    assert not compile_update(13, 2, 32)
    compiled, resumed, plain = (Sac(13, 2, SacSettings(batch_size=rows, seed=4)) for _ in range(3))
    assert compiled.compiled
    plain._update = None
    memory = ReplayBuffer(13, 2, 500)
    memory.extend(np.random.default_rng(1).normal(size=(400, 30)).astype(np.float32) * 0.3)
    for sac in (compiled, plain):
        sac.learn(memory, 10)
    resumed.restore(compiled.dump())
    for sac in (compiled, plain, resumed):
        sac.learn(memory, 10)
    np.testing.assert_array_equal(resumed.state, compiled.state)
    for name, vector in compiled.vectors.items():
        np.testing.assert_allclose(vector, plain.vectors[name], rtol=2e-3, atol=2e-4)


def test_linear_quadratic_regulator_is_learnt() -> None:
    """x' = x + 0.5 a, cost x^2 + 0.1 a^2, gamma 0.9: within 10 % of the Riccati optimum, median of three seeds.

    In the first of the observations and actions whose update set-up compiles; the others are 0 and without effect.
    """
    b, q, r, gamma = 0.5, 1.0, 0.1, 0.9
    discount = np.array([[np.sqrt(gamma)]])
    p = float(solve_discrete_are(discount, b * discount, q * np.eye(1), r * np.eye(1))[0, 0])
    gain = gamma * p * b / (r + gamma * p * b * b)

    def cost(policy: Callable[[np.ndarray], np.ndarray]) -> float:
        x, total = np.linspace(-0.6, 0.6, 25), 0.0
        for k in range(60):
            a = np.clip(policy(x), -1, 1)
            total += gamma**k * float(np.mean(q * x**2 + r * a**2))
            x = x + b * a
        return total

    x, a, idle = np.random.default_rng(0).uniform(-1, 1, (3, 5000))
    memory, rows = ReplayBuffer(13, 2, 5000), np.zeros((5000, 30), np.float32)
    rows[:, 0], rows[:, 13], rows[:, 26], rows[:, 27], rows[:, 28] = x, x + b * a, a, idle, -(q * x**2 + r * a**2)
    memory.extend(rows)
    settings = SacSettings(batch_size=128, gamma=gamma, target_entropy=-2.0, reward_scale=1.0, tau=0.02)

    assert not compile_update(13, 2, 32)

    def learnt(seed: int) -> float:
        sac = Sac(13, 2, replace(settings, seed=seed))
        sac.learn(memory, 6000)
        layers = [layer.detach() for layer in leaves(sac, "actor")]
        seen = torch.zeros(25, 13)

        def act(x: np.ndarray) -> np.ndarray:
            seen[:, 0] = torch.from_numpy(x)
            return torch.tanh(forward(layers, seen)[0, :, 0]).numpy()

        return cost(act)

    best = cost(lambda x: -gain * x)
    assert np.median([learnt(seed) for seed in range(3)]) < 1.10 * best
    assert cost(lambda x: 0.0 * x) > 2.0 * best, "doing nothing would pass too"
