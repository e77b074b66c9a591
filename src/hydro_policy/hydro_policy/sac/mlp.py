# SPDX-License-Identifier: Apache-2.0
"""Small multi-layer perceptrons, several evaluated at once, with explicit gradients.

At 2 x 32 units the arithmetic of one layer takes a few microseconds, as much as autograd needs to remember it. So a
`StackedMlp` evaluates all its members (the two critics, say) in one batched product, keeps what its backward pass needs
and leaves every gradient in one flat vector beside the flat vector of parameters. `test_mlp.py` compares with autograd.

    axes             [member, batch row, feature]
    layer            z_k = h_{k-1} W_k + b_k, h_k = relu(z_k); W_k [member, fan_in, fan_out], b_k [member, 1, fan_out]
    parameters       one vector: W_1 b_1 W_2 b_2 ... ; `weights[k]`, `biases[k]` are views into it
"""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor

from hydro_policy.sac import network_kernel


class StackedMlp:
    """`members` independent ReLU perceptrons of one shape, evaluated and differentiated together.

    Parameters
    ----------
    members
        Number of perceptrons.
    sizes
        Units from the input to the output, e.g. (15, 32, 32, 1). Hidden layers are ReLU, the output is linear.
    generator
        Source of the initial weights, uniform within +-1/sqrt(fan_in). None leaves zeros (weights come from elsewhere).
    dtype
        float32 in use; float64 for checks.
    """

    def __init__(
        self,
        members: int,
        sizes: tuple[int, ...],
        generator: torch.Generator | None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.members, self.sizes = members, sizes
        shapes = [shape for i, o in pairwise(sizes) for shape in ((members, i, o), (members, 1, o))]
        self.parameters = torch.zeros(sum(math.prod(shape) for shape in shapes), dtype=dtype)
        self.gradient = torch.zeros_like(self.parameters)
        self.weights, self.biases = _views(self.parameters, shapes)
        self._weight_gradients, self._bias_gradients = _views(self.gradient, shapes)
        self._activations: list[Tensor] = []
        if generator is not None:
            for weight, bias in zip(self.weights, self.biases, strict=True):
                bound = 1.0 / math.sqrt(weight.shape[1])
                for tensor in (weight, bias):
                    tensor.uniform_(-bound, bound, generator=generator)

    @property
    def gradients(self) -> tuple[list[Tensor], list[Tensor]]:
        """Views into `gradient` of the weights and of the biases."""
        return self._weight_gradients, self._bias_gradients

    def forward(self, inputs: Tensor) -> Tensor:
        """Evaluate inputs [members, batch, sizes[0]] -> [members, batch, sizes[-1]]; keeps what `backward` needs."""
        hidden, last = inputs, len(self.weights) - 1
        self._activations = [inputs]
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = torch.baddbmm(bias, hidden, weight)
            if layer < last:
                self._activations.append(hidden.relu_())
        return hidden

    def backward(self, output_gradient: Tensor) -> None:
        """Write d(loss)/d(parameters) of the last `forward` into `gradient`, given d(loss)/d(output)."""
        for layer in reversed(range(len(self.weights))):
            hidden = self._activations[layer]
            torch.bmm(hidden.transpose(1, 2), output_gradient, out=self._weight_gradients[layer])
            torch.sum(output_gradient, 1, keepdim=True, out=self._bias_gradients[layer])
            if layer:
                output_gradient = self._through(layer, output_gradient)

    def input_gradient(self, output_gradient: Tensor) -> Tensor:
        """Return d(loss)/d(inputs) of the last `forward`, [members, batch, sizes[0]]; `gradient` is unchanged."""
        for layer in reversed(range(1, len(self.weights))):
            output_gradient = self._through(layer, output_gradient)
        return torch.bmm(output_gradient, self.weights[0].transpose(1, 2))

    def _through(self, layer: int, output_gradient: Tensor) -> Tensor:
        """Backpropagate the gradient at a layer's z to the previous layer's z, through W and relu."""
        before = torch.bmm(output_gradient, self.weights[layer].transpose(1, 2))
        return torch.ops.aten.threshold_backward(before, self._activations[layer], 0)


class FlatAdam:
    """Adam on one flat vector: the update of torch.optim.Adam, compiled, for a whole network."""

    def __init__(self, parameters: Tensor, learning_rate: float) -> None:
        self.parameters, self.learning_rate = parameters, learning_rate
        self.first_moment, self.second_moment = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self.steps = 0

    def step(self, gradient: Tensor) -> None:
        """Make one descent step along `gradient`, with betas (0.9, 0.999) and epsilon 1e-8."""
        network_kernel.adam_step(self.views(gradient), 1)
        self.steps += 1

    def views(self, gradient: Tensor) -> network_kernel.Adam:
        """Return views of the same memory, which compiled code changes in place."""
        moments = self.first_moment.numpy(), self.second_moment.numpy()
        return network_kernel.Adam(self.parameters.numpy(), gradient.numpy(), *moments, self.learning_rate, self.steps)


def _views(flat: Tensor, shapes: list[tuple[int, int, int]]) -> tuple[list[Tensor], list[Tensor]]:
    """Return weights and biases as views into the flat vector."""
    pieces = flat.split([math.prod(shape) for shape in shapes])
    tensors = [piece.view(shape) for piece, shape in zip(pieces, shapes, strict=True)]
    return tensors[0::2], tensors[1::2]
