# SPDX-License-Identifier: Apache-2.0
"""ros2 run hydro_sim validate BAG...: errors of a bench file's 70-sample predictions on held-out recordings.

Every prediction starts from the Kalman filter's state, by past samples alone, and runs under the recorded current.
"""

from __future__ import annotations

from hydro_core.cli.console import Table, UserError, add_json_argument, command, make_parser
from hydro_core.signals import FloatArray
from hydro_sim.files import learned_bench, recordings
from hydro_sim.files.pairing import BoxIdentity
from hydro_sim.files.recordings import Run
from hydro_sim.identification.bench_learning import SUBSTEPS, best_prediction_rmse
from hydro_sim.identification.bench_states import SETTLING_SAMPLES, Sensitivities, estimate_noise
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.equations import READINGS
from hydro_sim.model.quality import Quality

COLUMNS = {
    "reading": "of a sensor; SI units",
    "rmse": "of the predictions against the recording, noise included",
    "noise": "RMS of the recording's noise, which a perfect model would leave",
    "ratio": "rmse / noise",
}


def prediction_errors(bench: Bench, runs: list[Run]) -> tuple[FloatArray, FloatArray]:
    """Return RMSE of 70-sample predictions and noise of the readings, SI units, shape (5,) each."""
    noise = estimate_noise(runs)
    model = BenchModel(bench, substeps=SUBSTEPS)
    return best_prediction_rmse(Sensitivities(model), model.values, noise, runs)[0], noise


@command(ValueError)
def main() -> None:
    """Entry point."""
    parser = make_parser("validate", "Judge a learned bench on held-out recordings.")
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recordings that it was not trained on")
    parser.add_argument("--model", metavar="FILE",
                        help="bench file of `learn` or `diagnose`; the shipped learned bench by default")  # fmt: skip
    parser.add_argument("--bench", metavar="FILE", help="bench.yaml of the recordings' box; the shipped one by default")
    add_json_argument(parser)
    options = parser.parse_args()
    learned_bench.require_match(
        options.model, BoxIdentity.of_file(options.bench), "name the bench.yaml of its box by --bench"
    )
    found = [run for name, states in recordings.load_states(options.bags).items()
             for run in recordings.split_runs(name, states)]  # fmt: skip
    runs = [run for run in found if len(run) > SETTLING_SAMPLES + 2 * recordings.MIN_SAMPLES]
    if not runs:
        raise UserError("no recording has five seconds without a gap to predict")
    left, noise = prediction_errors(learned_bench.read(options.model), runs)
    table = Table(COLUMNS, title="70-sample predictions")
    for name, rmse, least in zip(READINGS, left.tolist(), noise.tolist(), strict=True):
        table.add(reading=name, rmse=rmse, noise=least, ratio=rmse / least)
    table.show(options.json)
    print(f"{options.model or learned_bench.shipped_bench().name}: {Quality.of((left / noise).tolist()).sentence()}")
