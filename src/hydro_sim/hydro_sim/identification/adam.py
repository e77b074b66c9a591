# SPDX-License-Identifier: Apache-2.0
"""The training loop of every model structure: Adam (Kingma and Ba, 2015) on one vector, with early stopping.

An epoch depends on the parameters, the optimizer's state, and the epoch's number alone (shuffles are drawn from seed
and epoch): a resumed run gives bit-identical results to one that was not interrupted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.neural import adam_kernel

GAIN = 1e-3
"""Relative improvement over the best validation that counts."""


class Objective(Protocol):
    """A training objective."""

    def refresh(self, parameters: FloatArray) -> None:
        """Recompute what depends on the model but is not differentiated: the windows' start states."""

    def gradients(self, parameters: FloatArray, epoch: int) -> Iterator[tuple[float, FloatArray]]:
        """Yield loss and gradient of each batch of an epoch; `parameters` changes in place between them."""

    def validate(self, parameters: FloatArray) -> float:
        """Error on the validation runs; the smaller the better."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the training loop."""

    epochs: int = 1000
    """[1, 100000] (Table training)."""
    learning_rate: float = 1e-3
    """(0, 1] (Table training)."""
    final_share: float = 0.02
    """Of the learning rate at the last epoch, (0, 1]; it falls along a half cosine."""
    patience: int = 150
    """Epochs without a better validation before training stops, [1, 100000]."""
    validate_every: int = 5
    """Epochs, [1, 1000]."""
    refresh_every: int = 50
    """Epochs between estimates of the start states, [1, 100000]."""
    clip: float = 1.0
    """Largest norm of a gradient; a longer one is shortened, above 0."""


@dataclass(kw_only=True)
class Progress:
    """Progress of a training: everything that the loop resumes from."""

    parameters: FloatArray
    first_moment: FloatArray
    second_moment: FloatArray
    best: FloatArray
    anchor: FloatArray
    """Parameters at the last refresh."""
    best_error: float = math.inf
    best_epoch: int = 0
    epoch: int = 0
    """Epochs done."""
    steps: int = 0
    history: FloatArray
    """Rows of epoch, training loss, validation error (NaN where it was not taken), shape (n, 3)."""

    @classmethod
    def begin(cls, parameters: FloatArray) -> Progress:
        """Return the progress of a training that has not begun."""
        zeros = np.zeros_like(parameters)
        return cls(
            parameters=parameters.copy(), best=parameters.copy(), anchor=parameters.copy(), first_moment=zeros,
            second_moment=zeros.copy(), history=np.empty((0, 3)),
        )  # fmt: skip

    def arrays(self) -> dict[str, FloatArray]:
        """Return all fields by name; numbers as arrays of one."""
        return {entry.name: np.atleast_1d(np.asarray(getattr(self, entry.name))) for entry in fields(self)}

    @classmethod
    def of(cls, arrays: Mapping[str, FloatArray]) -> Progress:
        """Restore from `arrays`; KeyError or TypeError if they are incomplete."""
        scalars = {name: arrays[name][0].item() for name in ("best_error", "best_epoch", "epoch", "steps")}
        return cls(**{**arrays, **scalars})


def train(objective: Objective, settings: Settings, progress: Progress) -> Iterator[Progress]:
    """Continue training from `progress`, in place; yields it after every epoch, until the last or early stopping."""
    objective.refresh(progress.anchor)
    while progress.epoch < settings.epochs and progress.epoch - progress.best_epoch < settings.patience:
        if progress.epoch % settings.refresh_every == 0 and progress.epoch > 0:
            progress.anchor = progress.parameters.copy()
            objective.refresh(progress.anchor)
        if progress.epoch == 0:
            _note(progress, math.nan, objective.validate(progress.parameters))
        losses = []
        turn = math.cos(0.5 * math.pi * progress.epoch / settings.epochs) ** 2
        rate = settings.learning_rate * (settings.final_share + (1.0 - settings.final_share) * turn)
        for loss, gradient in objective.gradients(progress.parameters, progress.epoch):
            _step(progress, gradient, rate, settings.clip)
            losses.append(loss)
        progress.epoch += 1
        due = progress.epoch % settings.validate_every == 0 or progress.epoch == settings.epochs
        _note(progress, float(np.mean(losses)), objective.validate(progress.parameters) if due else math.nan)
        yield progress


def _note(progress: Progress, loss: float, error: float) -> None:
    progress.history = np.vstack((progress.history, (progress.epoch, loss, error)))
    if error < (1.0 - GAIN) * progress.best_error:
        progress.best_error, progress.best_epoch = error, progress.epoch
        progress.best = progress.parameters.copy()


def _step(progress: Progress, gradient: FloatArray, rate: float, clip: float) -> None:
    norm = float(np.linalg.norm(gradient))
    if not math.isfinite(norm):
        return
    gradient = (gradient * min(1.0, clip / max(norm, 1e-30))).astype(progress.parameters.dtype)
    moments = progress.first_moment, progress.second_moment
    adam_kernel.step(adam_kernel.Adam(progress.parameters, gradient, *moments, rate, progress.steps), 1)
    progress.steps += 1
