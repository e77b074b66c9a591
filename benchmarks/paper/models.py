# SPDX-License-Identifier: Apache-2.0
"""Table rmse_model: the paper's network, trained as printed, as meant and on single steps, and the analytic model.

Recordings are of the store's truth: 2 x 150 s to train on, 60 s to stop by, 60 s to be judged by, the
seeds those of schedule and noise. Errors are of 70-sample predictions from the measurement, over each state's range;
the learned bench file, which is ours, starts from its observer's states, which see the same measurements.

The network gives x' from x and u, is rolled out recursively and trained through time, in torch.

::

    z = (x - center) / scale (8), v = u / current_scale      y = network([z, v])  (9 -> 32 -> 32 -> 8)
    z[k+1] = z[k] + 1 ms * rate_scale / scale * y             rate_scale: y is of order one for every state

    loss   mean over windows, horizon and states of (z - measured)^2                       form "squared"
           mean over windows and states of (sum over the horizon of (z - measured))^2      form "printed", eq. loss

Source: eq. state, eq. loss, Table training. What the paper leaves open: the learning rate falls along a half cosine,
gradients are clipped to a norm of 1, training stops after 150 epochs without a better validation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.paper.predictions import AnalyticModel, BenchPrediction, Predictor, ScoredRun, prediction_errors
from benchmarks.paper.store import LOSSES, PRINTED, TIMES, Result, Store, truth
from hydro_core.signals import SAMPLE_PERIOD, FloatArray, to_matrix
from hydro_sim.emulator.offline import Recording, record_offline
from hydro_sim.excitation import draw_schedule
from hydro_sim.files import recordings
from hydro_sim.files.learned_bench import load_model
from hydro_sim.files.recordings import Data, Run
from hydro_sim.model.bench import Bench

HORIZON, APART = 70, 37
LOAD_FORCE = 2
SETTINGS: dict[str, dict[str, Any]] = {"squared": {}, "printed": {"printed": True}, "one-step": {"horizon": 1}}
"""What tells the losses apart."""
STATES, INPUTS = 8, 9
STRIDE, SETTLED = 35, 600
"""Samples between the starts of an epoch's windows; samples at the beginning of a run without any."""
VALIDATE_EVERY, PATIENCE = 5, 150
FARTHEST = 20.0
"""Standard deviations beyond which a simulated state is clipped."""
Tensor = torch.Tensor


def record(bench: str, seconds: float, seed: int) -> Recording:
    """A run of a truth of `store.truth` under the schedule of a seed."""
    return record_offline(truth(bench), draw_schedule(seconds, seed), seed=seed)


@cache
def data(bench: str) -> Data:
    """What every network is trained on; the last recording validates."""
    seconds = {11: 150.0, 12: 150.0, 13: 60.0}
    return recordings.split({f"train{seed}": record(bench, length, seed).states for seed, length in seconds.items()})


@cache
def held_out(bench: str) -> list[ScoredRun]:
    """What every model is judged by."""
    recording = record(bench, 60.0, 21)
    truth = to_matrix(recording.noise_free)
    runs = recordings.split_runs("held out", recording.states)
    return [ScoredRun(run=run, truth=truth[run.first : run.first + len(run)]) for run in runs]


def run(store: Store, seed: int) -> None:
    """The networks of a seed, and both other models."""
    store.piece("model-analytic", lambda: judged(AnalyticModel(Bench.nominal()), store.bench))
    store.piece("model-ours", partial(_ours, store.bench))
    for loss in LOSSES:
        store.piece(f"model-{loss}-{seed}", partial(_trained, store, loss, seed))


def _ours(bench: str) -> Result:
    return judged(BenchPrediction(load_model(), [one.run for one in held_out(bench)]), bench)


def network(store: Store, loss: str, seed: int) -> NetworkModel:
    """A trained network, made again if its weights are gone."""
    file = _file(store, loss, seed)
    store.piece(f"model-{loss}-{seed}", partial(_trained, store, loss, seed), file)
    return NetworkModel.load(file)


def _file(store: Store, loss: str, seed: int) -> Path:
    return store.folder / f"network-{loss}-{seed}.npz"


def _trained(store: Store, loss: str, seed: int) -> Result:
    """Train a network of Table training and judge it."""
    table = PRINTED["training"]
    model = NetworkModel.untrained(data(store.bench).training, (table["hidden"][0], table["hidden"][1]), seed)
    told = train(
        model, data(store.bench), batch=table["batch"], seed=seed, epochs=store.size.model_epochs,
        learning_rate=table["learning_rate"], **{"horizon": table["horizon"], **SETTINGS[loss]},
    )  # fmt: skip
    model.save(_file(store, loss, seed))
    return {**judged(model, store.bench), **told}


def judged(model: Predictor, bench: str) -> Result:
    """Errors on the recording that is held out."""
    scored = held_out(bench)
    reference = np.concatenate([item.truth for item in scored])
    states = [model.estimate(item.run) for item in scored]
    found = prediction_errors(model, states, scored, horizon=HORIZON, stride=APART)
    return {
        "over_range": (found.rmse / np.ptp(reference, axis=0)).tolist(),
        "over_std": (found.rmse / reference.std(axis=0)).tolist(),
        "load_force": {str(n): float(found.by_time[n - 1, LOAD_FORCE]) for n in TIMES},
    }


@dataclass(frozen=True, kw_only=True)
class NetworkModel:
    """The network with its normalization; computes in float32."""

    layers: torch.nn.Sequential
    center: FloatArray
    """Means of the training samples, shape (8,), SI units."""
    scale: FloatArray
    """Their standard deviations."""
    current_scale: float
    """A."""
    rate_scale: FloatArray
    """Shape (8,), SI units per second, from changes over 10 ms: the change in a sample is noise."""
    rest: FloatArray
    """x of the still bench, shape (8,)."""

    @classmethod
    def untrained(cls, training: list[Run], hidden: tuple[int, int], seed: int) -> NetworkModel:
        """A model of random weights."""
        torch.manual_seed(seed)
        x, u = np.concatenate([run.x for run in training]), np.concatenate([run.u for run in training])
        moved = np.concatenate([run.x[10:] - run.x[:-10] for run in training]).std(axis=0)
        return cls(
            layers=_layers(*hidden), center=x.mean(axis=0), scale=x.std(axis=0), current_scale=float(u.std()),
            rate_scale=moved / (10 * SAMPLE_PERIOD), rest=training[0].x[0].copy(),
        )  # fmt: skip

    def save(self, path: Path) -> None:
        """Write weights and normalization."""
        numbers = {name: getattr(self, name) for name in ("center", "scale", "current_scale", "rate_scale", "rest")}
        np.savez(path, **numbers, **{f"layer{n}": p.detach().numpy() for n, p in enumerate(self.layers.parameters())})

    @classmethod
    def load(cls, path: Path) -> NetworkModel:
        """Read what `save` wrote."""
        with np.load(path) as found:
            weights = [torch.from_numpy(found[f"layer{n}"]) for n in range(6)]
            layers = _layers(*weights[2].T.shape)
            torch.nn.utils.vector_to_parameters(torch.cat([one.flatten() for one in weights]), layers.parameters())
            numbers = {name: found[name] for name in ("center", "scale", "rate_scale", "rest")}
            return cls(layers=layers, current_scale=float(found["current_scale"]), **numbers)

    def rolled(self, z: Tensor, v: Tensor) -> Tensor:
        """Normalized states, shape (n, H, 8), from z, shape (n, 8), under scaled currents, shape (n, H)."""
        step = torch.from_numpy((SAMPLE_PERIOD * self.rate_scale / self.scale).astype(np.float32))
        states = []
        for current in v.unbind(1):
            z = z + step * self.layers(torch.cat((z, current[:, None]), 1))
            states.append(z)
        return torch.stack(states, 1)

    def normalized(self, x: FloatArray, u: FloatArray) -> tuple[Tensor, Tensor]:
        """z of x, shape (..., 8), and the scaled current of u [A]."""
        z, v = (x - self.center) / self.scale, u / self.current_scale
        return torch.from_numpy(z.astype(np.float32)), torch.from_numpy(np.asarray(v, np.float32))

    @torch.no_grad()
    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8), from x, shape (n, 8), under currents [A], shape (n, H)."""
        z, v = self.normalized(starts, currents)
        return np.asarray(self.rolled(z, v).numpy() * self.scale + self.center, np.float64)

    def estimate(self, run: Run) -> FloatArray:
        """The measurement itself: this model's state is x."""
        return run.x

    def linearized(self, state: FloatArray, current: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A (8, 8), B (8,) and x' (8,) at a state and a valve's current [A], SI units."""
        w1, b1, w2, b2, w3, b3 = (p.detach().numpy().astype(np.float64) for p in self.layers.parameters())
        a1 = w1 @ np.append((state - self.center) / self.scale, current / self.current_scale) + b1
        a2 = w2 @ np.maximum(a1, 0.0) + b2
        slopes = (w3 * (a2 > 0.0)) @ (w2 * (a1 > 0.0)) @ w1
        rate = self.rate_scale[:, np.newaxis]
        push = self.rate_scale * slopes[:, STATES] / self.current_scale
        return rate * slopes[:, :STATES] / self.scale, push, self.rate_scale * (w3 @ np.maximum(a2, 0.0) + b3)


def _layers(first: int, second: int) -> torch.nn.Sequential:
    return torch.nn.Sequential(
        torch.nn.Linear(INPUTS, first), torch.nn.ReLU(), torch.nn.Linear(first, second), torch.nn.ReLU(),
        torch.nn.Linear(second, STATES),
    )  # fmt: skip


class NetworkPlant:
    """The model without noise as a `hydro_sim.model.plant.Plant`."""

    def __init__(self, model: NetworkModel) -> None:
        self.model, self.state = model, model.rest.copy()

    def reset(self, seed: int) -> FloatArray:
        """See `Plant`."""
        self.state = self.model.rest.copy()
        return self.state.copy()

    def step(self, valve_current: float) -> FloatArray:
        """See `Plant`."""
        model = self.model
        z = (self.state + SAMPLE_PERIOD * model.linearized(self.state, valve_current)[2] - model.center) / model.scale
        self.state = model.center + model.scale * np.clip(z, -FARTHEST, FARTHEST)
        return self.state.copy()


def train(
    model: NetworkModel, data: Data, *, batch: int, seed: int, epochs: int, horizon: int = 70, printed: bool = False,
    learning_rate: float = 1e-3,
) -> dict[str, int]:  # fmt: skip
    """Train in place; keep the weights of the best validation. Returns the epochs done and the best one."""
    training, validation = _Windows(model, data.training, horizon), _Windows(model, data.validation, 70)
    z_seen, v_seen, seen = validation.at(validation.starts(0))
    optimizer = torch.optim.Adam(model.layers.parameters(), lr=learning_rate)
    turn = torch.optim.lr_scheduler.LambdaLR(
        optimizer, lambda epoch: 0.02 + 0.98 * math.cos(0.5 * math.pi * epoch / epochs) ** 2
    )
    best, best_epoch, kept, epoch = math.inf, 0, torch.nn.utils.parameters_to_vector(model.layers.parameters()), 0
    for epoch in range(1, epochs + 1):
        generator = np.random.default_rng([seed, epoch])
        starts = generator.permutation(training.starts(int(generator.integers(STRIDE))))
        for part in np.array_split(starts, -(-len(starts) // batch)):
            z, v, targets = training.at(part)
            errors = model.rolled(z, v) - targets
            value = (errors.sum(1) ** 2).mean() if printed else (errors**2).mean()
            optimizer.zero_grad()
            value.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(model.layers.parameters(), 1.0)
            optimizer.step()
        turn.step()
        if epoch % VALIDATE_EVERY == 0 or epoch == epochs:
            with torch.no_grad():
                error = float(((model.rolled(z_seen, v_seen) - seen) ** 2).mean()) ** 0.5
            if error < 0.999 * best:
                best, best_epoch = error, epoch
                kept = torch.nn.utils.parameters_to_vector(model.layers.parameters()).detach().clone()
        if epoch - best_epoch >= PATIENCE:
            break
    torch.nn.utils.vector_to_parameters(kept, model.layers.parameters())
    return {"epochs": epoch, "best_epoch": best_epoch}


class _Windows:
    """All windows of some runs: where they may start, and their samples."""

    def __init__(self, model: NetworkModel, runs: list[Run], horizon: int) -> None:
        self.z, self.v = model.normalized(np.concatenate([run.x for run in runs]), np.concatenate([r.u for r in runs]))
        self.lengths, self.steps = [len(run) for run in runs], np.arange(horizon)

    def starts(self, offset: int) -> Any:
        ends = np.cumsum(self.lengths)
        begins = ends - self.lengths + np.minimum(SETTLED, np.array(self.lengths) // 4) + offset
        return np.concatenate([np.arange(b, e - len(self.steps), STRIDE) for b, e in zip(begins, ends, strict=True)])

    def at(self, starts: Any) -> tuple[Tensor, Tensor, Tensor]:
        rows = starts[:, None] + self.steps
        return self.z[starts], self.v[rows], self.z[rows + 1]
