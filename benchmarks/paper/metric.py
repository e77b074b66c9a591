# SPDX-License-Identifier: Apache-2.0
"""Table training_metric: M(x) by a network, trained for v along f_l on rollouts of the paper's network model.

The filter of it, eq. cont_require_6, is decided at 100 Hz. M = L L' + eps I, the network gives L row by row; M' is its
derivative along x'. A and B are the model network's exact slopes, where the paper takes differences. v is along f_l
with the sign of physics.md's erratum: with the printed one the correction pushes the force away from its reference.

Rollouts and their labels are those of `hydro_filter.training.data` on the network model without noise. The loss is eq.
loss_metric with W_l, the regularizers and H_m as printed. A, B and K do not depend on M and are computed once, exactly;
the paper takes differences in every epoch. What the paper leaves open: gains of K_p from -40 to 200 1/s, 200 windows a
rollout, every fifth rollout of each label held out, from the second on.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from benchmarks.paper import models
from benchmarks.paper.models import NetworkModel, NetworkPlant
from benchmarks.paper.store import PRINTED, Result, Store
from hydro_core.signals import CorrectionStatus, FloatArray
from hydro_filter.controller.loop_filter import Result as Correction
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import make_loop, make_samples
from hydro_filter.model.records import law_gradient, library
from hydro_filter.model.sample import LOAD_FORCE, STATE_SIZE, Sample
from hydro_filter.training.data import NEITHER, STABLE, UNSTABLE, DataSettings, Rollout, roll_out
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

TABLE = PRINTED["training_metric"]
TRAININGS = ("short", "long")
"""The paper's three epochs; until it has converged, or as many as the size has."""
WINDOWS, HELD_OUT = 200, 5
PATIENCE, GAIN = 20, 0.01
"""The long training has converged when this many epochs have lowered the best held-out loss by less than this share."""
SETTLED = 300
"""Samples at a rollout's beginning that are not used: the gains fade in."""
PERIOD = 10
"""Samples between two decisions: 100 Hz."""
ROWS, COLUMNS = np.tril_indices(STATE_SIZE)
PLACES = torch.zeros(len(ROWS), STATE_SIZE * STATE_SIZE)
"""1 where an entry of the network's output belongs in M's factor."""
PLACES[torch.arange(len(ROWS)), torch.from_numpy(STATE_SIZE * ROWS + COLUMNS)] = 1.0


@dataclass(frozen=True)
class NetworkMetric:
    """M(x) on normalized states.

    `layers`: weights and biases of three layers, 8 inputs and 36 outputs. `center`, `scale`: of the model's states,
    shape (8,), SI units.
    """

    layers: tuple[FloatArray, ...]
    center: FloatArray
    scale: FloatArray

    def along(self, state: FloatArray, state_rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """M(x), and M' [1/s] along x', each of shape (8, 8)."""
        w1, b1, w2, b2, w3, b3 = self.layers
        value, nudge = (state - self.center) / self.scale, state_rate / self.scale
        for w, b in ((w1, b1), (w2, b2)):
            value, nudge = value @ w + b, nudge @ w
            on = value > 0.0
            value, nudge = value * on, nudge * on
        factor, turned = np.zeros((2, STATE_SIZE, STATE_SIZE))
        factor[ROWS, COLUMNS], turned[ROWS, COLUMNS] = value @ w3 + b3, nudge @ w3
        metric = factor @ factor.T + float(TABLE["epsilon"]) * np.eye(STATE_SIZE)
        return metric, turned @ factor.T + factor @ turned.T


class ForceLaw:
    """The law that the box runs on the nominal bench."""

    def __init__(self) -> None:
        self.loop, self.current_max = make_loop(load_model(), Bench.nominal()).record, Bench.nominal().valve_current_max

    def clipped(self, current: float) -> float:
        """A current within the valve's limit [A]."""
        return min(max(current, -self.current_max), self.current_max)

    def gradient(self, sample: Sample) -> FloatArray:
        """K = du/dx [A per unit of each state], shape (8,)."""
        signals = {"nominal": sample.nominal_current, "k_p": sample.proportional_gain}
        return law_gradient(self.loop, make_samples(sample.state[None], **signals))


def closed_form(a: float, b: float, low: float, high: float) -> tuple[float, CorrectionStatus]:
    """Return the smallest |du| with a du <= b and low <= du <= high, and its status (firmware/hydro/loop_filter.h)."""
    status = ctypes.c_uint32()
    change = library().hydro_c_closed_form(a, b, low, high, ctypes.byref(status))
    return change, CorrectionStatus(status.value)


class PaperFilter:
    """The filter as the paper has it: lambda 0.1, no dead zone for noise, one decision in `PERIOD` samples.

    M_c = v' (M' + sym(M (A + B K)) + 2 lambda M) v        v = [0, 0, f_l - f_r, 0, ...], of normalized states
    a   = 2 v' M B,  b = -M_c                              a du <= b, the smallest |du| in the valve's rest
    """

    def __init__(self, metric: NetworkMetric, model: NetworkModel) -> None:
        self.metric, self.model, self.law = metric, model, ForceLaw()
        self.contraction_rate = float(PRINTED["val_cont"]["rate"])
        self.reset()

    def reset(self) -> None:
        """Start again."""
        self._count = 0

    def certificate(self, sample: Sample) -> tuple[float, float]:
        """Return a [1/A/s] and b [1/s] at a sample."""
        v, scale = np.zeros(STATE_SIZE), self.model.scale
        v[LOAD_FORCE] = (sample.state[LOAD_FORCE] - sample.reference_force) / scale[LOAD_FORCE]
        state_matrix, input_vector, rate = self.model.linearized(sample.state, self.law.clipped(sample.nominal_current))
        metric, metric_rate = self.metric.along(sample.state, rate)
        moved = scale * v
        closed = state_matrix @ moved + input_vector * float(self.law.gradient(sample) @ moved)
        drift = float(v @ metric @ (closed / scale))
        m_c = float(v @ (metric_rate @ v)) + 2.0 * drift + 2.0 * self.contraction_rate * float(v @ metric @ v)
        return 2.0 * float(v @ metric @ (input_vector / scale)), -m_c

    def correct(self, sample: Sample, age: float = 0.0) -> Correction:
        """Decide, or hold."""
        if self._count % PERIOD == 0:
            self._held = self._decide(sample)
        self._count += 1
        return self._held

    def _decide(self, sample: Sample) -> Correction:
        if not all(map(isfinite, (*sample.state, sample.nominal_current))):
            return Correction(0.0, nan, nan, CorrectionStatus.NAN)
        a, b = self.certificate(sample)
        limit, applied = self.law.current_max, self.law.clipped(sample.nominal_current)
        change, status = closed_form(a, b, -limit - applied, limit - applied)
        delta_u = change + (applied - sample.nominal_current) if change else 0.0
        return Correction(delta_u, -b, a * change - b, status)


class Samples(NamedTuple):
    """What does not depend on M, normalized; n windows of H samples, torch, float64."""

    z: torch.Tensor
    """Shape (n, H, 8)."""
    rate: torch.Tensor
    """z' [1/s], shape (n, H, 8)."""
    v: torch.Tensor
    """Shape (n, H, 8)."""
    closed: torch.Tensor
    """(A + B K) v [1/s], shape (n, H, 8)."""
    stable: torch.Tensor
    """Shape (n, 1)."""


def run(store: Store, seed: int) -> None:
    """What is ours, then the paper's metric of a seed: after its three epochs, and after many."""
    store.piece("metric-ours", _ours)
    for training in TRAININGS:
        store.piece(f"metric-{training}-{seed}", partial(_trained, store, training, seed))


def load(store: Store, training: str, seed: int) -> NetworkMetric:
    """A metric of `TRAININGS`, trained if it is not there; the long training begins as the short one, to the bit."""
    file = _file(store, training, seed)
    store.piece(f"metric-{training}-{seed}", partial(_trained, store, training, seed), file)
    with np.load(file) as found:
        layers = tuple(found[f"layer{n}"] for n in range(6))
        return NetworkMetric(layers, found["center"], found["scale"])


def _file(store: Store, training: str, seed: int) -> Path:
    return store.folder / f"metric-{training}-{seed}.npz"


def _trained(store: Store, name: str, seed: int) -> Result:
    torch.manual_seed(seed)
    model = models.network(store, "squared", seed)
    training, held_out, labels = material(model, store.size.rollouts, seed)
    network = torch.nn.Sequential(
        torch.nn.Linear(STATE_SIZE, TABLE["hidden"][0]), torch.nn.ReLU(),
        torch.nn.Linear(*TABLE["hidden"]), torch.nn.ReLU(), torch.nn.Linear(TABLE["hidden"][1], len(ROWS)),
    ).double()  # fmt: skip
    optimizer = torch.optim.Adam(network.parameters(), lr=TABLE["learning_rate"])
    history = [judged(network, held_out)]
    for _ in range(TABLE["epochs"] if name == "short" else store.size.metric_epochs):
        if converged([epoch["loss"] for epoch in history]):
            break
        for batch in torch.randperm(len(training.z)).split(TABLE["batch"]):
            value = loss(network, Samples(*(part[batch] for part in training)))
            optimizer.zero_grad()
            value.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
        history.append(judged(network, held_out))
    kept = {f"layer{n}": p.detach().numpy().T for n, p in enumerate(network.parameters())}
    np.savez(_file(store, name, seed), center=model.center, scale=model.scale, **kept)
    return {"windows": len(training.z), "rollouts": labels, "history": history}


def converged(losses: Sequence[float]) -> bool:
    """Whether the last epochs have gained nothing that counts."""
    return len(losses) > PATIENCE and min(losses[-PATIENCE:]) > (1.0 - GAIN) * min(losses[:-PATIENCE])


def growth(network: torch.nn.Module, samples: Samples) -> tuple[torch.Tensor, torch.Tensor]:
    """M_c, shape (n, H), and M, shape (n, H, 8, 8)."""
    flat, turned = torch.func.jvp(network, (samples.z,), (samples.rate,))  # type: ignore[no-untyped-call]
    factor, nudge = _lower(flat), _lower(turned)
    eye = torch.eye(STATE_SIZE, dtype=factor.dtype)
    metric = factor @ factor.mT + TABLE["epsilon"] * eye
    left = torch.einsum("nhij,nhi->nhj", factor, samples.v)
    left_rate = torch.einsum("nhij,nhi->nhj", nudge, samples.v)
    along = torch.einsum("nhi,nhij->nhj", samples.v, metric)
    grown = 2.0 * (left * left_rate).sum(-1) + 2.0 * (along * samples.closed).sum(-1)
    return grown + 2.0 * PRINTED["val_cont"]["rate"] * (along * samples.v).sum(-1), metric


def loss(network: torch.nn.Module, samples: Samples) -> torch.Tensor:
    """Eq. loss_metric, the mean over windows."""
    certificate, metric = growth(network, samples)
    contraction = torch.relu(torch.where(samples.stable, certificate, -certificate))
    eye = torch.eye(STATE_SIZE, dtype=metric.dtype)
    size = torch.linalg.matrix_norm(metric) + metric.diagonal(dim1=-2, dim2=-1).sum(-1)
    size = size - torch.logdet(metric + TABLE["epsilon"] * eye)
    return (TABLE["contraction_weight"] * contraction + TABLE["regularizer"] * size).sum(1).mean()


def _lower(flat: torch.Tensor) -> torch.Tensor:
    """The triangular matrix of entries by rows: by a product, which is quicker than to write them one by one."""
    return (flat @ PLACES.to(flat.dtype)).unflatten(-1, (STATE_SIZE, STATE_SIZE))


@torch.no_grad()
def judged(network: torch.nn.Module, samples: Samples) -> dict[str, float]:
    """Loss, and the shares of samples whose sign of M_c is as their label says (NaN: none has it), on windows."""
    certificate, _ = growth(network, samples)
    stable = samples.stable.expand(certificate.shape)
    right = float((certificate[stable] <= 0.0).double().mean()), float((certificate[~stable] > 0.0).double().mean())
    return {"loss": float(loss(network, samples)), "stable_verified": right[0], "unstable_found": right[1]}


def material(model: NetworkModel, rollouts: int, seed: int) -> tuple[Samples, Samples, dict[str, int]]:
    """Windows to train on and held out, and how many rollouts have which label."""
    plant, bench = NetworkPlant(model), Bench.nominal()
    settings = DataSettings(rollouts=rollouts, gain_max=200.0, seed=seed)
    parts: tuple[list[Samples], list[Samples]] = ([], [])
    labels, used = {"stable": 0, "unstable": 0, "neither": 0}, {STABLE: 0, UNSTABLE: 0}
    for index in range(rollouts):
        rollout = roll_out(plant, bench, settings, index)
        labels["neither" if rollout.label == NEITHER else "stable" if rollout.label == STABLE else "unstable"] += 1
        if rollout.label != NEITHER and len(rollout.states) > SETTLED + 2 * TABLE["horizon"]:
            used[rollout.label] += 1
            parts[used[rollout.label] % HELD_OUT == 2].append(windows(rollout, model, seed + index))
    training, held_out = (Samples(*(torch.cat(field) for field in zip(*part, strict=True))) for part in parts)
    return training, held_out, labels


def windows(rollout: Rollout, model: NetworkModel, seed: int) -> Samples:
    """Windows at random places of a rollout."""
    starts = np.random.default_rng(seed).integers(SETTLED, len(rollout.states) - TABLE["horizon"], WINDOWS)
    places = starts[:, np.newaxis] + np.arange(TABLE["horizon"])
    law = ForceLaw()
    seen = {int(k): _normalized(Sample.from_record(rollout.states[k]), model, law) for k in np.unique(places)}
    rows = np.array([[seen[int(k)] for k in row] for row in places])
    z, rate, v, closed = (torch.from_numpy(rows[:, :, n]) for n in range(4))
    return Samples(z, rate, v, closed, torch.full((WINDOWS, 1), rollout.label == STABLE))


def _normalized(sample: Sample, model: NetworkModel, law: ForceLaw) -> FloatArray:
    """z, z', v and (A + B K) v of a sample, shape (4, 8)."""
    state_matrix, input_vector, rate = model.linearized(sample.state, law.clipped(sample.nominal_current))
    v = np.zeros(STATE_SIZE)
    v[LOAD_FORCE] = sample.state[LOAD_FORCE] - sample.reference_force
    closed = state_matrix @ v + input_vector * float(law.gradient(sample) @ v)
    z = (sample.state - model.center) / model.scale
    return np.stack([z, rate / model.scale, v / model.scale, closed / model.scale])


def _ours() -> Result:
    """What the shipped metric's file says of itself, on its own rollouts."""
    training = ScheduledMetric.load().training
    return {"command": training["command"], "stable_verified": 1.0 - 0.01 * training["violated"]}
