# SPDX-License-Identifier: Apache-2.0
"""Training of a model, stage by stage: from runs to a `Learned`.

=========== =====================================================================================
network     Adam through time on all windows (the paper's way); two hidden layers, or any number of them
residual    the same, on top of the bench file's equations: the network starts at zero and learns what they lack
structured  constants identified on many short windows (`stages`), then Adam on the network
            alone, start states by the observer; readings weighed by what the model leaves of them
=========== =====================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hydro_sim.files.recordings import Data
from hydro_sim.identification import adam, engines
from hydro_sim.identification.objectives import NetworkObjective, StructuredObjective, Windows
from hydro_sim.learned.model import Learned, Model
from hydro_sim.learned.region import Region
from hydro_sim.model.bench import Bench
from hydro_sim.neural.deep_model import DeepModel
from hydro_sim.neural.engine import Engine
from hydro_sim.neural.network_model import NetworkModel
from hydro_sim.structured.model import StructuredModel


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a training; the defaults of `network` are Table training."""

    structure: str = "structured"
    """One of `CHOICES`."""
    hidden: tuple[int, ...] = (32, 32)
    """Widths of the hidden layers, [1, 1024]; two of them for `structured`."""
    horizon: int = 70
    """H, samples rolled out, [1, 1000]; 1 is one-step training."""
    batch: int = 8192
    """Windows per gradient, [1, 1000000]."""
    stride: int = 35
    """Samples between the starts of one epoch's windows, [1, 10000]; they shift from epoch to epoch."""
    seed: int = 0
    """Of first weights and shuffles."""
    printed_loss: bool = False
    """Whether `network` minimizes eq. loss as printed, where errors of opposite sign cancel."""
    identify_windows: int = 500
    """Windows that the constants are identified on, [10, 100000]."""
    device: str = "auto"
    """What computes gradients: `cpu`, `cuda`, or `auto`, the quicker of both on one batch. The rest is the CPU's."""
    adam: adam.Settings = field(default_factory=adam.Settings)
    """Of the loop."""


STRUCTURED_ADAM = adam.Settings(epochs=60, learning_rate=3e-4, patience=30, refresh_every=20)
"""Settings where the constants are identified already: little is left for the network, and it trains fast."""


CHOICES = ("structured", "residual", "network")
"""Structures that can be trained."""


def start(data: Data, settings: Settings, bench: Bench) -> Model:
    """The untrained model; ValueError if the structure cannot have these layers."""
    hidden, seed = settings.hidden, settings.seed
    if settings.structure == "residual":
        return DeepModel.untrained(data.training, hidden, seed, bench)
    if settings.structure == "network" and len(hidden) != 2:
        return DeepModel.untrained(data.training, hidden, seed, None)
    if len(hidden) != 2:
        raise ValueError(f"structure {settings.structure} has two hidden layers, not {len(hidden)}")
    if settings.structure == "network":
        return NetworkModel.untrained(data.training, (hidden[0], hidden[1]), seed)
    return StructuredModel.untrained(bench, data.training, (hidden[0], hidden[1]), seed)


def objective(model: Model, data: Data, settings: Settings) -> NetworkObjective | StructuredObjective:
    """Create the training objective."""
    training = Windows(data.training, settings.horizon, settings.stride)
    validation = Windows(data.validation, 70, 35)
    target: NetworkObjective | StructuredObjective
    if not isinstance(model, StructuredModel):
        target = NetworkObjective(
            model, training, validation, batch=settings.batch, seed=settings.seed, printed=settings.printed_loss
        )
    else:
        target = StructuredObjective(model, training, validation, batch=min(settings.batch, 2048), seed=settings.seed)
    target.engine = _engine(target, engines.engines("cpu" if isinstance(model, DeepModel) else settings.device))
    return target


def _engine(target: NetworkObjective | StructuredObjective, choice: tuple[Engine, ...]) -> Engine:
    """The fastest of several engines on the first batch."""
    if len(choice) > 1:
        target.refresh(target.model.flat)

    def gradient(one: Engine) -> None:
        target.engine = one
        next(target.gradients(target.model.flat, 0))

    return engines.fastest_engine(choice, gradient)


def steps(
    model: Model, data: Data, settings: Settings, progress: adam.Progress | None = None,
    keep: Callable[[adam.Progress], None] = lambda progress: None,
) -> Iterator[tuple[adam.Progress, Model]]:  # fmt: skip
    """Run the loop from the start or from `progress`; yields progress and the best model so far after every epoch.

    Where all epochs are done already, both come once. `keep` receives what training can resume from: at the beginning
    and at every validation.
    """
    target = objective(model, data, settings)
    progress = progress or adam.Progress.begin(target.model.flat)
    keep(progress)
    before = progress.epoch
    for state in adam.train(target, settings.adam, progress):
        if state.epoch % settings.adam.validate_every == 0:
            keep(state)
        yield state, _best(target, state)
    if progress.epoch == before:
        yield progress, _best(target, progress)


def _best(target: NetworkObjective | StructuredObjective, state: adam.Progress) -> Model:
    if isinstance(target, StructuredObjective):
        return target.at(state.best)
    return target.model.with_weights(state.best)


def finished(model: Model, data: Data, training: dict[str, object]) -> Learned:
    """The model with its region and the facts of its training."""
    x, u = np.concatenate([run.x for run in data.training]), np.concatenate([run.u for run in data.training])
    return Learned(model=model, region=Region.about(x, u), training=training)
