# SPDX-License-Identifier: Apache-2.0
"""The structured model as an object: constants, network, observer, and its file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.files.weights import Tensors
from hydro_sim.model.bench import Bench
from hydro_sim.model.sensors import Sensors
from hydro_sim.neural import mlp
from hydro_sim.structured import constants, observer, rollout
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.rollout import FULL, INPUTS, OUTPUTS

CHUNK = 3000
"""Samples that one thread filters once the observer has settled."""


@dataclass(frozen=True, kw_only=True)
class StructuredModel:
    """Physics with learned constants, plus a network. See `structured`."""

    bench: Bench
    """Start values of the constants."""
    theta: FloatArray
    """Shape (CONSTANTS,): the constants' variables, `constants.values`."""
    flat: FloatArray
    """The network's weights."""
    hidden: tuple[int, int]
    center: FloatArray
    """Shape (5,), of the network's inputs."""
    scale: FloatArray
    """Shape (5,)."""
    rest: FloatArray
    """Full state of the still bench, shape (12,)."""
    trust: float = 1.0
    """Scale of the model error per sample that the observer assumes, above 0."""
    left: FloatArray = field(default_factory=observer.READING_NOISE.copy)
    """Shape (5,): RMS error of each reading in 70-sample predictions, noise at least; weights them in training."""

    name = "structured"

    @property
    def table(self) -> tuple[constants.Constant, ...]:
        """Table of the constants."""
        return constants.constants(self.bench)

    @property
    def compiled(self) -> tuple[Any, ...]:
        """c, layers, center, scale and memories for the kernels."""
        record = Sensors().constants()[0]
        memories = np.array([record["force_memory"], record["velocity_memory"]])
        c, _ = constants.values(self.table, self.theta)
        return c, mlp.layers(self.flat, INPUTS, self.hidden, OUTPUTS), self.center, self.scale, memories

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8), from full states, shape (n, 12), under currents [A], shape (n, H)."""
        return np.asarray(rollout.rollout(*self.compiled, np.ascontiguousarray(starts), np.ascontiguousarray(currents)))

    def estimate(self, run: Run) -> FloatArray:
        """Full states at the samples of a run, shape (n, 12), each from the readings up to it."""
        count = len(run)
        chunks = range(-(-count // CHUNK))
        begins = np.array([max(i * CHUNK - observer.SETTLING, 0) for i in chunks])
        ends = np.array([min((i + 1) * CHUNK, count) for i in chunks])
        starts = first_guess(run, begins)
        states = np.empty((len(begins), CHUNK + observer.SETTLING, FULL))
        observer.follow_chunks(
            *self.compiled, run.readings, run.u, starts, *observer.constants(self.trust), begins, ends, states
        )
        pieces = [states[i, i * CHUNK - begins[i] : ends[i] - begins[i]] for i in chunks]
        return np.concatenate(pieces)

    def starts_of(self, x: FloatArray) -> FloatArray:
        """Full states that measurements x, shape (n, 8), suggest by themselves, shape (n, 12)."""
        full = np.zeros((len(x), FULL))
        full[:, :4], full[:, 6:8], full[:, STATES:] = x[:, 4:8], x[:, 2:4], x[:, (1, 3, 7)]
        return full

    def tensors(self) -> Tensors:
        """Return the saved tensors."""
        views = mlp.layers(self.flat, INPUTS, self.hidden, OUTPUTS)._asdict()
        others = {"theta": self.theta, "center": self.center, "scale": self.scale, "rest": self.rest}
        return {**views, **others, "trust": np.array([self.trust]), "left": self.left}

    def header(self) -> dict[str, Any]:
        """Return the description of the tensors."""
        c, _ = constants.values(self.table, self.theta)
        entries = [
            {"name": entry.name, "unit": entry.unit, "value": float(value), "learned": entry.learned}
            for entry, value in zip(self.table, c, strict=True)
        ]
        return {
            "structure": self.name, "hidden": list(self.hidden), "activation": "relu", "bench": self.bench.to_mapping(),
            "constants": entries, "normalization": "network inputs p_a, p_b, x_p, x_p', spool, centered and scaled",
        }  # fmt: skip

    @classmethod
    def from_file(cls, tensors: Tensors, header: dict[str, Any]) -> StructuredModel:
        """The model that `tensors` and `header` describe; KeyError or ValueError if they do not."""
        hidden = (int(header["hidden"][0]), int(header["hidden"][1]))
        flat = np.concatenate([np.asarray(tensors[name], np.float64).ravel() for name in mlp.Layers._fields])
        mlp.layers(flat, INPUTS, hidden, OUTPUTS)
        arrays = {name: np.asarray(tensors[name], np.float64) for name in ("theta", "center", "scale", "rest")}
        bench = Bench.from_mapping(header["bench"])
        left = np.asarray(tensors.get("left", observer.READING_NOISE), np.float64)  # absent in older files
        return cls(bench=bench, flat=flat, hidden=hidden, trust=float(tensors["trust"][0]), left=left, **arrays)

    def with_parameters(self, theta: FloatArray, flat: FloatArray) -> StructuredModel:
        """Return the same model with other parameters."""
        return replace(self, theta=theta.copy(), flat=flat.copy())


def first_guess(run: Run, samples: FloatArray | list[int] | Any) -> FloatArray:
    """Full states at samples of a run, shape (k, 12), from the measurement there and the current before it."""
    full = np.zeros((len(samples), FULL))
    x = run.x[samples]
    full[:, :4], full[:, 6:8], full[:, STATES:] = x[:, 4:8], x[:, 2:4], x[:, (1, 3, 7)]
    full[:, 4] = np.where(np.asarray(samples) > 0, run.u[np.maximum(np.asarray(samples) - 1, 0)], 0.0)
    return full
