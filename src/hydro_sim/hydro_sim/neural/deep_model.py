# SPDX-License-Identifier: Apache-2.0
"""A network of any depth as a model, alone or on top of the bench file's equations, and its file. See `deep`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.files.weights import Tensors
from hydro_sim.model.bench import Bench
from hydro_sim.model.sensors import Sensors
from hydro_sim.neural import deep, normalized
from hydro_sim.neural.engine import Engine
from hydro_sim.neural.network import INPUTS, STATES
from hydro_sim.neural.normalized import NormalizedModel


@dataclass(frozen=True, kw_only=True)
class DeepModel(NormalizedModel):
    """x' = f(x, u) by a network, plus the analytic model's where there is a bench."""

    bench: Bench | None = None
    """Bench of the analytic part, without its effects; None: a network alone."""

    @property
    def name(self) -> str:
        """Name of the structure."""
        return "deep" if self.bench is None else "residual"

    @classmethod
    def untrained(cls, training: list[Run], hidden: tuple[int, ...], seed: int, bench: Bench | None) -> DeepModel:
        """Return a model of random weights; with a bench the last layer is zero: the analytic model unchanged."""
        last = 1.0 if bench is None else 0.0
        flat = normalized.initial(np.random.default_rng(seed), (INPUTS, *hidden, STATES), last=last)
        return cls(flat=flat, hidden=hidden, bench=bench, **normalized.normalization(training))

    @property
    def parts(self) -> deep.Parts:
        """Return the arguments of the kernels, float32."""
        bench = self.bench or Bench.nominal()  # compiled code wants one either way
        record = Sensors().constants()[0]
        return deep.Parts(
            self.flat.astype(np.float32), np.array(self.sizes), self.step, self.bench is not None, bench.constants(),
            np.array([record["force_memory"], record["velocity_memory"]]), self.center, self.scale, self.current_scale,
        )  # fmt: skip

    def rolled(self, z: Any, v: Any) -> Any:
        """See `NormalizedModel.rolled`."""
        return deep.rollout(*self.parts, z, v)

    def gradient(self, engine: Engine, z: Any, v: Any, targets: Any, printed: bool) -> tuple[float, FloatArray]:
        """See `NormalizedModel.gradient`; on the CPU, whatever the engine, and of the squared loss alone."""
        if printed:
            raise ValueError("eq. loss as printed is for a network alone of two hidden layers")
        return deep.loss_and_gradient(*self.parts, z, v, targets, numba.get_num_threads())

    def header(self) -> dict[str, Any]:
        """Return the description of the tensors."""
        text = "z = (x - center) / scale, v = u / current_scale; x' = rate_scale * network([z, v]), SI"
        bench = {} if self.bench is None else {"bench": self.bench.to_mapping()}
        text += "" if self.bench is None else "; plus the bench's own gain in a sample (learned.analytic_step)"
        told = {"structure": self.name, "hidden": list(self.hidden), "activation": "relu", "normalization": text}
        return {**told, **bench}

    @classmethod
    def from_file(cls, tensors: Tensors, header: dict[str, Any]) -> DeepModel:
        """The model that `tensors` and `header` describe; KeyError or ValueError if they do not."""
        bench = Bench.from_mapping(header["bench"]) if header["structure"] == "residual" else None
        return cls(bench=bench, **normalized.read(tensors, header))
