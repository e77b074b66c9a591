# SPDX-License-Identifier: Apache-2.0
"""Empirical certificate: eigenvalues of the contraction matrix on held-out windows.

::

    ((F + G K)' M (F + G K) - exp(-2 lambda T) M) / T        its largest eigenvalue relative to M; 0 or less: M decays

For gains of the certified range K is the force law's. For all others the law is not to be certified and K is that of
the best correction, so every sample asks twice: of the metric for its own gain if that is in the range, and of the
metric for all other gains. Eigenvalues are relative to M (of C^-1 ... C^-T with M = C C'), so that a small M does not
pass for a good one.

Empirical means: on samples of rollouts of the learned model, not a proof over a set of states. Its significance:
safety.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from hydro_bridge.cli.console import Table
from hydro_bridge.settings import quantity
from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.metric.scheduled import ScheduledMetric
from hydro_filter.training.data import STABLE, Windows

QUANTILES = (0.5, 0.99, 0.999, 1.0)
COLUMNS = {
    "metric": "still: equations of the still bench; solved: made to hold on samples",
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


@dataclass(frozen=True, kw_only=True)
class DecayRates:
    """Rates at which a metric is to decay."""

    rate: Annotated[float, quantity("1/s", 0.0, 10.0)] = 0.1
    """lambda of the certified range."""
    foreign_rate: Annotated[float, quantity("1/s", 0.0, 15.0)] = 8.0
    """lambda of all other gains."""
    margin: Annotated[float, quantity("1/s", 0.0, 5.0)] = 0.3
    """On top of both where metrics are solved: what a state between the samples, or a bench that is not quite the
    model, may take of the decay.
    """


class Correction(NamedTuple):
    """The best correction about the still bench."""

    feedback: FloatArray
    """K [A], of each coordinate."""
    driven: int
    """Coordinate whose entry of G follows g everywhere."""
    push: float
    """G's entry of it about the still bench."""


class Samples(NamedTuple):
    """b samples of closed loops, and the gain for whose metric they ask; shapes for eight coordinates."""

    gain: FloatArray
    """K_p [1/s], shape (b,); infinite: of the metric for all other gains."""
    closed: FloatArray
    """F + G K, shape (b, 8, 8)."""


def correcting_gains(windows: Windows, correction: Correction) -> FloatArray:
    """K [A] of the best correction at every sample, shape (n, H, 8): scaled as the force law scales its own by g."""
    return (correction.push / windows.push[..., correction.driven])[..., np.newaxis] * correction.feedback


def certified_samples(windows: Windows, metric: ScheduledMetric) -> Samples:
    """Samples of the stable windows with gains of the certified range, under the force law."""
    inside = (windows.gain >= metric.gains[0]) & (windows.gain <= metric.gains[-1])
    wanted = windows.part(inside & (windows.label == STABLE))
    return _samples(wanted, wanted.feedback, wanted.gain)


def foreign_samples(windows: Windows, correction: Correction) -> Samples:
    """All samples, under the best correction."""
    return _samples(windows, correcting_gains(windows, correction), np.full(len(windows), np.inf))


def _samples(windows: Windows, feedback: FloatArray, gain: FloatArray) -> Samples:
    closed = windows.transition + windows.push[..., np.newaxis] * feedback[..., np.newaxis, :]
    return Samples(np.repeat(gain, closed.shape[1]), closed.reshape(-1, *closed.shape[2:]))


def certificate_table(
    metrics: dict[str, ScheduledMetric], ask: Callable[[ScheduledMetric], tuple[Samples, Samples]], rates: DecayRates
) -> Table:
    """A row for each metric and kind of gains; `ask`: held-out samples of a metric, certified and foreign."""
    table = Table(COLUMNS, title=f"Contraction at lambda = {rates.rate:g} and {rates.foreign_rate:g} 1/s, held out")
    for name, metric in metrics.items():
        for kind, samples, rate in zip(
            ("certified", "foreign"), ask(metric), (rates.rate, rates.foreign_rate), strict=True
        ):
            grown, condition = growth(metric, samples, rate)
            q50, q99, q999, largest = (float(value) for value in np.quantile(grown, QUANTILES))
            table.add(
                metric=name, gains=kind, samples=len(grown),
                violated=100.0 * float((grown > 0.0).mean()), q50=q50, q99=q99, q999=q999, largest=largest,
                condition=float(np.median(condition)), condition_max=float(condition.max()),
            )  # fmt: skip
    return table


def where_violated(metric: ScheduledMetric, samples: Samples, rate: float) -> str:
    """Gains of certified samples that violate the metric, and how fast their loop decays; empty: none."""
    bad = growth(metric, samples, rate)[0] > 0.0
    if not bad.any():
        return ""
    gains, slowest = samples.gain[bad], np.abs(np.linalg.eigvals(samples.closed[bad])).max(axis=1)
    decay = float(-np.log(np.quantile(slowest, 0.5, method="lower"))) / SAMPLE_PERIOD
    return f"K_p {gains.min():.0f} to {gains.max():.0f} 1/s, where the loop itself decays at {decay:.2g} 1/s"


def growth(metric: ScheduledMetric, samples: Samples, rate: float) -> tuple[FloatArray, FloatArray]:
    """Largest eigenvalue [1/s] of the contraction matrix relative to M, and the condition number of M, shape (b,)."""
    gains, which = np.unique(samples.gain, return_inverse=True)
    matrices = np.array([metric.matrix(gain) for gain in gains])
    moved, matrix = samples.closed.transpose(0, 2, 1), matrices[which]
    factor = np.linalg.cholesky(matrix)
    half = np.linalg.solve(factor, moved @ matrix @ samples.closed)
    whole = np.linalg.solve(factor, half.transpose(0, 2, 1))
    largest = np.linalg.eigvalsh(0.5 * (whole + whole.transpose(0, 2, 1)))[:, -1]
    return (largest - np.exp(-2.0 * rate * SAMPLE_PERIOD)) / SAMPLE_PERIOD, np.linalg.cond(matrices)[which]
