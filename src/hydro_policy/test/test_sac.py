# SPDX-License-Identifier: Apache-2.0
"""The algorithm: its pieces against torch, and whole problems whose optimum is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hydro_policy.sac.algorithm import Sac, SquashedGaussian
from hydro_policy.sac.mlp import StackedMlp
from hydro_policy.sac.replay import Batch, ReplayBuffer
from hydro_policy.sac.settings import SacSettings


def test_log_probability_equals_torch_distributions() -> None:
    generator = torch.Generator().manual_seed(0)
    actor = SquashedGaussian(StackedMlp(1, (4, 16, 16, 4), generator, torch.float64), SacSettings())
    observation = 3.0 * torch.randn(64, 4, generator=generator, dtype=torch.float64)
    noise = torch.randn(64, 2, generator=generator, dtype=torch.float64)
    mean, log_std = actor.network.forward(observation.unsqueeze(0))[0].chunk(2, dim=1)
    normal = torch.distributions.Normal(mean, log_std.exp())
    peer = torch.distributions.TransformedDistribution(normal, [torch.distributions.TanhTransform(cache_size=1)])
    sample = actor.sample(observation, noise)
    torch.testing.assert_close(sample.action, torch.tanh(mean + log_std.exp() * noise))
    torch.testing.assert_close(sample.log_probability, peer.log_prob(sample.action).sum(1), rtol=1e-7, atol=1e-7)


def test_actor_gradient_equals_autograd() -> None:
    generator = torch.Generator().manual_seed(2)
    network = StackedMlp(1, (4, 16, 16, 4), generator, torch.float64)
    network.biases[-1][..., 2] = 5.0  # one log sigma beyond its bound: its gradient must be zero
    actor = SquashedGaussian(network, SacSettings())
    observation = torch.randn(32, 4, generator=generator, dtype=torch.float64)
    noise = torch.randn(32, 2, generator=generator, dtype=torch.float64)
    leaves = [t.clone().requires_grad_() for pair in zip(network.weights, network.biases, strict=True) for t in pair]
    with torch.enable_grad():
        hidden = observation
        for layer in range(3):
            hidden = hidden @ leaves[2 * layer][0] + leaves[2 * layer + 1][0]
            hidden = torch.relu(hidden) if layer < 2 else hidden
        mean, log_std = hidden.chunk(2, dim=1)
        log_std = log_std.clamp(-5.0, 2.0)
        squashed = mean + log_std.exp() * noise
        action = squashed.tanh()
        log_probability = torch.distributions.Normal(mean, log_std.exp()).log_prob(squashed) - torch.log(1 - action**2)
        value = torch.sin(3.0 * action[:, 0]) - action[:, 1] ** 2
        expected = torch.autograd.grad((0.3 * log_probability.sum(1) - value).mean(), leaves)
        action_gradient = torch.autograd.grad(
            (torch.sin(3.0 * (a := action.detach().requires_grad_())[:, 0]) - a[:, 1] ** 2).sum(), a
        )[0]
    actor.backward(actor.sample(observation, noise), action_gradient, 0.3)
    torch.testing.assert_close(network.gradient, torch.cat([g.reshape(-1) for g in expected]), rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("rows", [256, 100, 3])
def test_compiled_updates_are_those_of_the_equations(rows: int, dtype: torch.dtype) -> None:
    """Five updates by `learn` and by `update` on the same draws: equal to rounding; a buffer's tail does not count."""
    compiled, plain = (Sac(5, 2, SacSettings(batch_size=rows, hidden_size=30, seed=4), dtype) for _ in range(2))
    rng, memory = np.random.default_rng(1), ReplayBuffer(5, 2, 500)
    table = rng.normal(size=(400, 14)).astype(np.float32)
    table[:, 10:12], table[:, 13] = np.tanh(table[:, 10:12]), rng.random(400) < 0.2
    memory.extend(table)
    state = compiled.generator.get_state()
    compiled.learn(memory, 5)
    plain.generator.set_state(state)
    places = memory.draw(5 * rows, plain.generator).view(5, rows)
    noise = torch.randn(5, 2, rows, 2, generator=plain.generator, dtype=dtype)
    draws = iter(noise.view(10, rows, 2))
    plain._noise = lambda count: next(draws)  # type: ignore[method-assign]
    losses = []
    for drawn in places:
        parts = torch.from_numpy(table[drawn.numpy()]).to(dtype).split(memory.widths, dim=1)
        plain.update(Batch(parts[0], parts[2], parts[3].squeeze(1), parts[1], parts[4].squeeze(1)))
        losses.append(plain.losses)
    tolerance = {"rtol": 1e-11, "atol": 1e-13} if dtype == torch.float64 else {"rtol": 1e-3, "atol": 2e-5}
    for name in ("actor_network", "critics", "target_critics"):
        found, want = getattr(compiled, name).parameters, getattr(plain, name).parameters
        torch.testing.assert_close(found, want, **tolerance)
    assert compiled.entropy_coefficient == pytest.approx(plain.entropy_coefficient, rel=1e-6)
    assert compiled.losses == pytest.approx(np.mean(losses, axis=0), rel=1e-9 if dtype == torch.float64 else 1e-3)
    assert (compiled.updates, compiled.actor_optimizer.steps) == (plain.updates, plain.actor_optimizer.steps)


def test_linear_quadratic_regulator_is_learnt() -> None:
    """x' = x + 0.5 a, cost x^2 + 0.1 a^2, discount 0.9: within 10 % of the Riccati optimum after 6000 updates."""
    b, q, r, gamma = 0.5, 1.0, 0.1, 0.9
    p = q
    for _ in range(500):  # discounted Riccati recursion
        p = q + gamma * p - (gamma * p * b) ** 2 / (r + gamma * p * b * b)
    gain = gamma * p * b / (r + gamma * p * b * b)

    def cost(policy: object) -> float:
        x, total = np.linspace(-0.6, 0.6, 25), 0.0
        for k in range(60):
            a = np.clip(policy(x), -1, 1)  # type: ignore[operator]
            total += gamma**k * float(np.mean(q * x**2 + r * a**2))
            x = x + b * a
        return total

    rng = np.random.default_rng(0)
    x, a = rng.uniform(-1, 1, 5000), rng.uniform(-1, 1, 5000)
    rows = np.stack((x, x + b * a, a, -(q * x**2 + r * a**2), np.zeros(5000)), axis=1).astype(np.float32)
    sac = Sac(
        1, 1, SacSettings(batch_size=128, discount=gamma, target_entropy=-1.0, reward_scale=1.0, target_rate=0.02)
    )
    memory = ReplayBuffer(1, 1, 5000)
    memory.extend(rows)
    sac.learn(memory, 6000)

    def learnt(x: np.ndarray) -> np.ndarray:
        rows = torch.from_numpy(x.astype(np.float32)).unsqueeze(1)
        return sac.actor.sample(rows, torch.zeros(len(x), 1)).action[:, 0].numpy()

    assert cost(learnt) < 1.10 * cost(lambda x: -gain * x)
    assert cost(lambda x: 0.0 * x) > 2.0 * cost(lambda x: -gain * x), "doing nothing would pass too"
