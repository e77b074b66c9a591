# SPDX-License-Identifier: Apache-2.0
"""Table rmse_model: the paper's network, trained as printed, as meant and on single steps, and the analytic model.

Recordings are of the emulator's default truth: 2 x 150 s to train on, 60 s to stop by, 60 s to be judged by, the
seeds those of schedule and noise. Errors are of 70-sample
predictions from the measurement, over each state's range; the learned bench file, which is ours, starts from its
observer's states, which see the same measurements.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.paper.network import NetworkModel, train
from benchmarks.paper.store import LOSSES, PRINTED, TIMES, Result, Store
from hydro_bridge.signals import matrix
from hydro_sim.emulator.offline import Recording, record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation import draw
from hydro_sim.files import recordings
from hydro_sim.files.learned_bench import load_model
from hydro_sim.files.recordings import Data
from hydro_sim.identification import validate
from hydro_sim.identification.validate import AnalyticModel, BenchPrediction, Predictor, Scored
from hydro_sim.model.bench import Bench

HORIZON, STRIDE = 70, 37
LOAD_FORCE = 2
SETTINGS: dict[str, dict[str, Any]] = {"squared": {}, "printed": {"printed": True}, "one-step": {"horizon": 1}}
"""What tells the losses apart."""


def record(seconds: float, seed: int) -> Recording:
    """A run of the emulator's default truth under the schedule of a seed."""
    return record_offline(profile("default"), draw(seconds, seed), seed=seed)


@cache
def data() -> Data:
    """What every network is trained on; the last recording validates."""
    seconds = {11: 150.0, 12: 150.0, 13: 60.0}
    return recordings.split({f"train{seed}": record(length, seed).states for seed, length in seconds.items()})


@cache
def held_out() -> list[Scored]:
    """What every model is judged by."""
    recording = record(60.0, 21)
    truth = matrix(recording.noise_free)
    runs = recordings.runs("held out", recording.states)
    return [Scored(run=run, truth=truth[run.first : run.first + len(run)]) for run in runs]


def weights(store: Store, loss: str, seed: int) -> Path:
    """Where a trained network lies."""
    return store.folder / f"network-{loss}-{seed}.npz"


def run(store: Store, seed: int) -> None:
    """The networks of a seed, and both other models."""
    store.piece("model-analytic", lambda: judged(AnalyticModel(Bench.nominal())))
    store.piece("model-ours", lambda: judged(BenchPrediction(load_model(), [one.run for one in held_out()])))
    for loss in LOSSES:
        store.piece(f"model-{loss}-{seed}", lambda chosen=loss: _trained(store, chosen, seed))  # type: ignore[misc]


def network(store: Store, loss: str, seed: int) -> NetworkModel:
    """A trained network, made again if its weights are gone."""
    file = weights(store, loss, seed)
    store.piece(f"model-{loss}-{seed}", lambda: _trained(store, loss, seed), file)
    return NetworkModel.load(file)


def _trained(store: Store, loss: str, seed: int) -> Result:
    """Train a network of Table training and judge it."""
    table = PRINTED["training"]
    model = NetworkModel.untrained(data().training, (table["hidden"][0], table["hidden"][1]), seed)
    told = train(
        model, data(), batch=table["batch"], seed=seed, epochs=store.size.model_epochs,
        learning_rate=table["learning_rate"], **{"horizon": table["horizon"], **SETTINGS[loss]},
    )  # fmt: skip
    model.save(weights(store, loss, seed))
    return {**judged(model), **told}


def judged(model: Predictor) -> Result:
    """Errors on the recording that is held out."""
    scored = held_out()
    reference = np.concatenate([item.reference for item in scored])
    states = [model.estimate(item.run) for item in scored]
    found = validate.prediction_errors(model, states, scored, recorded=False, horizon=HORIZON, stride=STRIDE)
    return {
        "over_range": (found.rmse / np.ptp(reference, axis=0)).tolist(),
        "over_std": (found.rmse / reference.std(axis=0)).tolist(),
        "load_force": {str(n): float(found.by_time[n - 1, LOAD_FORCE]) for n in TIMES},
    }
