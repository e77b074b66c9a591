# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a model: the paper's Table rmse_model, errors over the horizon, by region, and a free run.

Every prediction starts from the model's own estimate of the state, which looks only back, and runs under the recorded
current. Errors are normalized per state either by the standard deviation of the recording or by its range (largest
minus smallest, of the noise-free log where there is one): the paper does not say which it used, so both are given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.identification.bench_states import SETTLED, Indices


class Predictor(Protocol):
    """A model under evaluation."""

    def estimate(self, run: Run) -> FloatArray:
        """States at the samples of a run."""

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8)."""


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one predictor on one recording, SI units."""

    rmse: FloatArray
    """Over all windows and samples of the horizon, shape (8,)."""
    by_time: FloatArray
    """Over all windows, shape (H, 8)."""
    by_window: FloatArray
    """Over each window's horizon, shape (n, 8)."""


def window_starts(run: Run, horizon: int, stride: int) -> Indices:
    """Start samples of a run's predictions, after the observer has settled."""
    return np.arange(SETTLED, len(run) - horizon - 1, stride)


def errors(predictor: Predictor, states: FloatArray, run: Run, truth: FloatArray, horizon: int, stride: int) -> Errors:
    """Errors of predictions from `states` at the starts of windows against `truth`, shape (n, 8)."""
    starts = window_starts(run, horizon, stride)
    squares_time, squares_window = np.zeros((horizon, 8)), []
    for part in np.array_split(starts, max(len(starts) * horizon // 500_000, 1)):
        rows = part[:, None] + np.arange(horizon)
        square = (predictor.predict(states[part], run.u[rows]) - truth[rows + 1]) ** 2
        squares_time += square.sum(axis=0)
        squares_window.append(square.mean(axis=1))
    by_time = np.sqrt(squares_time / len(starts))
    return Errors(
        rmse=np.sqrt(np.mean(by_time**2, axis=0)), by_time=by_time, by_window=np.sqrt(np.concatenate(squares_window))
    )


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scales of the errors, shape (8,) each."""

    std: FloatArray
    span: FloatArray

    @classmethod
    def of(cls, x: FloatArray) -> Scales:
        """Standard deviation and range of the columns of x, shape (n, 8)."""
        return cls(std=x.std(axis=0), span=np.ptp(x, axis=0))


@dataclass(frozen=True, kw_only=True)
class Scored:
    """One recorded run with its reference."""

    run: Run
    truth: FloatArray | None
    """The noise-free log at the run's samples, shape (n, 8), or None."""

    @property
    def reference(self) -> FloatArray:
        """The noise-free log, or the recording itself."""
        return self.run.x if self.truth is None else self.truth


def pooled(parts: list[Errors]) -> Errors:
    """Errors of several runs together, each window counting once."""
    counts = np.array([len(part.by_window) for part in parts], float)
    weights = counts / counts.sum()
    by_time = np.sqrt(sum(w * part.by_time**2 for w, part in zip(weights, parts, strict=True)))
    return Errors(
        rmse=np.sqrt(np.mean(by_time**2, axis=0)), by_time=by_time,
        by_window=np.concatenate([part.by_window for part in parts]),
    )  # fmt: skip


def prediction_errors(
    predictor: Predictor, states: list[FloatArray], scored: list[Scored], *, recorded: bool, horizon: int, stride: int
) -> Errors:
    """Pooled errors on several runs, against the recordings themselves or against the noise-free logs."""
    truths = [item.run.x if recorded else item.reference for item in scored]
    parts = [
        errors(predictor, start, item.run, truth, horizon, stride)
        for start, item, truth in zip(states, scored, truths, strict=True)
    ]
    return pooled(parts)


def noise_floor(scored: list[Scored]) -> FloatArray | None:
    """Noise floor, shape (8,): RMS of recording minus noise-free log; None without a log."""
    differences = [item.run.x - item.truth for item in scored if item.truth is not None]
    return np.sqrt(np.mean(np.concatenate(differences) ** 2, axis=0)) if len(differences) == len(scored) else None
