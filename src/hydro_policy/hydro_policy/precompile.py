# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of this package is called once, on small real inputs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product

import numpy as np

from hydro_core.signals import SAMPLES_PER_STEP, ReferenceSignal
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.envs import FILTERS, FilterName
from hydro_policy.envs.vector_env import VectorBench, vector_filter
from hydro_policy.learner_process.learner import compile_updates
from hydro_policy.pretraining.configurations import CONFIGURATIONS, configuration
from hydro_policy.task.mdp import ACTION_SIZE
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant


def _learner() -> None:
    for name in CONFIGURATIONS:
        compile_updates(configuration(name).sac)


def _vector_bench(plant: Callable[[], Plant], filter_kind: FilterName) -> None:
    bench = Bench.nominal()
    vector_bench = VectorBench([bench], [plant()], filters=vector_filter(filter_kind, bench, 1))
    vector_bench.reset(0, ReferenceSignal(), 0)
    vector_bench.step(np.zeros((1, ACTION_SIZE)))


def _estimator() -> None:
    samples = np.zeros((1, SAMPLES_PER_STEP))
    Compensator().step(samples, samples, np.ones(1, bool), samples)


_PLANTS: dict[str, Callable[[], Plant]] = {"analytic": lambda: AnalyticPlant(Bench.nominal()), "learned": make_plant}

STEPS: dict[str, Callable[[], None]] = {
    "learner": _learner,
    "estimator": _estimator,
    **{
        f"{name} benches, filter {kind}": partial(_vector_bench, make, kind)
        for (name, make), kind in product(_PLANTS.items(), FILTERS)
    },
}
"""Compilation steps: functions that compile a part of the package, by the progress message."""
