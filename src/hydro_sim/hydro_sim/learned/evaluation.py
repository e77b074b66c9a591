# SPDX-License-Identifier: Apache-2.0
"""How well a model predicts: the paper's Table rmse_model, errors over the horizon, by region, and a free run.

Every prediction starts from the model's own estimate of the state, which looks only back, and runs under the recorded current.
Errors are normalized per state either by the standard deviation of the recording or by its range (largest minus smallest,
of the noise-free log where there is one): the paper does not say which it used, so both are given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.bench import Bench
from hydro_sim.learned import constants as learned_constants
from hydro_sim.learned.objectives import SETTLED, Indices
from hydro_sim.learned.recordings import Run
from hydro_sim.learned.structured_model import StructuredModel


class Predictor(Protocol):
    """What is judged."""

    def estimate(self, run: Run) -> FloatArray:
        """States at the samples of a run."""

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8)."""


def analytic(bench: Bench) -> StructuredModel:
    """The analytic model (paper eq. q13-q15) as `hydro_sim.hydraulics` has it, in the shape that this module judges.

    No dry friction, no leakage; a spool that follows within a tenth of a millisecond; the load cell's amplifier as in the bench
    file, or one far above all else.
    """
    table = learned_constants.constants(bench)
    wanted = {
        "spool_frequency": 2.0 * np.pi * 1600.0, "spool_damping": 1.0, "friction_coulomb": 1e-9, "friction_stribeck": 1e-9,
        "bristle_stiffness": 1e-3, "bristle_damping": 1e-9, "viscous_friction": bench.viscous_friction,
        "load_cell_frequency": 2.0 * np.pi * (bench.load_cell_bandwidth or 500.0),
    }  # fmt: skip
    theta = np.array([np.log(max(wanted[entry.name], 1e-9) / entry.start) if entry.name in wanted else 0.0 for entry in table])
    flat = np.zeros(5 * 1 + 1 + 1 + 1 + 3 + 3)
    rest = np.zeros(12)
    return StructuredModel(
        bench=bench, theta=theta, flat=flat, hidden=(1, 1), center=np.zeros(5), scale=np.ones(5), rest=rest
    )


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Of one predictor on one recording, SI units."""

    rmse: FloatArray
    """Over all windows and samples of the horizon, shape (8,)."""
    by_time: FloatArray
    """Over all windows, shape (H, 8)."""
    by_window: FloatArray
    """Over each window's horizon, shape (n, 8)."""


def window_starts(run: Run, horizon: int, stride: int) -> Indices:
    """Where predictions of a run begin; the observer has settled by then."""
    return np.arange(SETTLED, len(run) - horizon - 1, stride)


def errors(
    predictor: Predictor, states: FloatArray, run: Run, truth: FloatArray, horizon: int, stride: int
) -> Errors:
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
    """What errors are divided by, shape (8,) each."""

    std: FloatArray
    span: FloatArray

    @classmethod
    def of(cls, x: FloatArray) -> Scales:
        """Standard deviation and range of the columns of x, shape (n, 8)."""
        return cls(std=x.std(axis=0), span=np.ptp(x, axis=0))

