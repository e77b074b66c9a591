# SPDX-License-Identifier: Apache-2.0
"""Table rmse_model: the paper's network, trained as printed, as meant and on single steps, and the analytic model.

Recordings, windows and noise-free log are those of `benchmarks.learned_structures`. Errors are of 70-sample
predictions from the measurement, over each state's range; the structured model, which is ours, starts from its
observer's states, which see the same measurements.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._learned_case import Case
from benchmarks.paper.store import LOSSES, PRINTED, TIMES, Result, Store
from hydro_sim.identification import adam, evaluation, training
from hydro_sim.identification.analytic import AnalyticModel
from hydro_sim.identification.evaluation import Predictor, Scales
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench
from hydro_sim.neural.network_model import NetworkModel

HORIZON, STRIDE = 70, 37
LOAD_FORCE = 2
SETTINGS: dict[str, dict[str, Any]] = {"squared": {}, "printed": {"printed_loss": True}, "one-step": {"horizon": 1}}
"""What tells the losses apart."""


@cache
def case() -> Case:
    """Recordings of the emulator's default truth."""
    return Case(Path(), None, 0)


def weights(store: Store, loss: str, seed: int) -> Path:
    """Where a trained network lies."""
    return store.folder / f"network-{loss}-{seed}.safetensors"


def run(store: Store, seed: int) -> None:
    """The networks of a seed, and both other models."""
    store.piece("model-analytic", lambda: judged(AnalyticModel(Bench.nominal())))
    store.piece("model-ours", lambda: judged(Learned.load().model))
    for loss in LOSSES:
        train(store, loss, seed)


def train(store: Store, loss: str, seed: int) -> Result:
    """One network, if it is not there yet."""
    return store.piece(f"model-{loss}-{seed}", lambda: _trained(store, loss, seed))


def network(store: Store, loss: str, seed: int) -> NetworkModel:
    """A trained network, made again if its weights are gone."""
    file = weights(store, loss, seed)
    store.piece(f"model-{loss}-{seed}", lambda: _trained(store, loss, seed), file)
    model = Learned.load(file).model
    assert isinstance(model, NetworkModel)
    return model


def _trained(store: Store, loss: str, seed: int) -> Result:
    """Train a network of Table training and judge it."""
    table, data = PRINTED["training"], case().data()
    settings = training.Settings(
        structure="network", hidden=tuple(table["hidden"]), batch=table["batch"], seed=seed,
        adam=adam.Settings(epochs=store.size.model_epochs, learning_rate=table["learning_rate"]),
        **{"horizon": table["horizon"], **SETTINGS[loss]},
    )  # fmt: skip
    *_, (last, model) = training.steps(training.start(data, settings, Bench.nominal()), data, settings)
    training.finished(model, data, {"loss": loss, "seed": seed}).save(weights(store, loss, seed))
    return {**judged(model), "epochs": last.epoch, "best_epoch": last.best_epoch}


def judged(model: Predictor) -> Result:
    """Errors on the recording that is held out."""
    scored = case().held_out()
    scales = Scales.of(np.concatenate([item.reference for item in scored]))
    states = [model.estimate(item.run) for item in scored]
    found = evaluation.prediction_errors(model, states, scored, recorded=False, horizon=HORIZON, stride=STRIDE)
    return {
        "over_range": (found.rmse / scales.span).tolist(), "over_std": (found.rmse / scales.std).tolist(),
        "load_force": {str(n): float(found.by_time[n - 1, LOAD_FORCE]) for n in TIMES},
    }  # fmt: skip
