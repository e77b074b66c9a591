# SPDX-License-Identifier: Apache-2.0
"""The written-out gradients and Adam, against torch's own."""

from __future__ import annotations

import torch

from hydro_policy.sac.mlp import FlatAdam, StackedMlp


def reference_forward(
    network: StackedMlp, member: int, inputs: torch.Tensor, leaves: list[torch.Tensor]
) -> torch.Tensor:
    """The same network as ordinary torch code on `leaves` (weights and biases in turn)."""
    hidden = inputs
    for layer in range(len(network.weights)):
        hidden = hidden @ leaves[2 * layer][member] + leaves[2 * layer + 1][member]
        if layer < len(network.weights) - 1:
            hidden = torch.relu(hidden)
    return hidden


def test_gradients_equal_autograd() -> None:
    generator = torch.Generator().manual_seed(3)
    network = StackedMlp(2, (5, 7, 6, 3), generator, torch.float64)
    inputs = torch.randn(2, 11, 5, generator=generator, dtype=torch.float64)
    pull = torch.randn(2, 11, 3, generator=generator, dtype=torch.float64)
    leaves = [t.clone().requires_grad_() for pair in zip(network.weights, network.biases, strict=True) for t in pair]
    given = inputs.clone().requires_grad_()
    with torch.enable_grad():
        outputs = torch.stack([reference_forward(network, m, given[m], leaves) for m in range(2)])
        expected = torch.autograd.grad((outputs * pull).sum(), [*leaves, given])
    torch.testing.assert_close(network.forward(inputs), outputs.detach(), rtol=1e-12, atol=1e-12)
    network.backward(pull)
    torch.testing.assert_close(
        network.gradient, torch.cat([g.reshape(-1) for g in expected[:-1]]), rtol=1e-10, atol=1e-12
    )
    torch.testing.assert_close(network.input_gradient(pull), expected[-1], rtol=1e-10, atol=1e-12)


def test_adam_equals_torch() -> None:
    generator = torch.Generator().manual_seed(1)
    ours = torch.randn(40, generator=generator, dtype=torch.float64)
    theirs = torch.nn.Parameter(ours.clone())
    adam, peer = FlatAdam(ours, 0.01), torch.optim.Adam([theirs], lr=0.01)
    for _ in range(50):
        gradient = torch.randn(40, generator=generator, dtype=torch.float64)
        theirs.grad = gradient.clone()
        adam.step(gradient)
        peer.step()
    torch.testing.assert_close(ours, theirs.detach(), rtol=1e-10, atol=1e-12)
