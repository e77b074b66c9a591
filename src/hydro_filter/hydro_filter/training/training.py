# SPDX-License-Identifier: Apache-2.0
"""Training of the metric: samples from windows, Adam on shuffled batches, early stopping, checkpoints.

A, B and K do not depend on the metric and are in the windows already; M' comes from the network's own derivative
along x'. An epoch is then matrix products and eigenvalues of 8 by 8.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch

from hydro_bridge.files.atomic import write_whole
from hydro_bridge.files.tensors import check_numbers
from hydro_bridge.settings import quantity
from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.metric.network import GAIN_UNIT, INPUTS
from hydro_filter.model.state import STATES
from hydro_filter.training import loss as metric_loss
from hydro_filter.training.data import STABLE, UNSTABLE, Windows
from hydro_filter.training.loss import LossSettings, Network, Samples


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """Table training_metric, but for epochs and learning rate."""

    epochs: Annotated[int, quantity("-", 0, 100000)] = 400
    """At most; the paper stopped after 3; 0: the solved metrics alone."""
    batch: Annotated[int, quantity("-", 1, 100000)] = 1024
    """Windows per step."""
    learning_rate: Annotated[float, quantity("-", 1e-7, 1.0)] = 1e-4
    """Of Adam; the paper's 1e-3 leaps away from the solved metrics that training starts from."""
    patience: Annotated[int, quantity("-", 1, 10000)] = 40
    """Epochs without a better validation before training stops."""
    seed: Annotated[int, quantity("-", 0, 9e15)] = 0
    """Of first weights and shuffles."""
    loss: LossSettings = field(default_factory=LossSettings)


class Quality(NamedTuple):
    """Quality of the certificate on held-out windows."""

    loss: float
    violated: float
    """Share of samples of the certified range in which some direction does not decay at lambda."""
    foreign_violated: float
    """Share of samples in which no correction makes the metric for foreign gains decay at its rate."""
    caught: float
    """Share of unstable samples whose M_c is above 0."""


@dataclass(kw_only=True)
class Progress:
    """Progress of a training."""

    epoch: int = 0
    best_epoch: int = 0
    best: FloatArray = field(default_factory=lambda: np.empty(0))
    """Weights with the smallest validation loss."""
    best_loss: float = np.inf
    history: list[tuple[float, ...]] = field(default_factory=list)
    """Rows: epoch, training loss, and `Quality`."""


class Correction(NamedTuple):
    """The best correction about the still bench."""

    feedback: FloatArray
    """K [A], of each coordinate."""
    driven: int
    """Coordinate whose entry of G follows g everywhere."""
    push: float
    """G's entry of it about the still bench."""


def certificate_queries(windows: Windows, metric: LearnedMetric, correction: Correction, how: LossSettings) -> Samples:
    """Return the certificate queries of windows: n H samples for up to three queries, along axis 0 as (query, n, H).

    The correction is scaled by G's entry of its `driven` coordinate, as the force law scales its own by g.
    """
    low, high = metric.gains[0], metric.gains[-1]
    inside = (windows.gain >= low) & (windows.gain <= high)
    wanted = windows.part(inside & (windows.label == STABLE))
    unstable = windows.part(~inside & (windows.label == UNSTABLE))
    own = _samples(wanted, metric, wanted.feedback, how.rate + how.margin, STABLE, outside=False)
    best = correcting_gains(windows, correction)
    foreign = _samples(windows, metric, best, how.foreign_rate + how.margin, STABLE, outside=True)
    caught = _samples(unstable, metric, unstable.feedback, how.foreign_rate, UNSTABLE, outside=True)
    return Samples(*(torch.cat(parts) for parts in zip(own, foreign, caught, strict=True)))


def correcting_gains(windows: Windows, correction: Correction) -> FloatArray:
    """K [A] of the best correction at every sample, shape (n, H, 8): scaled as the force law scales its own by g."""
    return (correction.push / windows.push[..., correction.driven])[..., np.newaxis] * correction.feedback


def _samples(
    windows: Windows, metric: LearnedMetric, feedback: FloatArray, rate: float, kind: int, *, outside: bool
) -> Samples:
    (count, span), width = windows.x.shape[:2], windows.v.shape[-1]
    inputs, nudge = np.zeros((count, span, INPUTS)), np.zeros((count, span, INPUTS))
    seen = np.clip(windows.x, metric.low, metric.high)
    inputs[..., :STATES] = (seen - metric.center) / metric.scale
    nudge[..., :STATES] = np.where(seen == windows.x, windows.state_rate / metric.scale, 0.0)
    inputs[..., STATES] = 0.0 if outside else windows.gain[:, np.newaxis] / GAIN_UNIT
    inputs[..., STATES + 1] = float(outside)
    base = np.repeat(table_rows(metric, windows.gain, outside=outside), span, axis=0)
    closed = windows.transition + windows.push[..., np.newaxis] * feedback[..., np.newaxis, :]
    flat = (inputs.reshape(-1, INPUTS), nudge.reshape(-1, INPUTS), base, closed.reshape(-1, width, width))
    decay = np.full(count * span, np.exp(-2.0 * rate * SAMPLE_PERIOD))
    arrays = (*flat, decay, windows.v.reshape(-1, width), np.full(count * span, kind))
    return Samples(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))


def table_rows(metric: LearnedMetric, gains: FloatArray, *, outside: bool) -> FloatArray:
    """Return the table's factors, shape (n, 36), at gains of the range, or those for foreign gains."""
    if outside:
        return np.tile(metric.table[-1], (len(gains), 1))
    columns = [np.interp(gains, metric.gains, column) for column in metric.table[:-1].T]
    return np.stack(columns, axis=1)


def network_of(metric: LearnedMetric) -> Network:
    """Return the metric's network in torch."""
    network = Network(INPUTS, metric.hidden, metric.table.shape[1])
    for parameter, values in zip(network.weights, metric.parts.layers, strict=True):
        parameter.data = torch.from_numpy(np.array(values))
    return network


def flat_of(network: Network) -> FloatArray:
    """Return the network's weights in the layout of `LearnedMetric.flat`."""
    return np.concatenate([parameter.detach().numpy().ravel() for parameter in network.weights])


@torch.no_grad()
def evaluate_quality(network: Network, samples: Samples, floor: float, how: LossSettings) -> Quality:
    """Evaluate the quality at lambda itself, without the training's margin."""
    metric, rate = metric_loss.matrices(network, samples, floor)
    slack = samples.decay * (np.exp(2.0 * how.margin * SAMPLE_PERIOD) - 1.0) / SAMPLE_PERIOD
    stable, outside = samples.kind > 0, samples.inputs[:, -1] > 0.5
    grown = metric_loss.growth(metric, rate, samples) - slack > 0.0
    caught = metric_loss.along(metric, rate, samples)[~stable] > 0.0
    shares = (grown[stable & ~outside], grown[stable & outside], caught)
    mean = [float(share.double().mean()) if len(share) else float("nan") for share in shares]
    return Quality(float(metric_loss.loss(network, samples, floor, how)), *mean)


def train(
    metric: LearnedMetric, training: Samples, validation: Samples, horizon: int, settings: TrainingSettings,
    checkpoint: Path, *, resume: bool = False, begun: Mapping[str, Any] | None = None,
) -> Iterator[tuple[Progress, LearnedMetric]]:  # fmt: skip
    """Train; yields after every epoch, the metric with the best weights so far. The first is the solved one.

    The checkpoint keeps `begun`, numbers and texts, for `saved_options`.
    """
    torch.manual_seed(settings.seed)
    network, floor = network_of(metric), metric.floor
    optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    state = _load(checkpoint, network, optimizer) if resume and checkpoint.exists() else Progress(best=metric.flat)
    if not state.history:
        _note(state, network, float("nan"), evaluate_quality(network, validation, floor, settings.loss))
        yield state, metric.with_weights(state.best)
    size = settings.batch * horizon
    while state.epoch < settings.epochs and state.epoch - state.best_epoch < settings.patience:
        generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + state.epoch)
        total, windows = 0.0, len(training.v) // horizon
        for batch in torch.randperm(windows, generator=generator).split(settings.batch):
            rows = (batch[:, None] * horizon + torch.arange(horizon)).reshape(-1)
            value = metric_loss.loss(network, Samples(*(part[rows] for part in training)), floor, settings.loss)
            optimizer.zero_grad()
            value.backward()
            optimizer.step()
            total += float(value.detach()) * len(rows) / len(training.v)
        assert size > 0
        state.epoch += 1
        _note(state, network, total, evaluate_quality(network, validation, floor, settings.loss))
        _save(checkpoint, state, network, optimizer, dict(begun or {}))
        yield state, metric.with_weights(state.best)


def _note(state: Progress, network: Network, training_loss: float, quality: Quality) -> None:
    state.history.append((float(state.epoch), training_loss, *quality))
    if quality.loss < state.best_loss:
        state.best_loss, state.best_epoch, state.best = quality.loss, state.epoch, flat_of(network)


def saved_options(checkpoint: Path) -> dict[str, Any]:
    """Return the options of a checkpoint's training; raises ValueError if there is no checkpoint."""
    try:
        return dict(torch.load(checkpoint, weights_only=True)["begun"])
    except Exception as error:  # torch has errors of its own
        raise ValueError(f"{checkpoint} is no checkpoint of a training: {str(error).splitlines()[0]}") from error


def _save(
    path: Path, state: Progress, network: Network, optimizer: torch.optim.Optimizer, begun: dict[str, Any]
) -> None:
    content = {**asdict(replace(state)), "best": torch.from_numpy(state.best.copy())}
    path.parent.mkdir(parents=True, exist_ok=True)
    kept, blob = {"network": network.state_dict(), "optimizer": optimizer.state_dict(), "begun": begun}, BytesIO()
    torch.save({"progress": content, **kept}, blob)
    write_whole(path, blob.getvalue())


def _load(path: Path, network: Network, optimizer: torch.optim.Optimizer) -> Progress:
    content = torch.load(path, weights_only=True)
    check_numbers({"best": content["progress"]["best"], **content["network"]})
    network.load_state_dict(content["network"])
    optimizer.load_state_dict(content["optimizer"])
    progress = content["progress"]
    return Progress(**{**progress, "best": progress["best"].numpy()})
