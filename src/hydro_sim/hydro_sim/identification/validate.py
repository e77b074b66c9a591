# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim validate BAG...: the paper's Table rmse_model for a learned bench, beside the analytic one."""

from __future__ import annotations

import argparse
import sys
from typing import Any

import numpy as np

from hydro_bridge.cli.console import Table as ConsoleTable
from hydro_bridge.cli.console import UserError, add_json_argument, command
from hydro_bridge.signals import PLANT_FIELDS, FloatArray, StateArray, matrix
from hydro_sim.files import learned_bench, recordings
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.identification import evaluation
from hydro_sim.identification.bench_states import SETTLED
from hydro_sim.identification.evaluation import (
    AnalyticModel,
    BenchPrediction,
    Predictor,
    Scales,
    Scored,
    omitted_terms,
)
from hydro_sim.model.bench import Bench
from hydro_sim.model.quality import HORIZON

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
SI_UNITS = ("N", "N/s", "N", "N/s", "Pa", "Pa", "m", "m/s")
LONGEST = 5000  # samples of the longest horizon
STRIDE = 37  # samples between the starts of predictions


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
    if omitted_terms(bench):
        print(omitted_terms(bench), file=sys.stderr)
    runs = [item.run for item in scored]
    learned = BenchPrediction(model, runs)
    states = [learned.estimate(item.run) for item in scored]
    analytic = AnalyticModel(bench)
    analytic_states = [analytic.estimate(item.run) for item in scored]
    table = table_of(learned, states, analytic, analytic_states, scored)
    table.show(options.json)
    _long(learned, states, analytic, analytic_states, scored)
    print(f"{options.model or learned_bench.shipped().name}: {learned.quality.told()}")


def table_of(
    learned: Predictor, states: list[FloatArray], analytic: AnalyticModel, analytic_states: list[FloatArray],
    scored: list[Scored],
) -> ConsoleTable:  # fmt: skip
    """Table rmse_model, a row per state."""
    how: dict[str, Any] = {"horizon": HORIZON, "stride": STRIDE}
    clean = evaluation.prediction_errors(learned, states, scored, recorded=False, **how)
    noisy = evaluation.prediction_errors(learned, states, scored, recorded=True, **how)
    other = evaluation.prediction_errors(analytic, analytic_states, scored, recorded=False, **how)
    scales = Scales.of(np.concatenate([item.reference for item in scored]))
    floor = evaluation.noise_floor(scored)
    noise = np.full(8, np.nan) if floor is None else floor
    judged = "recordings" if floor is None else "noise-free log"
    table = ConsoleTable(
        COLUMNS, title=f"{HORIZON}-sample predictions, {len(clean.by_window)} windows, against the {judged}"
    )
    for i, name in enumerate(PLANT_FIELDS):
        table.add(
            state=name, unit=SI_UNITS[i], learned=float(clean.rmse[i] / scales.std[i]),
            analytic=float(other.rmse[i] / scales.std[i]), learned_range=float(clean.rmse[i] / scales.span[i]),
            analytic_range=float(other.rmse[i] / scales.span[i]), rmse=float(clean.rmse[i]),
            recorded=float(noisy.rmse[i]), noise=float(noise[i]), ratio=float(noisy.rmse[i] / noise[i]),
        )  # fmt: skip
    return table


def _long(
    learned: Predictor, states: list[FloatArray], analytic: AnalyticModel, analytic_states: list[FloatArray],
    scored: list[Scored],
) -> None:  # fmt: skip
    """Errors by the time predicted, and those of one free run."""
    longest = min(LONGEST, _longest(scored))
    how: dict[str, Any] = {"recorded": False, "horizon": longest, "stride": 500}
    mine = evaluation.prediction_errors(learned, states, scored, **how)
    theirs = evaluation.prediction_errors(analytic, analytic_states, scored, **how)
    for horizon in (1, 10, 70, 200, 1000, longest):
        print(f"after {horizon / 1e3:g} s: f_l off by {mine.by_time[horizon - 1, 2]:.3g} N "
              f"(analytic {theirs.by_time[horizon - 1, 2]:.3g} N)")  # fmt: skip
    item, start = scored[0], states[0]
    free = learned.predict(start[SETTLED : SETTLED + 1], item.run.u[None, SETTLED:-1])[0]
    deviation = free[:, 2] - item.reference[SETTLED + 1 :, 2]
    print(f"free run of {len(free) / 1e3:g} s: f_l off by {np.sqrt(np.mean(deviation**2)):.3g} N RMS, "
          f"{np.abs(deviation).max():.3g} N at most; "
          f"{'finite throughout' if np.isfinite(free).all() else 'NOT finite'}")  # fmt: skip


def _longest(scored: list[Scored]) -> int:
    """Samples of the longest prediction that fits into every run."""
    return min(len(item.run) for item in scored) - SETTLED - 2


def _scored(bags: list[str], logs: list[str] | None) -> list[Scored]:
    if logs and len(logs) != len(bags):
        raise UserError(f"{len(logs)} noise-free logs for {len(bags)} recordings: give one for each, in their order")
    scored = []
    for index, (name, states) in enumerate(recordings.load(bags).items()):
        truth = _aligned(logs[index], states) if logs else None
        for run in recordings.runs(name, states):
            part = None if truth is None else truth[run.first : run.first + len(run)]
            if len(run) > SETTLED + 2 * recordings.SHORTEST:
                scored.append(Scored(run=run, truth=part))
    if not scored:
        raise UserError("no recording has five seconds without a gap to predict")
    return scored


def _aligned(path: str, states: StateArray) -> FloatArray:
    """The noise-free log's x at the recording's sequence numbers, shape (n, 8)."""
    try:
        log = np.load(path)["noise_free"]
        order = {int(sequence): index for index, sequence in enumerate(log["sequence"])}
        return matrix(log[[order[int(sequence)] for sequence in states["sequence"]]])
    except (OSError, KeyError, ValueError) as error:
        raise UserError(f"{path} is not the noise-free log of this recording: {error}") from error


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="validate", description="Judge a learned bench on held-out recordings.")
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings that it was not trained on")
    parser.add_argument(
        "--model", metavar="FILE", help="bench file of `learn` or `diagnose`; the shipped learned bench by default"
    )
    parser.add_argument(
        "--noise-free", nargs="+", metavar="NPZ", help="the emulator's noise-free logs, for scoring only"
    )
    parser.add_argument("--bench", metavar="FILE", help="bench.yaml of the analytic model; the shipped one by default")
    add_json_argument(parser)
    return parser.parse_args()
