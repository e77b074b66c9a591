# SPDX-License-Identifier: Apache-2.0
"""What the filter does to destabilizing gains, off-line: the table of filter_figures.md (there with `--seeds 20`).

18 s of a 200 N sine at 1 Hz, K_p in [-40, 40] and K_i in [-5, 5] at random (the paper's 'Validate Unstable'), drawn
anew every 10 ms or every 0.5 s, and constant gains. Bounded: the box never trips (force beyond 700 N, sensor range).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from hydro_bridge.cli.console import Table, add_json_argument, progress
from hydro_bridge.signals import FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller.filter import ContractionFilter, FilterSettings
from hydro_filter.validation.trial import Run, Trial, gammas, run
from hydro_sim.emulator.truth.config import profile
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant

STEPS = 1800
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
HOLDS = {"10 ms": 1, "0.5 s": 50}
FILTERS = {
    "none": FilterSettings(bypass=True),
    "lambda 0.1": FilterSettings(),
    "lambda 2": FilterSettings(contraction_rate=2.0),
}
CONSTANT = ((90.0, 15.0), (15.0, 5.0), (105.0, 15.0), (120.0, 15.0), (150.0, 15.0))
COLUMNS = {
    "plant": "",
    "gains": "",
    "filter": "lambda [1/s] of the certificate",
    "bounded": "runs in which the box never tripped",
    "rmse": "N, median of f_r - f_l until the end or the trip",
    "gamma_1": "%, mean |delta_u| over u_max",
    "gamma_2": "%, samples with M_c > 0 before the correction",
    "gamma_3": "1/s, mean M_c before",
    "gamma_4": "%, samples with M_c > 0 after",
    "gamma_5": "1/s, mean M_c after",
}


def plants() -> dict[str, Plant]:
    """From what the filter believes to what the emulator is."""
    nominal = Bench.nominal()
    return {
        "ideal load cell": AnalyticPlant(replace(nominal, load_cell_bandwidth=None)),
        "emulator": TruthPlant(profile("default")),
    }


def random_gains(seed: int, hold: int) -> FloatArray:
    """Shape (1800, 2), each draw held for `hold` policy steps."""
    rng, draws = np.random.default_rng(seed), STEPS // hold
    return np.repeat(np.column_stack([rng.uniform(-40, 40, draws), rng.uniform(-5, 5, draws)]), hold, axis=0)


def row(plant: str, gains: str, chosen: str, runs: Iterable[Run]) -> dict[str, object]:
    """One line of the table."""
    runs = list(runs)
    errors = [run.states["reference_force"] - run.states["load_force"] for run in runs]
    numbers = gammas([result for run in runs for result in run.results], Bench.nominal().valve_current_max)
    return {
        "plant": plant,
        "gains": gains,
        "filter": chosen,
        "bounded": f"{sum(run.bounded for run in runs)}/{len(runs)}",
        "rmse": float(np.median([np.sqrt(np.mean(error**2)) for error in errors])),
        "gamma_1": 100.0 * numbers.correction,
        "gamma_2": 100.0 * numbers.violated_before,
        "gamma_3": numbers.mean_before,
        "gamma_4": 100.0 * numbers.violated_after,
        "gamma_5": numbers.mean_after,
    }


def rows(seeds: int) -> Iterable[dict[str, object]]:
    """All lines, as they come."""
    bench = Bench.nominal()
    for name, plant in plants().items():
        for (label, hold), (chosen, settings) in ((h, f) for h in HOLDS.items() for f in FILTERS.items()):
            made = ContractionFilter.for_bench(bench, settings)
            trials = (
                Trial(bench=bench, reference=SINE, gains=random_gains(seed, hold), seed=seed) for seed in range(seeds)
            )
            yield row(name, f"random every {label}", chosen, (run(trial, plant, made) for trial in trials))
        for gains in CONSTANT:
            trial = Trial(bench=bench, reference=SINE, gains=np.tile(gains, (STEPS, 1)))
            made = ContractionFilter.for_bench(bench)
            yield row(name, f"K_p {gains[0]:g}, K_i {gains[1]:g}", "lambda 0.1", [run(trial, plant, made)])


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.filter_effect", description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="runs per line of random gains, default 2")
    add_json_argument(parser)
    asked = parser.parse_args(arguments)
    table = Table(COLUMNS, title="Random and constant gains under the filter, 18 s each")
    for values in progress(rows(asked.seeds), total=2 * (len(HOLDS) * len(FILTERS) + len(CONSTANT)), unit="line"):
        table.add(**values)
    table.show(asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
