# SPDX-License-Identifier: Apache-2.0
"""Whether the kinds show before anything is diagnosed: the held-out gap of bench.yaml at both ends of each range.

It is the `gap` of the benchmark's table: two runs of 25 s, windows of 70 ms of the second simulated from its current,
the worst channel's error in noise floors. Nothing is searched for or fitted.

    python -m benchmarks.beyond_the_table.gap --half sealed
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.beyond_the_table.cases import Case
from benchmarks.beyond_the_table.kinds import HALVES, KINDS, NAMES
from benchmarks.beyond_the_table.plant import FloatArray
from benchmarks.beyond_the_table.recordings import simulated
from benchmarks.foreign_truth.recordings import RUNS, write_bag
from hydro_bridge.cli.console import Table, UserError, add_json_argument, command, progress
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.loading import load_dataset
from hydro_diagnosis.validation import HORIZON, WINDOWS, compare
from hydro_sim.model.bench import Bench

COLUMNS = {
    "kind": "clean: nothing is missing",
    "size": "",
    "gap": "root of the worst channel's held-out squared error, over its noise floor's",
    "channel": "the worst one",
    "fitted": "N, standard deviation of the loop's error in the run that would be fitted",
    "held": "the same in the held-out one",
}


@command()
def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.beyond_the_table.gap",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--half", choices=HALVES, default="sealed", help="of the kinds (default: sealed)")
    options.add_argument("--kinds", nargs="+", choices=NAMES, metavar="KIND", help="these alone, of either half")
    options.add_argument("--seed", type=int, default=5, metavar="S", help="of noise and references (default: 5)")
    add_json_argument(options)
    asked = options.parse_args()
    if asked.seed < 0:
        raise UserError("a --seed of at least 0 is meant")
    chosen = [kind for kind in KINDS if (kind.name in asked.kinds if asked.kinds else kind.half == asked.half)]
    cases = [Case("clean", None, seed=asked.seed)]
    cases += [Case(kind.name, kind, size, seed=asked.seed) for kind in chosen for size in kind.size]
    made = Table(COLUMNS)
    for case in progress(cases, label="gaps", unit="case"):
        logs = [simulated(case, number) for number in range(len(RUNS))]
        channel, gap = max(gaps(logs).items(), key=lambda item: item[1])
        errors = [float(np.std(log[500:, 10] - log[500:, 2])) for log in logs]
        made.add(kind=case.name, size=case.size, gap=gap, channel=channel, fitted=errors[0], held=errors[1])
    made.show(asked.json)


def gaps(logs: Sequence[FloatArray]) -> dict[str, float]:
    """Held-out error of bench.yaml by channel, noise floors, of two runs, shape (n, LOGGED) each."""
    bench = Bench.nominal()
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in RUNS]
        for path, log in zip(paths, logs, strict=True):
            write_bag(path, log)
        fitted, held, _ = load_dataset(paths[:1], paths[1:], bench)
    noise = Problem(fitted, bench).sensor_noise
    models = [SegmentModel(segment, bench) for segment in held]
    found = compare(models, (), (), noise, seconds=HORIZON, windows=WINDOWS, shooting=True).channels
    return {name: error.rmse_before / error.noise_floor for name, error in found.items()}


if __name__ == "__main__":
    main()
