# SPDX-License-Identifier: Apache-2.0
"""What set-up runs so that no executable of this package compiles: each entry point once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydro_filter.controller.factory import CONSTANT, LEARNED, Choice, warm_up
from hydro_filter.metric.design import rest_loop
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.model.loop_model import loop_model
from hydro_filter.training import levels
from hydro_filter.training.data import DataSettings, collect
from hydro_filter.validation.cases import CASES
from hydro_filter.validation.plants import PLANTS
from hydro_filter.validation.runs import FILTERS, Task, outcome
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model.bench import Bench
from hydro_sim.structured.model import StructuredModel


def _filter(metric: str) -> None:
    choice = Choice(bench=Bench.nominal(), metric=metric)
    warm_up(choice.make(choice.default_settings()), choice.bench)


def _validation() -> None:
    for plant, chosen in [("emulator", name) for name in FILTERS] + [(PLANTS[-1], FILTERS[0])]:
        outcome(Task(plant=plant, case=next(iter(CASES)), filter=chosen, seed=0, seconds=0.1))


def _metric_learning() -> None:
    learned, bench = Learned.load(), Bench.nominal()
    assert isinstance(learned.model, StructuredModel)
    loop, plant = loop_model(learned.model, bench), LearnedPlant(learned)
    rollout, _ = next(collect(plant, bench, loop, DataSettings(rollouts=8, seconds=2.0, windows=1)))
    rest_loop(loop, 60.0)
    metric = LearnedMetric.load(None)
    metric.matrix(plant.reset(0), float(np.inf))
    levels.displacements(loop, plant, 60.0, 0)
    levels.integral_terms(loop, rollout.states[:2])


STEPS: dict[str, Callable[[], None]] = {
    "filter, learned metric": lambda: _filter(LEARNED),
    "filter, constant metric": lambda: _filter(CONSTANT),
    "validation": _validation,
    "metric learning": _metric_learning,
}
"""By what is said while one runs."""
