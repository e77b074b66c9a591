# SPDX-License-Identifier: Apache-2.0
"""The one bench model: a sample, its exact Jacobian, and a prediction's gradient, beside the force law's equations.

`hydraulics` is the hand-written form of the equations without effects, compiled by numba, without derivatives. All run
in turns in one process; best of several.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from benchmarks._report import finish, parser
from benchmarks.analytic_plant import EFFECTS
from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.model import hydraulics, machine_code
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel

SAMPLES, WINDOW, ROUNDS = 5000, 70, 9
SETS: dict[str, tuple[Mapping[str, Any], ...]] = {"none": (), "six": EFFECTS["six effects"]}


@njit(cache=True)
def _hand_written(bench, y, currents):
    for current in currents:
        hydraulics.advance(bench, y, current, SAMPLE_PERIOD, hydraulics.SUBSTEPS)


def measured(bench: Bench, substeps: int) -> dict[str, Callable[[], float]]:
    """What is timed, us each: by sample forward, with its Jacobian, and of a window of 70 with its gradients."""
    model = BenchModel(bench, substeps=substeps)
    k, y, _ = model.begin(model.values)
    currents = 4e-3 * np.sin(2.0 * np.pi * 3.0 * SAMPLE_PERIOD * np.arange(SAMPLES))
    targets, weights = model.rollout(k, y.copy(), currents[:WINDOW]), np.ones(5)
    name = f"{len(bench.effects)} effects, {substeps} steps"
    return {
        f"{name}: sample": lambda: _us(lambda: model.rollout(k, y.copy(), currents)) / SAMPLES,
        f"{name}: sample with Jacobian": lambda: _us(lambda: model.jacobian(k, y.copy(), 1e-3)),
        f"{name}: sample of a gradient": lambda: (
            _us(lambda: model.window(k, y, currents[:WINDOW], targets, weights)) / WINDOW
        ),
    }


def compile_seconds(bench: Bench) -> dict[str, float]:
    """s to assemble, write and compile a model that is not kept, without and with derivatives."""
    taken, place = {}, machine_code.cache_folder
    with tempfile.TemporaryDirectory() as empty:
        machine_code.cache_folder = lambda: Path(empty)
        try:
            begin = time.perf_counter()
            model = BenchModel(bench, substeps=18)  # steps that nothing else has
            taken["simulation"] = time.perf_counter() - begin
            k, y, _ = model.begin(model.values)
            begin = time.perf_counter()
            model.jacobian(k, y, 0.0)
            taken["derivatives"] = time.perf_counter() - begin
        finally:
            machine_code.cache_folder = place
    return taken


def _us(work: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    work()
    return 1e6 * (time.perf_counter() - begin)


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    asked = parser("bench_model", __doc__).parse_args(arguments)
    bench, timed = Bench.nominal(), dict[str, Callable[[], float]]()
    record, currents = bench.constants()[0], np.full(SAMPLES, 1e-3)
    start = hydraulics.rest_state(record)
    _hand_written(record, start.copy(), currents)
    timed["hand-written, no effects: sample"] = lambda: (
        _us(lambda: _hand_written(record, start.copy(), currents)) / SAMPLES
    )
    for effects in SETS.values():
        for substeps in (20, 4):
            timed |= measured(replace(bench, effects=effects), substeps)
    best = dict.fromkeys(timed, float("inf"))
    for _ in range(ROUNDS):
        for name, work in timed.items():
            best[name] = min(best[name], work())
    results: dict[str, object] = {"us": best}
    for name, value in best.items():
        print(f"{name:<45} {value:8.2f} us")
    for name, effects in SETS.items():
        results[f"compile, {name}"] = taken = compile_seconds(replace(bench, effects=effects))
        print(f"compile, {name}: " + ", ".join(f"{part} {seconds:.1f} s" for part, seconds in taken.items()))
    finish(results, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
