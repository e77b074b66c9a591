# SPDX-License-Identifier: Apache-2.0
"""One call of the contraction filter, and every tick's deadline.

The samples are runs on the analytic bench under changing gains, half of the time unstable ones, with the filter in the
loop. Then the filter, with either solver, takes `--ticks` samples, and calls beyond 1 ms are counted. Samples come
round again and again: each one's best call shows whether a slow one was the sample's doing. "corrected" are the calls
with a correction, the only ones in which OSQP is asked.
"""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt

from benchmarks._report import parser
from hydro_bridge.ros.node import request_realtime
from hydro_core.cli.console import Table, command, progress
from hydro_core.settings import describe
from hydro_core.signals import CorrectionStatus, FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings
from hydro_filter.model.sample import Sample
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.filtered_run import Trial, run

DEADLINE = 1e-3
"""s: the next sample is there."""

BURST = 1000
"""Ticks after which the process rests: one that runs by SCHED_FIFO without pause is held up by the kernel."""


def runs(bench: Bench, contraction_filter: LoopFilter, count: int) -> list[Sample]:
    """`count` samples of a 200 N sine, the gains drawn again every half second: stable and unstable ones in turn."""
    samples: list[Sample] = []
    signal = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
    while len(samples) < count:
        seed = len(samples)
        rng = np.random.default_rng(seed)
        draws = min(20, -(-(count - len(samples)) // 500))
        low, high = np.where(np.arange(draws) % 2, -40.0, 15.0), np.where(np.arange(draws) % 2, 40.0, 90.0)
        pairs = np.column_stack([rng.uniform(low, high), rng.uniform(-5.0, 15.0, draws)])
        trial = Trial(bench=bench, reference=signal, gains=np.repeat(pairs, 50, axis=0), seed=seed)
        samples += [
            Sample.from_record(record) for record in run(trial, AnalyticPlant(bench), contraction_filter).states
        ]
    return samples[:count]


def percentiles(seconds: FloatArray) -> dict[str, float]:
    """Percentiles and maximum [us] of durations [s]."""
    values = {f"p{percent:g}": float(np.percentile(1e6 * seconds, percent)) for percent in (50.0, 99.0, 99.9)}
    return values | {"max": float(1e6 * seconds.max())}


def ticks(
    contraction_filter: LoopFilter, samples: list[Sample], count: int
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Durations [s] of `count` calls, and which of them corrected."""
    clock, corrected = np.empty(count), np.zeros(count, np.bool_)
    contraction_filter.reset()
    for burst in progress(range(0, count, BURST), total=-(-count // BURST), label="ticks", unit="burst"):
        for k in range(burst, min(burst + BURST, count)):
            sample = samples[k % len(samples)]
            begin = time.perf_counter()
            result = contraction_filter.correct(sample)
            clock[k] = time.perf_counter() - begin
            corrected[k] = result.status is CorrectionStatus.MODIFIED
        time.sleep(0.01)
    return clock, corrected


@command()
def main() -> None:
    """Measure, print, write."""
    options = parser("filter_call", __doc__)
    options.add_argument("--samples", type=int, default=20_000, help="of the runs, default 20000")
    options.add_argument("--ticks", type=int, default=100_000, help="of the deadline's count, default 100000")
    options.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, as the node does")
    asked = options.parse_args()
    choice = FilterChoice(bench=Bench.nominal())
    solvers = {
        name: choice.make(LoopFilterSettings(solver=name)) for name in describe(LoopFilterSettings)["solver"].choices
    }
    samples = runs(choice.bench, solvers["closed_form"], asked.samples)
    scheduling = request_realtime(realtime=asked.realtime)
    columns = {
        "solver": "",
        "calls": "",
        "p50": "us per call",
        "p99": "",
        "p99.9": "",
        "max": "",
        "late": "beyond 1 ms",
    }
    table = Table(columns, title=f"Filter call, {len(samples)} samples, {asked.ticks} ticks, {scheduling}")
    for name, each in solvers.items():
        clock, corrected = ticks(each, samples, asked.ticks)
        rounds = len(clock) // len(samples)
        found = {"all": clock, "corrected": clock[corrected]}
        if rounds:
            found[f"each sample's best of {rounds}"] = clock[: rounds * len(samples)].reshape(rounds, -1).min(axis=0)
        for calls, one in found.items():
            table.add(solver=name, calls=calls, **percentiles(one), late=int((one > DEADLINE).sum()))
    table.show(asked.json)
    print(f"{corrected.mean():.0%} of the ticks corrected")


if __name__ == "__main__":
    main()
