# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim validate BAG...: the paper's Table rmse_model for a learned bench and the analytic model.

Every prediction starts from the model's own estimate of the state, by past samples alone, and runs under the recorded
current. Errors are normalized per state either by the standard deviation of the recording or by its range (largest
minus smallest, of the noise-free log where there is one): the paper does not say which it used, so both are given.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from hydro_core.cli.console import Table as ConsoleTable
from hydro_core.cli.console import UserError, add_json_argument, command
from hydro_core.signals import PLANT_FIELDS, SAMPLE_PERIOD, FloatArray, to_matrix
from hydro_sim.files import learned_bench, recordings
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.files.recordings import READING_COLUMNS, Run
from hydro_sim.identification.bench_learning import SUBSTEPS, best_prediction_rmse
from hydro_sim.identification.bench_states import SETTLING_SAMPLES, Sensitivities, estimate_noise
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.effects.catalogue import label
from hydro_sim.model.quality import HORIZON_SAMPLES, Quality
from hydro_sim.model.sensors import Sensors


class Predictor(Protocol):
    """Interface of a prediction model under validation: state estimation, and multi-step prediction by currents."""

    def estimate(self, run: Run) -> FloatArray:
        """Return the states at the samples of a run."""

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """Return x, shape (n, H, 8), from initial states, shape (n, ...), under currents [A], shape (n, H)."""


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one predictor on one recording, SI units."""

    by_time: FloatArray
    """RMS of the errors over all windows, by sample of the horizon, shape (H, 8)."""
    windows: int

    @property
    def rmse(self) -> FloatArray:
        """RMSE over all windows and samples of the horizon, shape (8,)."""
        return np.asarray(np.sqrt(np.mean(self.by_time**2, axis=0)))


@dataclass(frozen=True, kw_only=True)
class ScoredRun:
    """Recorded run with the reference that predictions are compared with."""

    run: Run
    truth: FloatArray | None
    """The noise-free log at the run's samples, shape (n, 8), or None."""

    @property
    def reference(self) -> FloatArray:
        """Noise-free log, or the recording itself, shape (n, 8)."""
        return self.run.x if self.truth is None else self.truth


def prediction_errors(
    predictor: Predictor, states: list[FloatArray], scored: list[ScoredRun], *, recorded: bool, horizon: int,
    stride: int,
) -> Errors:  # fmt: skip
    """Return the errors of predictions from `states` at the starts of windows, over all windows of all runs.

    Against the recordings themselves if `recorded`, else against the noise-free logs.
    """
    squares, windows = np.zeros((horizon, 8)), 0
    for begins, item in zip(states, scored, strict=True):
        truth = item.run.x if recorded else item.reference
        starts = np.arange(SETTLING_SAMPLES, len(item.run) - horizon - 1, stride)
        windows += len(starts)
        for part in np.array_split(starts, max(len(starts) * horizon // 500_000, 1)):
            rows = part[:, None] + np.arange(horizon)
            squares += ((predictor.predict(begins[part], item.run.u[rows]) - truth[rows + 1]) ** 2).sum(axis=0)
    return Errors(by_time=np.sqrt(squares / windows), windows=windows)


RATE_COLUMNS, DIFFERENTIATED_COLUMNS = (1, 3, 7), (0, 2, 6)
"""Columns of x that the box computes, and those of the readings that it differentiates for them."""


class ModelPrediction:
    """Predictions of a bench model with coefficients `k`, with the box's rates of its readings.

    `states`: estimator of the model's states at the samples of a run.
    """

    def __init__(self, model: BenchModel, k: FloatArray, states: Callable[[Run], FloatArray]) -> None:
        self.model, self.k, self.states = model, k, states
        box = Sensors().constants()[0]
        self.memories = np.array([box["force_memory"], box["force_memory"], box["velocity_memory"]])
        """Coefficients of the rates' filters."""

    def estimate(self, run: Run) -> FloatArray:
        """Return initial values of predictions: model states, box rates, their readings; shape (n, states + 6)."""
        return np.concatenate([self.states(run), run.x[:, RATE_COLUMNS], run.x[:, DIFFERENTIATED_COLUMNS]], axis=1)

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """Return x, shape (n, H, 8), under currents [A], shape (n, H)."""
        x = np.empty((*currents.shape, 8))
        states, rates, last = np.split(starts, (len(self.model.states), -3), axis=1)
        for i, y in enumerate(states):
            x[i][:, READING_COLUMNS] = self.model.rollout(self.k, y.copy(), np.ascontiguousarray(currents[i]))
        for h in range(currents.shape[1]):
            now = x[:, h, DIFFERENTIATED_COLUMNS]
            rates = self.memories * rates + (1.0 - self.memories) * (now - last) / SAMPLE_PERIOD
            x[:, h, RATE_COLUMNS], last = rates, now
        return x


class AnalyticModel(ModelPrediction):
    """Analytic model without effects, except corrections of parameters; predictions start at the measurements."""

    def __init__(self, bench: Bench) -> None:
        model = BenchModel(bench.without_effects(), substeps=SUBSTEPS)
        measured = [PLANT_FIELDS.index(state.name) for state in model.states]
        super().__init__(model, model.begin(model.values)[0], lambda run: run.x[:, measured])


class BenchPrediction(ModelPrediction):
    """Predictions of a bench file from the Kalman filter's states.

    `runs`: for evaluation; the noise is estimated from them, and the filter's model error with the lowest RMSE chosen.
    """

    def __init__(self, bench: Bench, runs: list[Run]) -> None:
        model, noise = BenchModel(bench, substeps=SUBSTEPS), estimate_noise(runs)
        left, estimator = best_prediction_rmse(Sensitivities(model), model.values, noise, runs)
        super().__init__(model, estimator.k, estimator.states)
        self.quality = Quality.of((left / noise).tolist())


COLUMNS = {
    "state": "entry of x (eq. state_def)",
    "unit": "of rmse and noise",
    "learned": "normalized RMSE of the predictions, over the standard deviation of the state",
    "analytic": "the same of the analytic model, from the same start states",
    "learned_range": "over the range (largest minus smallest) instead",
    "analytic_range": "the same of the analytic model",
    "rmse": "RMSE of the learned model",
    "recorded": "RMSE against the recording, noise included",
    "noise": "RMS of the recording's noise: what a perfect model would leave; nan without a noise-free log",
    "ratio": "recorded / noise",
}


@command(ValueError)
def main() -> None:
    """Entry point."""
    options = _arguments()
    learned_bench.require_match(
        options.model, BoxIdentity.of_file(options.bench), "name the bench.yaml of its box by --bench"
    )
    model = learned_bench.read(options.model)
    scored = _scored(options.bags, options.noise_free)
    bench = Bench.load(options.bench) if options.bench else Bench.nominal()
    if names := ", ".join(map(label, bench.terms)):  # hidden states cannot start from a measurement
        print(f"of the bench file's effects the analytic model's predictions leave out {names}", file=sys.stderr)
    runs = [item.run for item in scored]
    learned, analytic = BenchPrediction(model, runs), AnalyticModel(bench)
    mine, theirs = (learned, [*map(learned.estimate, runs)]), (analytic, [*map(analytic.estimate, runs)])
    rmse_table(mine, theirs, scored).show(options.json)
    longest = min(5000, min(map(len, runs)) - SETTLING_SAMPLES - 2)  # that fits into every run
    how: dict[str, Any] = {"recorded": False, "horizon": longest, "stride": 500}
    after, other = prediction_errors(*mine, scored, **how), prediction_errors(*theirs, scored, **how)
    for horizon in (1, 10, 70, 200, 1000, longest):
        print(f"after {horizon / 1e3:g} s: f_l off by {after.by_time[horizon - 1, 2]:.3g} N "
              f"(analytic {other.by_time[horizon - 1, 2]:.3g} N)")  # fmt: skip
    begin = mine[1][0][SETTLING_SAMPLES : SETTLING_SAMPLES + 1]
    free = learned.predict(begin, runs[0].u[None, SETTLING_SAMPLES:-1])[0]
    deviation = free[:, 2] - scored[0].reference[SETTLING_SAMPLES + 1 :, 2]
    print(f"free run of {len(free) / 1e3:g} s: f_l off by {np.sqrt(np.mean(deviation**2)):.3g} N RMS, "
          f"{np.abs(deviation).max():.3g} N at most; "
          f"{'finite throughout' if np.isfinite(free).all() else 'NOT finite'}")  # fmt: skip
    print(f"{options.model or learned_bench.shipped_bench().name}: {learned.quality.sentence()}")


PredictorWithStates = tuple[Predictor, list[FloatArray]]
"""A model, and its states at the samples of each run."""


def rmse_table(learned: PredictorWithStates, analytic: PredictorWithStates, scored: list[ScoredRun]) -> ConsoleTable:
    """Return the paper's Table rmse_model, a row per state."""
    how: dict[str, Any] = {"horizon": HORIZON_SAMPLES, "stride": 37}
    clean = prediction_errors(*learned, scored, recorded=False, **how)
    noisy = prediction_errors(*learned, scored, recorded=True, **how)
    other = prediction_errors(*analytic, scored, recorded=False, **how)
    references = np.concatenate([item.reference for item in scored])
    std, span = references.std(axis=0), np.ptp(references, axis=0)
    differences = [item.run.x - item.truth for item in scored if item.truth is not None]
    logged = len(differences) == len(scored)
    noise = np.sqrt(np.mean(np.concatenate(differences) ** 2, axis=0)) if logged else np.full(8, np.nan)
    judged = "noise-free log" if logged else "recordings"
    table = ConsoleTable(
        COLUMNS, title=f"{HORIZON_SAMPLES}-sample predictions, {clean.windows} windows, against the {judged}"
    )
    units = ("N", "N/s", "N", "N/s", "Pa", "Pa", "m", "m/s")
    for i, name in enumerate(PLANT_FIELDS):
        table.add(
            state=name, unit=units[i], learned=float(clean.rmse[i] / std[i]),
            analytic=float(other.rmse[i] / std[i]), learned_range=float(clean.rmse[i] / span[i]),
            analytic_range=float(other.rmse[i] / span[i]), rmse=float(clean.rmse[i]),
            recorded=float(noisy.rmse[i]), noise=float(noise[i]), ratio=float(noisy.rmse[i] / noise[i]),
        )  # fmt: skip
    return table


def _scored(bags: list[str], logs: list[str] | None) -> list[ScoredRun]:
    if logs and len(logs) != len(bags):
        raise UserError(f"{len(logs)} noise-free logs for {len(bags)} recordings: give one for each")
    scored = []
    for index, (name, states) in enumerate(recordings.load_states(bags).items()):
        path, truth = logs[index] if logs else None, None
        try:
            if path is not None:  # x at the recording's sequence numbers
                log = np.load(path)["noise_free"]
                order = {int(sequence): row for row, sequence in enumerate(log["sequence"])}
                truth = to_matrix(log[[order[int(sequence)] for sequence in states["sequence"]]])
        except (OSError, KeyError, ValueError) as error:
            raise UserError(f"{path} is not the noise-free log of this recording: {error}") from error
        for run in recordings.split_runs(name, states):
            if len(run) > SETTLING_SAMPLES + 2 * recordings.MIN_SAMPLES:
                part = None if truth is None else truth[run.first : run.first + len(run)]
                scored.append(ScoredRun(run=run, truth=part))
    if not scored:
        raise UserError("no recording has five seconds without a gap to predict")
    return scored


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="validate", description="Judge a learned bench on held-out recordings.")
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings that it was not trained on")
    parser.add_argument("--model", metavar="FILE",
                        help="bench file of `learn` or `diagnose`; the shipped learned bench by default")  # fmt: skip
    parser.add_argument("--noise-free", nargs="+", metavar="NPZ",
                        help="the emulator's noise-free logs, for scoring only")  # fmt: skip
    parser.add_argument("--bench", metavar="FILE", help="bench.yaml of the analytic model; the shipped one by default")
    add_json_argument(parser)
    return parser.parse_args()
