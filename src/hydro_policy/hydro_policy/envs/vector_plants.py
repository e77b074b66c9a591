# SPDX-License-Identifier: Apache-2.0
"""Plants of one kind as rows of arrays for compiled loops: bench files, and kinds that a benchmark adds.

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
from hydro_sim.model import plant as plants_of
from hydro_sim.model.plant import AnalyticPlant, Plant

Records = npt.NDArray[np.void]


class Analytic(NamedTuple):
    """Rows of `AnalyticPlant`."""

    constants: Records
    sensors: Records
    state: Records


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
    if len({type(plant) for plant in plants}) != 1:
        raise ValueError("a fleet needs plants of one kind")
    for known, (make, copy) in KINDS.items():
        if type(plants[0]) is known:
            result = PlantRows(list(plants), make(plants), copy)
            for index, plant in enumerate(plants):
                copy(result.arrays, index, plant)
            return result
    kind = type(plants[0]).__name__
    raise ValueError(f"many benches at once are those of bench files, no {kind}")


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
    return None


@overload(measurement)
def _measurement(plants, i):
    if getattr(plants, "instance_class", None) is Analytic:
        return lambda plants, i: plants.state[i].x
    if isinstance(plants, types.NamedTuple):
        return lambda plants, i: plants.x[i]
    return None


def _analytic(plants: Sequence[AnalyticPlant]) -> Analytic:
    return Analytic(*(np.concatenate([getattr(plant, name) for plant in plants]) for name in Analytic._fields))


def _copy_analytic(arrays: Analytic, index: int, plant: AnalyticPlant) -> None:
    for name in Analytic._fields:
        getattr(arrays, name)[index] = getattr(plant, name)[0]


KINDS: dict[Any, tuple[Callable[[Any], Any], Callable[[Any, int, Any], None]]] = {
    AnalyticPlant: (_analytic, _copy_analytic),
}
"""Kinds of plants, with the functions that stack them and write one into a row. A benchmark may add its own."""
