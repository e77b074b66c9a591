# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of this package is called once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hydro_filter.controller.factory import FilterChoice, warm_up
from hydro_filter.controller.loop_filter import LoopFilterSettings, loop_filter
from hydro_filter.metric import ScheduledMetric, rest_loop
from hydro_filter.model.loop import loop_of
from hydro_filter.training.data import DataSettings, displacements, integral_terms, roll_out, windows_of
from hydro_filter.validation.runs import CASES, FILTERS, PLANTS, Task, evaluate_task
from hydro_sim.files import learned_bench
from hydro_sim.model.bench import Bench

FOUND: tuple[dict[str, Any], ...] = (
    {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}},
    {"id": "friction_coulomb", "parameters": {"force": 12.0}},
    {"id": "leakage_internal", "parameters": {"coefficient": 1e-13}},
)
"""Effects that a diagnosis finds on most benches. Others are compiled at first use; new parameter values need none."""


def _shipped() -> None:
    choice = FilterChoice(bench=Bench.nominal())
    warm_up(choice.make(LoopFilterSettings()), choice.bench)


def _bench_file() -> None:
    """Compile the filter on a bench file: the general kernels, and the models with these effects and without any."""
    for effects in (FOUND, ()):
        made = loop_filter(ScheduledMetric.load(), _with(effects), Bench.nominal())
        warm_up(made, Bench.nominal())


def _with(effects: tuple[dict[str, Any], ...]) -> Bench:
    return replace(Bench.nominal(), effects=effects)


def _validation() -> None:
    for plant, chosen in [("emulator", name) for name in FILTERS] + [(PLANTS[-1], FILTERS[0])]:
        evaluate_task(Task(plant=plant, case=next(iter(CASES)), filter=chosen, seed=0, seconds=0.1))


def _metric_learning() -> None:
    bench, plant = Bench.nominal(), learned_bench.make_plant()
    loop = loop_of(learned_bench.load_model(), bench)
    settings = DataSettings(rollouts=8, seconds=2.0, windows=1)
    rollout = roll_out(plant, bench, settings, 0)
    windows_of(rollout, loop, settings, 0)
    rest_loop(loop, 60.0)
    metric = ScheduledMetric.load(None)
    metric.matrix(float(np.inf))
    displacements(loop, plant, 60.0, 0)
    integral_terms(loop, rollout.states[:2])


STEPS: dict[str, Callable[[], None]] = {
    "filter": _shipped,
    "filter, bench file": _bench_file,
    "validation": _validation,
    "metric learning": _metric_learning,
}
"""Functions by the message shown while each runs."""
