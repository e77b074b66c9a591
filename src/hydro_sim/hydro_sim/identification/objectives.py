# SPDX-License-Identifier: Apache-2.0
"""Training objectives: errors of H-sample roll-outs against the recordings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_sim.files.recordings import READING_COLUMNS, Run
from hydro_sim.identification.engines import CompiledEngine
from hydro_sim.neural.deep_model import DeepModel
from hydro_sim.neural.engine import Engine
from hydro_sim.neural.network_model import NetworkModel
from hydro_sim.structured import rollout
from hydro_sim.structured.model import StructuredModel

SETTLED = 600
"""Samples at the beginning of a run without window starts: the observer is still settling."""

Indices = npt.NDArray[np.int64]


class Windows:
    """All windows of some runs: where they may start, and their samples.

    Parameters
    ----------
    runs
        Source of the windows.
    horizon
        H, samples predicted.
    stride
        Samples between the starts of an epoch's windows; the first start moves from epoch to epoch.
    """

    def __init__(self, runs: list[Run], horizon: int, stride: int) -> None:
        self.runs, self.horizon, self.stride = runs, horizon, stride
        self.x = np.concatenate([run.x for run in runs])
        self.u = np.concatenate([run.u for run in runs])
        self._lengths = [len(run) for run in runs]

    def starts(self, offset: int = 0) -> Indices:
        """Indices into `x` and `u`."""
        found, begin = [], 0
        for length in self._lengths:
            found.append(
                np.arange(begin + min(SETTLED, length // 4) + offset, begin + length - self.horizon, self.stride)
            )
            begin += length
        return np.concatenate(found)

    def currents(self, starts: Indices) -> FloatArray:
        """Shape (n, H)."""
        return self.u[starts[:, None] + np.arange(self.horizon)]

    def targets(self, starts: Indices) -> FloatArray:
        """x after each of the currents, shape (n, H, 8)."""
        return self.x[starts[:, None] + np.arange(1, self.horizon + 1)]

    def shuffled(self, epoch: int, seed: int) -> Indices:
        """An epoch's starts in random order."""
        generator = np.random.default_rng([seed, epoch])
        return generator.permutation(self.starts(int(generator.integers(self.stride))))


def batches_of(starts: Indices, size: int) -> list[Indices]:
    """Batches as equal as can be, none larger than `size`."""
    return np.array_split(starts, -(-len(starts) // size))


class NetworkObjective:
    """Training of a network's weights on normalized states."""

    def __init__(
        self,
        model: NetworkModel | DeepModel,
        training: Windows,
        validation: Windows,
        *,
        batch: int,
        seed: int,
        printed: bool = False,
    ) -> None:
        self.engine: Engine = CompiledEngine()
        self.model, self.batch, self.seed, self.printed = model, batch, seed, printed
        self.training, self.validation = training, validation
        self.z, self.v = model.normalized(training.x, training.u)

    def refresh(self, parameters: FloatArray) -> None:
        """Do nothing: windows start from the measurement."""

    def gradients(self, parameters: FloatArray, epoch: int) -> Iterator[tuple[float, FloatArray]]:
        """See `adam.Objective`."""
        steps = np.arange(self.training.horizon)
        for part in batches_of(self.training.shuffled(epoch, self.seed), self.batch):
            rows = part[:, None] + steps
            batch = self.z[part], self.v[rows], self.z[rows + 1]
            loss, gradient = self.model.with_weights(parameters).gradient(self.engine, *batch, self.printed)
            yield float(loss), gradient.astype(np.float64)

    def validate(self, parameters: FloatArray) -> float:
        """Root of the mean squared normalized error over states and horizon."""
        model, starts = self.model.with_weights(parameters), self.validation.starts()
        predicted = model.predict(self.validation.x[starts], self.validation.currents(starts))
        return float(np.sqrt(np.mean(((predicted - self.validation.targets(starts)) / model.scale) ** 2)))


class StructuredObjective:
    """Training of a structured model's network on the readings, each weighted by the error that the model leaves.

    The constants stay as they were identified: against a reading as fine as the encoder's, a gradient step that suits
    the network is far too long for them.
    """

    def __init__(
        self, model: StructuredModel, training: Windows, validation: Windows, *, batch: int, seed: int
    ) -> None:
        self.engine: Engine = CompiledEngine()
        self.model, self.batch, self.seed = model, batch, seed
        self.training, self.validation = training, validation
        self.weights = 1.0 / model.left
        self.states: FloatArray = np.empty((0, rollout.FULL))
        self.validation_states: FloatArray = self.states

    def at(self, parameters: FloatArray) -> StructuredModel:
        """Return the model with these weights."""
        return self.model.with_parameters(self.model.theta, parameters)

    def refresh(self, parameters: FloatArray) -> None:
        """Recompute start states by the observer, with these parameters."""
        model = self.at(parameters)
        self.states = np.concatenate([model.estimate(run) for run in self.training.runs])
        self.validation_states = np.concatenate([model.estimate(run) for run in self.validation.runs])

    def gradients(self, parameters: FloatArray, epoch: int) -> Iterator[tuple[float, FloatArray]]:
        """See `adam.Objective`."""
        for part in batches_of(self.training.shuffled(epoch, self.seed), self.batch):
            model = self.at(parameters)
            c, layers, center, scale, _ = model.compiled
            targets = np.ascontiguousarray(self.training.targets(part)[:, :, READING_COLUMNS])
            starts, currents = self.states[part, :9], self.training.currents(part)
            loss, _, by_flat = self.engine.structured(c, layers, center, scale, starts, currents, targets, self.weights)
            yield float(loss), by_flat

    def validate(self, parameters: FloatArray) -> float:
        """Root of the mean squared error of the readings over the horizon, each over its remaining error."""
        return float(np.sqrt(np.mean((self.errors(parameters) * self.weights) ** 2)))

    def errors(self, parameters: FloatArray) -> FloatArray:
        """RMS errors of each reading over the validation runs' horizons, shape (5,)."""
        model, starts = self.at(parameters), self.validation.starts()
        predicted = model.predict(self.validation_states[starts], self.validation.currents(starts))
        difference = (predicted - self.validation.targets(starts))[:, :, READING_COLUMNS]
        return np.asarray(np.sqrt(np.mean(difference**2, axis=(0, 1))))
