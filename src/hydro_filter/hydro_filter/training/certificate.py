# SPDX-License-Identifier: Apache-2.0
"""Empirical certificate: eigenvalues of the contraction matrix on held-out windows.

Empirical means: on samples of rollouts of the learned model, not a proof over a set of states. Its significance:
safety.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from hydro_bridge.cli.console import Table
from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.metric.network import GAIN_UNIT
from hydro_filter.training import loss
from hydro_filter.training.loss import LossSettings, Samples
from hydro_filter.training.training import network_of

QUANTILES = (0.5, 0.99, 0.999, 1.0)
COLUMNS = {
    "metric": "still: equations of the still bench; solved: made to hold on samples; learned: with the network",
    "gains": "certified: under the force law's own K_p of the range; foreign: under the best correction",
    "samples": "held-out samples",
    "violated": "%, samples in which some direction does not decay at lambda",
    "q50": "1/s, quantiles of the contraction matrix's largest eigenvalue relative to M; 0 or less holds",
    "q99": "",
    "q999": "",
    "largest": "",
    "condition": "median condition number of M",
    "condition_max": "largest",
}


@torch.no_grad()
def certificate_table(
    metrics: dict[str, LearnedMetric], ask: Callable[[LearnedMetric], Samples], how: LossSettings
) -> Table:
    """A row for each metric and kind of gains, without the training's margin; `ask`: held-out samples of a metric."""
    table = Table(COLUMNS, title=f"Contraction at lambda = {how.rate:g} and {how.foreign_rate:g} 1/s, held out")
    for name, metric in metrics.items():
        samples = ask(metric)
        for outside in (False, True):
            chosen = (samples.kind > 0) & ((samples.inputs[:, -1] > 0.5) == outside)
            grown, condition = growth(metric, Samples(*(part[chosen] for part in samples)), how)
            q50, q99, q999, largest = (float(value) for value in np.quantile(grown, QUANTILES))
            table.add(
                metric=name, gains="foreign" if outside else "certified", samples=len(grown),
                violated=100.0 * float((grown > 0.0).mean()), q50=q50, q99=q99, q999=q999, largest=largest,
                condition=float(np.median(condition)), condition_max=float(condition.max()),
            )  # fmt: skip
    return table


@torch.no_grad()
def where_violated(metric: LearnedMetric, samples: Samples, how: LossSettings) -> str:
    """Gains of the certified range whose samples violate the metric, and how fast their loop decays; empty: none."""
    own = (samples.kind > 0) & (samples.inputs[:, -1] < 0.5)
    chosen = Samples(*(part[own] for part in samples))
    bad = growth(metric, chosen, how)[0] > 0.0
    if not bad.any():
        return ""
    gains = GAIN_UNIT * chosen.inputs[bad, -2].numpy()
    slowest = torch.linalg.eigvals(chosen.closed[bad]).abs().amax(dim=1)
    decay = float(-torch.log(slowest).median()) / SAMPLE_PERIOD
    return f"K_p {gains.min():.0f} to {gains.max():.0f} 1/s, where the loop itself decays at {decay:.2g} 1/s"


@torch.no_grad()
def growth(metric: LearnedMetric, samples: Samples, how: LossSettings) -> tuple[FloatArray, FloatArray]:
    """Largest eigenvalue [1/s] at lambda itself, and the condition number of M, both shape (b,)."""
    matrix, rate = loss.matrices(network_of(metric), samples, metric.floor)
    slack = samples.decay * (np.exp(2.0 * how.margin * SAMPLE_PERIOD) - 1.0) / SAMPLE_PERIOD
    values = loss.growth(matrix, rate, samples) - slack
    return values.numpy(), torch.linalg.cond(matrix).numpy()
