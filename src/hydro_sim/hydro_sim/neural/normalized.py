# SPDX-License-Identifier: Apache-2.0
"""x' = f(x, u) by a network of normalized x and u: common part of such models."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.files.weights import Tensors
from hydro_sim.neural.engine import Engine
from hydro_sim.neural.network import INPUTS, STATES

M = TypeVar("M", bound="NormalizedModel")


def initial(generator: np.random.Generator, sizes: tuple[int, ...], *, last: float = 1.0) -> FloatArray:
    """Flat random weights, uniform within 1/sqrt(fan-in) as torch.nn.Linear has them, the last layer's times `last`."""
    parts = []
    for index, (n, m) in enumerate(pairwise(sizes)):
        bound = (last if index == len(sizes) - 2 else 1.0) / np.sqrt(n)
        parts += [generator.uniform(-bound, bound, n * m), generator.uniform(-bound, bound, m)]
    return np.concatenate(parts)


@dataclass(frozen=True, kw_only=True)
class NormalizedModel(ABC):
    """A network from x and u to x', with its normalization; computes in float32."""

    flat: FloatArray
    """The network's weights, layer by layer; float64 here, float32 where it is computed."""
    hidden: tuple[int, ...]
    """Widths of the hidden layers."""
    center: FloatArray
    """Shape (8,), SI units: means of the training samples."""
    scale: FloatArray
    """Shape (8,): their standard deviations."""
    current_scale: float
    """A."""
    rate_scale: FloatArray
    """Shape (8,), SI units per second: scale of the network's outputs."""
    rest: FloatArray
    """x of the still bench, shape (8,)."""

    @abstractmethod
    def rolled(self, z: Any, v: Any) -> Any:
        """Normalized states, shape (n, H, 8), from z, shape (n, 8), under scaled currents, shape (n, H); float32."""

    @abstractmethod
    def gradient(self, engine: Engine, z: Any, v: Any, targets: Any, printed: bool) -> tuple[float, FloatArray]:
        """Loss of windows against normalized targets, shape (n, H, 8), and its gradient by the weights."""

    @abstractmethod
    def header(self) -> dict[str, Any]:
        """Return the description of the tensors."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of all layers, inputs and outputs included."""
        return (INPUTS, *self.hidden, STATES)

    @property
    def step(self) -> Any:
        """Increment of z in a sample per unit of the outputs, shape (8,), float32."""
        return (SAMPLE_PERIOD * self.rate_scale / self.scale).astype(np.float32)

    def normalized(self, x: FloatArray, u: FloatArray) -> tuple[Any, Any]:
        """z of x, shape (..., 8), and the scaled current of u [A], float32."""
        z = (x - self.center) / self.scale
        return np.ascontiguousarray(z, np.float32), np.ascontiguousarray(u / self.current_scale, np.float32)

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8), from x, shape (n, 8), under currents [A], shape (n, H)."""
        return np.asarray(self.rolled(*self.normalized(starts, currents)) * self.scale + self.center, np.float64)

    def estimate(self, run: Run) -> FloatArray:
        """The measurement itself, shape (n, 8): this model's state is x."""
        return run.x

    def starts_of(self, x: FloatArray) -> FloatArray:
        """The measurement itself, shape (n, 8)."""
        return x

    def with_weights(self: M, flat: FloatArray) -> M:
        """Return the same model with other weights."""
        return replace(self, flat=np.asarray(flat, np.float64).copy())

    def tensors(self) -> dict[str, FloatArray]:
        """Return the saved tensors: the layers' weights w1, b1, w2 ... and the normalization."""
        arrays = {name: getattr(self, name) for name in ("center", "scale", "rate_scale", "rest")}
        begin = 0
        for index, (n, m) in enumerate(pairwise(self.sizes), 1):
            arrays[f"w{index}"] = self.flat[begin : begin + n * m].reshape(n, m)
            arrays[f"b{index}"] = self.flat[begin + n * m : begin + (n + 1) * m]
            begin += (n + 1) * m
        return {**arrays, "current_scale": np.array([self.current_scale])}


def normalization(training: list[Run]) -> dict[str, Any]:
    """Return fields of a model from training runs. Rates are scaled over 10 ms: the change in a sample is noise."""
    x, u = np.concatenate([run.x for run in training]), np.concatenate([run.u for run in training])
    moved = np.concatenate([run.x[10:] - run.x[:-10] for run in training]).std(axis=0)
    return {
        "center": x.mean(axis=0), "scale": x.std(axis=0), "current_scale": float(u.std()),
        "rate_scale": moved / (10 * SAMPLE_PERIOD), "rest": training[0].x[0].copy(),
    }  # fmt: skip


def read(tensors: Tensors, header: dict[str, Any]) -> dict[str, Any]:
    """Return fields of a model from a file; KeyError or ValueError if tensors and header do not fit."""
    hidden = tuple(int(width) for width in header["hidden"])
    sizes, parts = (INPUTS, *hidden, STATES), []
    for index, (n, m) in enumerate(pairwise(sizes), 1):
        for name, shape in ((f"w{index}", (n, m)), (f"b{index}", (m,))):
            if tensors[name].shape != shape:
                raise ValueError(f"{name} has shape {tensors[name].shape}, not {shape}")
            parts.append(np.asarray(tensors[name], np.float64).ravel())
    arrays = {name: np.asarray(tensors[name], np.float64) for name in ("center", "scale", "rate_scale", "rest")}
    current_scale = float(tensors["current_scale"][0])
    return {"flat": np.concatenate(parts), "hidden": hidden, "current_scale": current_scale, **arrays}
