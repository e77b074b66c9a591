# SPDX-License-Identifier: Apache-2.0
"""Plants of one kind as rows of arrays for compiled loops: analytic and structured models.

A kind is a NamedTuple of arrays with two compiled functions, `advance` and `measurement`, dispatched on its type
(numba's overloading). Plants are created and reset as usual; this module only stacks their memories.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.core import types
from numba.extending import overload

from hydro_bridge.signals import FloatArray
from hydro_sim.learned import plant as learned_plants
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model import plant as plants_of
from hydro_sim.model.plant import AnalyticPlant, Plant
from hydro_sim.neural import mlp
from hydro_sim.structured import integration, rollout
from hydro_sim.structured.model import StructuredModel
from hydro_sim.structured.rollout import INPUTS, OUTPUTS

Records = npt.NDArray[np.void]


class Analytic(NamedTuple):
    """Rows of `AnalyticPlant`."""

    constants: Records
    sensors: Records
    state: Records


class Structured(NamedTuple):
    """Rows of `LearnedPlant` on a structured model; the network is the same for all."""

    c: FloatArray
    layers: mlp.Layers
    center: FloatArray
    scale: FloatArray
    memories: FloatArray
    sensors: Records
    full: FloatArray
    clean: FloatArray
    error: FloatArray
    last: Records
    x: FloatArray
    work: integration.Scratch
    scratch: tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass
class PlantRows:
    """Arrays for compiled code, and the plants that they represent (for resets and noise)."""

    plants: list[Plant]
    arrays: Any
    copy: Callable[[Any, int, Any], None]
    """Function that writes a plant's constants and memory into a row."""


def stack_plants(plants: Sequence[Plant]) -> PlantRows:
    """Stack plants of one kind into arrays.

    Raises
    ------
    ValueError
        The plants are of several kinds, or of a kind without compiled rows.
    """
    if len({_kind(plant) for plant in plants}) != 1:
        raise ValueError("a fleet needs plants of one kind")
    for known, (make, copy) in KINDS.items():
        if _kind(plants[0]) is known:
            result = PlantRows(list(plants), make(plants), copy)
            for index, plant in enumerate(plants):
                copy(result.arrays, index, plant)
            return result
    kind = _kind(plants[0]).__name__
    raise ValueError(f"many benches at once are structured models or analytic ones, no {kind}")


def replace_plant(rows: PlantRows, index: int, plant: Plant) -> None:
    """Replace the plant of a row."""
    rows.plants[index] = plant
    rows.copy(rows.arrays, index, plant)


def reset_plant(rows: PlantRows, index: int, seed: int) -> None:
    """Reset the plant of a row and seed its noise."""
    plant = rows.plants[index]
    plant.reset(seed)
    rows.copy(rows.arrays, index, plant)


def noise(rows: PlantRows, count: int) -> FloatArray:
    """Draw the next `count` rows of each plant's noise, shape (plants, count, 5)."""
    return np.stack([plant.noise.rows(count) for plant in rows.plants])  # type: ignore[attr-defined]


def measurements(rows: PlantRows) -> FloatArray:
    """Return the present measurements, a view of shape (plants, 8)."""
    held = rows.arrays.state["x"] if isinstance(rows.arrays, Analytic) else rows.arrays.x
    return np.asarray(held)


def advance(plants: Any, i: int, noise: FloatArray, current: float) -> None:
    """Advance row i by one sample of 1 ms, in place; for compiled code."""
    raise NotImplementedError("compiled code only")


def measurement(plants: Any, i: int) -> FloatArray:
    """Return the measurement x, shape (8,), of row i; for compiled code."""
    raise NotImplementedError("compiled code only")


@overload(advance)
def _advance(plants, i, noise, current):
    if getattr(plants, "instance_class", None) is Analytic:

        def analytic(plants, i, noise, current):
            one = slice(i, i + 1)
            plants_of.advance(plants.constants[one], plants.sensors[one], plants.state[one], noise, current)

        return analytic
    if getattr(plants, "instance_class", None) is Structured:

        def model(plants, i, noise, current):
            x, a1, a2, r = plants.scratch
            rollout.advance_full(
                plants.c[i], plants.layers, plants.center, plants.scale, plants.memories, plants.full[i], current,
                plants.work, x, a1, a2, r, plants.clean[i],
            )  # fmt: skip
            one = slice(i, i + 1)
            learned_plants.next_error(plants.sensors[one], noise, plants.clean[i], plants.last[one], plants.error[i])
            plants.x[i] = plants.clean[i] + plants.error[i]

        return model
    return None


@overload(measurement)
def _measurement(plants, i):
    if getattr(plants, "instance_class", None) is Analytic:
        return lambda plants, i: plants.state[i].x
    if isinstance(plants, types.NamedTuple):
        return lambda plants, i: plants.x[i]
    return None


def _kind(plant: Plant) -> Any:
    return type(plant.learned.model) if isinstance(plant, LearnedPlant) else type(plant)


def _analytic(plants: Sequence[AnalyticPlant]) -> Analytic:
    return Analytic(*(np.concatenate([getattr(plant, name) for plant in plants]) for name in Analytic._fields))


def _copy_analytic(arrays: Analytic, index: int, plant: AnalyticPlant) -> None:
    for name in Analytic._fields:
        getattr(arrays, name)[index] = getattr(plant, name)[0]


def _structured(plants: Sequence[LearnedPlant]) -> Structured:
    model, count = plants[0].learned.model, len(plants)
    assert isinstance(model, StructuredModel)
    c, layers, center, scale, memories = model.compiled
    h1, h2 = model.hidden
    return Structured(
        np.tile(c, (count, 1)), layers, center, scale, memories, np.concatenate([plant.sensors for plant in plants]),
        np.zeros((count, rollout.FULL)), np.zeros((count, 8)), np.zeros((count, 8)),
        np.concatenate([plant._last for plant in plants]), np.zeros((count, 8)), integration.scratch(),
        (np.empty(INPUTS), np.empty(h1), np.empty(h2), np.empty(OUTPUTS)),
    )  # fmt: skip


def _copy_structured(arrays: Structured, index: int, plant: LearnedPlant) -> None:
    assert isinstance(plant.learned.model, StructuredModel)
    arrays.c[index] = plant.learned.model.compiled[0]
    arrays.full[index] = plant.state
    _copy_readings(arrays, index, plant)


def _copy_readings(arrays: Structured, index: int, plant: LearnedPlant) -> None:
    arrays.sensors[index], arrays.last[index] = plant.sensors[0], plant._last[0]
    arrays.clean[index], arrays.error[index] = plant.clean, plant.error
    arrays.x[index] = plant.clean + plant.error


KINDS: dict[Any, tuple[Callable[[Any], Any], Callable[[Any, int, Any], None]]] = {
    AnalyticPlant: (_analytic, _copy_analytic),
    StructuredModel: (_structured, _copy_structured),
}
"""Kinds of plants, with the functions that stack them and write one into a row. A benchmark may add its own."""
