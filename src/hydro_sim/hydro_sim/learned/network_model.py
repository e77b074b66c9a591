# SPDX-License-Identifier: Apache-2.0
"""The paper's model as an object: one network of x and u, normalization, and its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.hydraulics import SAMPLE
from hydro_sim.learned import mlp, network
from hydro_sim.learned.network import INPUTS, STATES
from hydro_sim.learned.recordings import Run
from hydro_sim.learned.weights import Tensors


@dataclass(frozen=True, kw_only=True)
class NetworkModel:
    """x' = f(x, u) by a network alone. See `network`; computes in float32."""

    flat: FloatArray
    """The network's weights; float64 here, float32 where it is computed."""
    hidden: tuple[int, int]
    center: FloatArray
    """Shape (8,), SI units: means of the training samples."""
    scale: FloatArray
    """Shape (8,): their standard deviations."""
    current_scale: float
    """A."""
    rate_scale: FloatArray
    """Shape (8,), SI units per second: what one unit of the network's outputs means."""
    rest: FloatArray
    """x of the still bench, shape (8,)."""

    name = "network"

    @classmethod
    def untrained(cls, training: list[Run], hidden: tuple[int, int], seed: int) -> NetworkModel:
        """Random weights. Rates are scaled by what 10 ms of motion show: one sample's difference is mostly noise."""
        x, u = np.concatenate([run.x for run in training]), np.concatenate([run.u for run in training])
        moved = np.concatenate([run.x[10:] - run.x[:-10] for run in training]).std(axis=0)
        generator = np.random.default_rng(seed)
        return cls(
            flat=mlp.initial(generator, INPUTS, hidden, STATES), hidden=hidden,
            center=x.mean(axis=0), scale=x.std(axis=0),
            current_scale=float(u.std()), rate_scale=moved / (10 * SAMPLE), rest=training[0].x[0].copy(),
        )  # fmt: skip

    @property
    def compiled(self) -> tuple[Any, ...]:
        """layers and step, float32: what the kernels take."""
        flat = self.flat.astype(np.float32)
        return mlp.layers(flat, INPUTS, self.hidden, STATES), self.step

    @property
    def step(self) -> Any:
        """What one sample adds to z per unit of the outputs, shape (8,), float32."""
        return (SAMPLE * self.rate_scale / self.scale).astype(np.float32)

    def normalized(self, x: FloatArray, u: FloatArray) -> tuple[Any, Any]:
        """z of x, shape (..., 8), and the scaled current of u [A], float32."""
        z = (x - self.center) / self.scale
        return np.ascontiguousarray(z, np.float32), np.ascontiguousarray(u / self.current_scale, np.float32)

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8), from x, shape (n, 8), under currents [A], shape (n, H)."""
        z, u = self.normalized(starts, currents)
        return np.asarray(network.rollout(*self.compiled, z, u) * self.scale + self.center, np.float64)

    def estimate(self, run: Run) -> FloatArray:
        """The measurement itself, shape (n, 8): this model's state is x."""
        return run.x

    def starts_of(self, x: FloatArray) -> FloatArray:
        """The measurement itself, shape (n, 8)."""
        return x

    def tensors(self) -> Tensors:
        """What is saved."""
        views = mlp.layers(self.flat, INPUTS, self.hidden, STATES)._asdict()
        arrays = {name: getattr(self, name) for name in ("center", "scale", "rate_scale", "rest")}
        return {**views, **arrays, "current_scale": np.array([self.current_scale])}

    def header(self) -> dict[str, Any]:
        """What the tensors are."""
        text = "z = (x - center) / scale, v = u / current_scale; x' = rate_scale * network([z, v]), SI"
        return {"structure": self.name, "hidden": list(self.hidden), "activation": "relu", "normalization": text}

    @classmethod
    def from_file(cls, tensors: Tensors, header: dict[str, Any]) -> NetworkModel:
        """The model that `tensors` and `header` describe; KeyError or ValueError if they do not."""
        hidden = (int(header["hidden"][0]), int(header["hidden"][1]))
        flat = np.concatenate([np.asarray(tensors[name], np.float64).ravel() for name in mlp.Layers._fields])
        mlp.layers(flat, INPUTS, hidden, STATES)
        arrays = {name: np.asarray(tensors[name], np.float64) for name in ("center", "scale", "rate_scale", "rest")}
        return cls(flat=flat, hidden=hidden, current_scale=float(tensors["current_scale"][0]), **arrays)

    def with_weights(self, flat: FloatArray) -> NetworkModel:
        """The same with other weights."""
        return replace(self, flat=np.asarray(flat, np.float64).copy())
