# SPDX-License-Identifier: Apache-2.0
"""One call of the contraction filter, and every tick's deadline.

The samples are runs on the analytic bench under changing gains, half of the time unstable ones, with the filter in the
loop. Then the filter takes `--ticks` samples, and calls beyond 1 ms are counted. Samples come round again and again:
each one's best call shows whether a slow one was the sample's doing.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks._report import parser
from hydro_bridge.ros.node import request_realtime
from hydro_core.cli.console import Table, command, progress
from hydro_core.signals import CorrectionStatus, FloatArray, ReferenceSignal, Waveform
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings
from hydro_filter.model.sample import Sample
from hydro_filter.validation.runs import Trial, run
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

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


def ticks(contraction_filter: LoopFilter, samples: list[Sample], count: int) -> tuple[FloatArray, int]:
    """Durations [s] of `count` calls, and how many corrected."""
    clock, corrected = np.empty(count), 0
    contraction_filter.reset()
    for burst in progress(range(0, count, BURST), total=-(-count // BURST), label="ticks", unit="burst"):
        for k in range(burst, min(burst + BURST, count)):
            sample = samples[k % len(samples)]
            begin = time.perf_counter()
            result = contraction_filter.correct(sample)
            clock[k] = time.perf_counter() - begin
            corrected += result.status is CorrectionStatus.MODIFIED
        time.sleep(0.01)
    return clock, corrected


@command()
def main() -> None:
    """Measure, print, write."""
    options = parser("filter_call", __doc__)
    options.add_argument("--samples", type=int, default=20_000, help="of the comparison, default 20000")
    options.add_argument("--ticks", type=int, default=100_000, help="of the deadline's count, default 100000")
    options.add_argument("--realtime", action="store_true", help="run by SCHED_FIFO, as the node does")
    asked = options.parse_args()
    bench = Bench.nominal()
    learned = FilterChoice(bench=bench).make(LoopFilterSettings())
    samples = runs(bench, learned, asked.samples)
    scheduling = request_realtime(realtime=asked.realtime)
    columns = {"filter": "", "p50": "us per call", "p99": "", "p99.9": "", "max": ""}
    table = Table(columns, title=f"Filter call, {len(samples)} samples, {scheduling}")
    table.add(filter="each sample once", **percentiles(ticks(learned, samples, len(samples))[0]))
    clock, corrected = ticks(learned, samples, asked.ticks)
    rounds = len(clock) // len(samples)
    best = clock[: rounds * len(samples)].reshape(rounds, -1).min(axis=0) if rounds else clock
    for name, each in {f"{asked.ticks} ticks": clock, f"each sample's best of {rounds}": best}.items():
        table.add(filter=name, **percentiles(each))
    table.show(asked.json)
    late = int((clock > DEADLINE).sum())
    print(f"{corrected / asked.ticks:.0%} of the ticks corrected; {late} took more than {1e3 * DEADLINE:g} ms")


if __name__ == "__main__":
    main()
