# SPDX-License-Identifier: Apache-2.0
"""The paper's model as an object: two hidden layers from x and u to x', and its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.files.weights import Tensors
from hydro_sim.neural import mlp, network, normalized
from hydro_sim.neural.engine import Engine
from hydro_sim.neural.network import INPUTS, STATES
from hydro_sim.neural.normalized import NormalizedModel


@dataclass(frozen=True, kw_only=True)
class NetworkModel(NormalizedModel):
    """x' = f(x, u) by a network alone, two hidden layers. See `network`."""

    hidden: tuple[int, int]

    name = "network"

    @classmethod
    def untrained(cls, training: list[Run], hidden: tuple[int, int], seed: int) -> NetworkModel:
        """Return a model of random weights."""
        flat = normalized.initial(np.random.default_rng(seed), (INPUTS, *hidden, STATES))
        return cls(flat=flat, hidden=hidden, **normalized.normalization(training))

    @property
    def compiled(self) -> tuple[Any, ...]:
        """Layers and step for the kernels, float32."""
        flat = self.flat.astype(np.float32)
        return mlp.layers(flat, INPUTS, self.hidden, STATES), self.step

    def rolled(self, z: Any, v: Any) -> Any:
        """See `NormalizedModel.rolled`."""
        return network.rollout(*self.compiled, z, v)

    def gradient(self, engine: Engine, z: Any, v: Any, targets: Any, printed: bool) -> tuple[float, FloatArray]:
        """See `NormalizedModel.gradient`."""
        layers, step = self.compiled
        return engine.network(layers, step, z, v, targets, printed)

    def header(self) -> dict[str, Any]:
        """Return the description of the tensors."""
        text = "z = (x - center) / scale, v = u / current_scale; x' = rate_scale * network([z, v]), SI"
        return {"structure": self.name, "hidden": list(self.hidden), "activation": "relu", "normalization": text}

    @classmethod
    def from_file(cls, tensors: Tensors, header: dict[str, Any]) -> NetworkModel:
        """The model that `tensors` and `header` describe; KeyError or ValueError if they do not."""
        fields = normalized.read(tensors, header)
        if len(fields["hidden"]) != 2:
            raise ValueError(f"structure {cls.name} has two hidden layers, not {len(fields['hidden'])}")
        return cls(**fields)
