# SPDX-License-Identifier: Apache-2.0
"""Refinement of solved metrics on samples: for each gain of the table, the P with the least growth over many states.

Lyapunov's equation makes P for one state. That it decays at all of some hundred states of the rollouts is a linear
matrix inequality in P; it is solved here by descent on P = L_0 (I + X) (I + X)' L_0' from the equation's solution L_0
L_0', X lower triangular, on the mean and the largest violation.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.metric.design import factor_entries
from hydro_filter.metric.scheduled import ScheduledMetric
from hydro_filter.model.coordinates import Q_LOAD
from hydro_filter.training.data import STABLE, Windows

SAMPLES = 120
STEPS = 250
STEP = 2e-2
LEFT_OUT = 0.02
"""Share of the samples with the largest growth that is not asked for: the spool passes zero there, and the law divides
by one side's g while the valve has the other's."""


def refined_rows(
    metric: ScheduledMetric, windows: Windows, foreign: FloatArray, rates: tuple[float, float], seed: int = 0
) -> Iterator[FloatArray]:
    """Refined rows of the table, shape (36,), for decay at `rates` (certified, other gains) [1/s].

    `foreign`: F + G K of the windows' samples under the best correction, shape (n, H, 8, 8).
    """
    rng = np.random.default_rng(seed)
    stable = windows.part(windows.label == STABLE)
    chosen = rng.choice(len(stable), min(SAMPLES, len(stable)), replace=False)
    for row, gain in zip(metric.table[:-1], metric.gains, strict=True):
        feedback = stable.feedback[chosen, 0].copy()
        feedback[:, Q_LOAD] *= gain / stable.gain[chosen]
        closed = stable.transition[chosen, 0] + stable.push[chosen, 0][:, :, None] * feedback[:, None, :]
        yield refine(row, closed, rates[0])
    chosen = rng.choice(len(windows), min(SAMPLES, len(windows)), replace=False)
    yield refine(metric.table[-1], foreign[chosen, 0], rates[1])


def refine(entries: FloatArray, closed: FloatArray, rate: float) -> FloatArray:
    """The factor's entries, shape (36,), after descent on samples F + G K, shape (n, 8, 8); scaled as they came."""
    width = closed.shape[-1]
    lower = np.zeros((width, width))
    lower[np.tril_indices(width)] = entries
    start, moved, eye = torch.from_numpy(lower), torch.from_numpy(closed), torch.eye(width, dtype=torch.float64)
    change = torch.zeros((width, width), dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.Adam([change], lr=STEP)
    limit, kept = float(np.exp(-2.0 * rate * SAMPLE_PERIOD)), len(closed) - int(LEFT_OUT * len(closed))
    best, found = np.inf, lower
    for step in range(STEPS):
        optimizer.param_groups[0]["lr"] = STEP * (1.0 - step / STEPS) + 1e-4
        factor = start @ (eye + torch.tril(change))
        half = torch.linalg.solve_triangular(factor.expand_as(moved), moved.transpose(1, 2) @ factor, upper=False)
        grown = (torch.linalg.eigvalsh(half @ half.transpose(1, 2))[:, -1] - limit) / SAMPLE_PERIOD
        worst = torch.sort(torch.relu(grown)).values[:kept]
        value = worst.mean() + 0.3 * worst[-1] + 1e-3 * (change**2).sum()
        if float(value.detach()) < best:
            best, found = float(value.detach()), factor.detach().numpy().copy()
        if best == 0.0:
            break
        optimizer.zero_grad()
        value.backward()
        optimizer.step()
    weight = found @ found.T
    return factor_entries(weight / weight[3, 3])
