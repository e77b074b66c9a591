# SPDX-License-Identifier: Apache-2.0
"""The emulated bench as a plant of `envs.vector_env`: many truth plants in one compiled loop. Import registers it.

Benchmarks alone may do this: no package may import the truth (emulator.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import overload

from hydro_bridge.signals import SAMPLES_PER_STEP
from hydro_policy.envs import vector_env
from hydro_policy.envs.vector_env import VectorBench
from hydro_sim.emulator.truth import plant as truth
from hydro_sim.emulator.truth.config import TruthConfig, profile
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench


class Truth(NamedTuple):
    """Rows of `TruthPlant`."""

    parameters: npt.NDArray[np.void]
    differentiation: npt.NDArray[np.void]
    state: npt.NDArray[np.void]
    chain: npt.NDArray[np.void]
    x: npt.NDArray[np.float64]
    work: npt.NDArray[np.float64]
    felt: npt.NDArray[np.float64]
    """The load's own force [N], in front of its cell, of the last ten samples, shape (n, 10)."""
    count: npt.NDArray[np.int64]


@overload(vector_env.advance)
def _advance(plants, i, noise, current):
    if getattr(plants, "instance_class", None) is not Truth:
        return None

    def advance(plants, i, noise, current):
        one = slice(i, i + 1)
        truth.advance(
            plants.parameters[one], plants.differentiation[one], plants.state[one], plants.chain[one], plants.work,
            noise, current,
        )  # fmt: skip
        plants.x[i] = plants.chain[i].measurement
        plants.felt[i, plants.count[i] % SAMPLES_PER_STEP] = plants.state[i].load_force
        plants.count[i] += 1

    return advance


def _rows(plants: Sequence[TruthPlant]) -> Truth:
    records = [np.concatenate([getattr(plant, name) for plant in plants]) for name in Truth._fields[:4]]
    count = len(plants)
    felt = np.zeros((count, SAMPLES_PER_STEP)), np.zeros(count, np.int64)
    return Truth(*records, np.zeros((count, 8)), np.zeros((3, 8)), *felt)


def _copy(arrays: Truth, index: int, plant: TruthPlant) -> None:
    for name in Truth._fields[:4]:
        getattr(arrays, name)[index] = getattr(plant, name)[0]
    arrays.x[index] = plant.measurement()


vector_env.KINDS[TruthPlant] = (_rows, _copy)


def truth_fleet(count: int, config: TruthConfig | None = None) -> VectorBench:
    """So many emulated benches; the boxes believe in the nominal bench."""
    truth_config = config or profile("default")
    return VectorBench([Bench.nominal()] * count, [TruthPlant(truth_config) for _ in range(count)])
