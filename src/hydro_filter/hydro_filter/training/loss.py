# SPDX-License-Identifier: Apache-2.0
"""The loss of the metric (paper eq. loss_metric, q152, q153), in torch, for batches of samples.

::

    L = mean over samples and horizon of  W_l C_l + R_l
    C_l   stable      ReLU(largest eigenvalue of the contraction matrix relative to M)      every direction, not v alone
          unstable    ReLU(-M_c) along the v that the filter saw
    R_l   l_F |M|_F + l_tr tr M - l_logdet log det(M + eps I)                                1e-3 each, eps 1e-6

The contraction matrix is that of the sampled form: ((F + G K)' (M + T M') (F + G K) - exp(-2 lambda T) M) / T. For
gains of the certified range K is the force law's; for all others the law is not to be certified, and K is the
correction's: that there is one, from every state, which makes M decay at the foreign rate. So every sample asks
twice: of the metric for its own gain if that is in the range, and of the metric for foreign gains.

Eigenvalues are relative to M (of C^-1 ... C^-T with M = C C'): a small M does not pass for a good one. Both cases of
C_l count linearly up to about `knee` and by their logarithm beyond: in the few samples in which the spool passes
zero, the law divides by one side's g while the valve has the other's, and no metric helps there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import torch

from hydro_bridge.settings import quantity
from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.metric.network import ENTRIES, width_of


@dataclass(frozen=True, kw_only=True)
class LossSettings:
    """Weights and rates."""

    contraction_weight: Annotated[float, quantity("-", 0.0, 1e6)] = 100.0
    """W_l."""
    unstable_weight: Annotated[float, quantity("-", 0.0, 100.0)] = 0.02
    """Weight of unstable samples beside stable ones; at 1 the network gives up stable gains for them."""
    frobenius: Annotated[float, quantity("-", 0.0, 1.0)] = 1e-3
    """lambda_F."""
    trace: Annotated[float, quantity("-", 0.0, 1.0)] = 1e-3
    """lambda_tr."""
    log_det: Annotated[float, quantity("-", 0.0, 1.0)] = 1e-3
    """lambda_logdet."""
    knee: Annotated[float, quantity("1/s", 1e-3, 1e6)] = 10.0
    """Violation beyond which its logarithm counts."""
    epsilon: Annotated[float, quantity("-", 0.0, 1.0)] = 1e-6
    """In log det."""
    rate: Annotated[float, quantity("1/s", 0.0, 10.0)] = 0.1
    """lambda of the certified range."""
    foreign_rate: Annotated[float, quantity("1/s", 0.0, 15.0)] = 8.0
    """lambda of all other gains."""
    margin: Annotated[float, quantity("1/s", 0.0, 5.0)] = 0.15
    """On top of both in training: what a state between the samples, or a bench that is not quite the model, may
    take of the decay.
    """


class Samples(NamedTuple):
    """A batch of b samples; torch, float64. Shapes for eight coordinates; a bench file may add some."""

    inputs: torch.Tensor
    """Of the network, shape (b, 10)."""
    nudge: torch.Tensor
    """Along x', shape (b, 10)."""
    base: torch.Tensor
    """The table's factor, shape (b, 36)."""
    closed: torch.Tensor
    """F + G K, shape (b, 8, 8)."""
    decay: torch.Tensor
    """exp(-2 (lambda + margin) T), shape (b,)."""
    v: torch.Tensor
    """Shape (b, 8)."""
    kind: torch.Tensor
    """1: stable, -1: unstable, shape (b,)."""


class Network(torch.nn.Module):
    """`metric_network` in torch, with its derivative along a direction."""

    def __init__(self, inputs: int, hidden: tuple[int, int], entries: int = ENTRIES) -> None:
        super().__init__()
        sizes = ((inputs, hidden[0]), (hidden[0],), hidden, (hidden[1],), (hidden[1], entries), (entries,))
        self.weights = torch.nn.ParameterList(torch.zeros(size, dtype=torch.float64) for size in sizes)

    def forward(self, x: torch.Tensor, nudge: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Entries, shape (b, 36), and what the nudge does to them."""
        w1, b1, w2, b2, w3, b3 = self.weights
        before = x @ w1 + b1
        on = (before > 0.0).to(x.dtype)
        x, nudge = before * on, (nudge @ w1) * on
        before = x @ w2 + b2
        on = (before > 0.0).to(x.dtype)
        x, nudge = before * on, (nudge @ w2) * on
        return x @ w3 + b3, nudge @ w3


def matrices(network: Network, samples: Samples, floor: float) -> tuple[torch.Tensor, torch.Tensor]:
    """M and M', shape (b, 8, 8)."""
    entries, turned = network(samples.inputs, samples.nudge)
    lower, change = _lower(entries + samples.base), _lower(turned)
    product = change @ lower.transpose(1, 2)
    eye = torch.eye(lower.shape[-1], dtype=entries.dtype)
    return lower @ lower.transpose(1, 2) + floor * eye, product + product.transpose(1, 2)


def _lower(entries: torch.Tensor) -> torch.Tensor:
    width = width_of(entries.shape[1])
    lower = entries.new_zeros((len(entries), width, width))
    rows, columns = torch.tril_indices(width, width)
    lower[:, rows, columns] = entries
    return lower


def growth(metric: torch.Tensor, rate: torch.Tensor, samples: Samples) -> torch.Tensor:
    """Largest eigenvalue [1/s] of the contraction matrix relative to M, shape (b,); 0 or less: M decays."""
    factor = torch.linalg.cholesky(metric)
    later = samples.closed.transpose(1, 2) @ (metric + SAMPLE_PERIOD * rate) @ samples.closed
    half = torch.linalg.solve_triangular(factor, later, upper=False)
    whole = torch.linalg.solve_triangular(factor, half.transpose(1, 2), upper=False)
    return (torch.linalg.eigvalsh(0.5 * (whole + whole.transpose(1, 2)))[:, -1] - samples.decay) / SAMPLE_PERIOD


def along(metric: torch.Tensor, rate: torch.Tensor, samples: Samples) -> torch.Tensor:
    """M_c [1/s] along v, shape (b,)."""
    v = samples.v[:, :, None]
    moved = samples.closed @ v
    later = moved.transpose(1, 2) @ (metric + SAMPLE_PERIOD * rate) @ moved
    now = v.transpose(1, 2) @ metric @ v
    return (later[:, 0, 0] - samples.decay * now[:, 0, 0]) / SAMPLE_PERIOD


def _bent(violation: torch.Tensor, knee: float) -> torch.Tensor:
    """A violation, 0 or more, linear below the knee and logarithmic beyond."""
    return knee * torch.log1p(violation / knee)


def loss(network: Network, samples: Samples, floor: float, settings: LossSettings) -> torch.Tensor:
    """Eq. loss_metric, the mean over the batch."""
    metric, rate = matrices(network, samples, floor)
    contraction = _bent(torch.relu(growth(metric, rate, samples)), settings.knee)
    if settings.unstable_weight > 0.0:
        caught = settings.unstable_weight * _bent(torch.relu(-along(metric, rate, samples)), settings.knee)
        contraction = torch.where(samples.kind > 0, contraction, caught)
    eye = torch.eye(metric.shape[-1], dtype=metric.dtype)
    size = settings.frobenius * torch.linalg.matrix_norm(metric)
    size = size + settings.trace * metric.diagonal(dim1=1, dim2=2).sum(1)
    size = size - settings.log_det * torch.logdet(metric + settings.epsilon * eye)
    return (settings.contraction_weight * contraction + size).mean()
