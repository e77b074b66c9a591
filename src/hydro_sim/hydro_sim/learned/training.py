# SPDX-License-Identifier: Apache-2.0
"""How a model is trained: from runs to a `Learned`, stage by stage.

=========== =====================================================================================
network     Adam through time on all windows (the paper's way)
structured  constants identified on many short windows (`identify`), the readings' noise first
            taken for 100 times what it is, so that a poor start does not send the search astray;
            then Adam on the network alone, start states by the observer
=========== =====================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.bench import Bench
from hydro_sim.learned import adam, constants, engine, identify, observer, structured
from hydro_sim.learned.integration import STATES
from hydro_sim.learned.model import Learned, Model
from hydro_sim.learned.network_model import NetworkModel
from hydro_sim.learned.objectives import Indices, NetworkObjective, StructuredObjective, Windows
from hydro_sim.learned.recordings import READING_COLUMNS, Data, Run
from hydro_sim.learned.region import Region
from hydro_sim.learned.structured_model import StructuredModel, first_guess


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Of a training; the defaults of `network` are Table training."""

    structure: str = "structured"
    """Key of `model.STRUCTURES`."""
    hidden: tuple[int, int] = (32, 32)
    """Widths of the two hidden layers, [1, 1024]."""
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
"""The constants come identified: what is left for the network is little, and goes quickly."""

IDENTIFY_HORIZON = 150
NOISE_SCALES = (100.0, 20.0, 4.0, 1.0)
"""What the readings' noise is taken for, one after the other."""
ITERATIONS = 6  # at each of them
GUESS_SPREAD: FloatArray = np.array([2e4, 2e4, 2e-6, 5e-3, 2e-3, 1.0, 2.0, 200.0, 2e-5])
"""Of a window's start about its first guess, units of the state."""

Report = Callable[[str], None]


def start(data: Data, settings: Settings, bench: Bench) -> Model:
    """The untrained model."""
    if settings.structure == "network":
        return NetworkModel.untrained(data.training, settings.hidden, settings.seed)
    return StructuredModel.untrained(bench, data.training, settings.hidden, settings.seed)


def objective(model: Model, data: Data, settings: Settings) -> NetworkObjective | StructuredObjective:
    """What the loop minimizes."""
    training = Windows(data.training, settings.horizon, settings.stride)
    validation = Windows(data.validation, 70, 35)
    target: NetworkObjective | StructuredObjective
    if isinstance(model, NetworkModel):
        target = NetworkObjective(
            model, training, validation, batch=settings.batch, seed=settings.seed, printed=settings.printed_loss
        )
    else:
        target = StructuredObjective(model, training, validation, batch=min(settings.batch, 2048), seed=settings.seed)
    target.engine = _engine(target, engine.engines(settings.device))
    return target


def _engine(target: NetworkObjective | StructuredObjective, choice: tuple[engine.Engine, ...]) -> engine.Engine:
    """The quicker one of several, on the first batch."""
    if len(choice) > 1:
        target.refresh(target.model.flat)

    def gradient(one: engine.Engine) -> None:
        target.engine = one
        next(target.gradients(target.model.flat, 0))

    return engine.quickest(choice, gradient)


def identified(model: StructuredModel, data: Data, settings: Settings, report: Report) -> StructuredModel:
    """The model with its constants fitted to the training runs (first half of the structured training)."""
    windows = Windows(data.training, IDENTIFY_HORIZON, 1)
    chosen = np.random.default_rng(settings.seed).choice(windows.starts(), settings.identify_windows, replace=False)
    few, all_ = np.sort(chosen[::3]), np.sort(chosen)
    joined = Run(name="", x=windows.x, u=windows.u)
    model = _fit(model, windows, few, first_guess(joined, few)[:, :STATES], NOISE_SCALES, report)
    states = np.concatenate([model.estimate(run)[:, :STATES] for run in data.training])
    return _fit(model, windows, all_, states[all_], NOISE_SCALES[-2:], report)


def _fit(
    model: StructuredModel,
    windows: Windows,
    picked: Indices,
    guesses: FloatArray,
    scales: tuple[float, ...],
    report: Report,
) -> StructuredModel:
    """Constants fitted to the picked windows, their starts guessed."""
    learned = np.flatnonzero([entry.learned for entry in model.table])
    fit = identify.Fit(theta=model.theta, starts=guesses.copy())
    for scale in scales:
        noise = scale * observer.READING_NOISE
        targets = (windows.targets(picked)[:, :, READING_COLUMNS] / noise).reshape(len(picked), -1)
        readings = _readings(model, windows.currents(picked), noise)
        for _ in range(ITERATIONS):
            more = identify.improve(fit, readings, targets, guesses, GUESS_SPREAD, learned)
            if fit.costs:
                root = fit.costs[-1] ** 0.5
                report(f"identifying on {len(picked)} windows, noise taken {scale:g}-fold: error over it {root:.4f}")
            if not more:
                break
    return replace(model, theta=fit.theta)


def _readings(model: StructuredModel, currents: FloatArray, noise: FloatArray) -> identify.Readings:
    """Rollouts for `identify`."""
    _, layers, center, scale, memories = model.compiled

    def readings(theta: FloatArray, starts: FloatArray, part: slice) -> FloatArray:
        c, _ = constants.values(model.table, theta)
        full = np.zeros((len(starts), structured.FULL))
        full[:, :STATES] = starts
        x = structured.rollout(c, layers, center, scale, memories, full, np.ascontiguousarray(currents[part]))
        return (x[:, :, READING_COLUMNS] / noise).reshape(len(starts), -1)

    return readings


def trusted(model: StructuredModel, data: Data) -> StructuredModel:
    """The model with the observer's trust that predicts the validation runs best."""
    validation = Windows(data.validation, 70, 35)
    best, least = model, np.inf
    for trust in (0.03, 0.1, 0.3, 1.0, 3.0):
        tried = replace(model, trust=trust)
        check = StructuredObjective(tried, validation, validation, batch=1, seed=0)
        check.refresh(model.flat)
        error = check.validate(model.flat)
        if error < least:
            best, least = tried, error
    return best


def steps(
    model: Model, data: Data, settings: Settings, checkpoint: Path | None = None, *, resume: bool = False
) -> Iterator[tuple[adam.Progress, Model]]:
    """The loop: progress and the best model so far after every epoch; a checkpoint at every validation."""
    target = objective(model, data, settings)
    first = target.model.flat
    if resume and checkpoint is not None and checkpoint.exists():
        progress = adam.Progress.load(checkpoint, len(first))
    else:
        progress = adam.Progress.begin(first)
    for state in adam.train(target, settings.adam, progress):
        if checkpoint is not None and state.epoch % settings.adam.validate_every == 0:
            state.save(checkpoint)
        best = (
            target.at(state.best) if isinstance(target, StructuredObjective) else target.model.with_weights(state.best)
        )
        yield state, best


def finished(model: Model, data: Data, training: dict[str, object]) -> Learned:
    """The model with its region and what is known of its training."""
    x, u = np.concatenate([run.x for run in data.training]), np.concatenate([run.u for run in data.training])
    return Learned(model=model, region=Region.about(x, u), training=training)
