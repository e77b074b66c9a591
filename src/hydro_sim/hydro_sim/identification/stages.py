# SPDX-License-Identifier: Apache-2.0
"""Stages of fitting the structured model's constants: windows, weights, observer.

`identify` has the search itself. Readings are first weighted by 100 times their noise, so that a poor start does not
mislead the search. Where the model then leaves more than noise, readings are weighted by the remaining error and the
constants fitted anew, until that settles: the likelihood of five unknown variances. By noise alone, the finest reading
would decide everything as soon as the bench deviates from this structure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.files.recordings import READING_COLUMNS, Data, Run
from hydro_sim.identification import identify
from hydro_sim.identification.objectives import Indices, StructuredObjective, Windows
from hydro_sim.structured import constants, observer, rollout
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.model import StructuredModel, first_guess

IDENTIFY_HORIZON = 150
NOISE_SCALES = (100.0, 20.0, 4.0, 1.0)
"""Multiples of the readings' noise by which they are weighted, in order."""
ITERATIONS = 6  # at each of them
REWEIGHTINGS = 4
"""Largest number of times that readings are reweighted by their remaining error."""
SETTLED_LEFT = 0.1
"""Change of the remaining error's logarithm below which it counts as settled."""
REWEIGHTED_ITERATIONS = 12
GUESS_SPREAD: FloatArray = np.array([2e4, 2e4, 2e-6, 5e-3, 2e-3, 1.0, 2.0, 200.0, 2e-5])
"""Standard deviation of a window's start about its first guess, units of the state."""

Report = Callable[[str], None]


def fit_constants(model: StructuredModel, data: Data, count: int, seed: int, report: Report) -> StructuredModel:
    """Fit the model's constants to `count` windows of the training runs, and tune its observer."""
    windows = Windows(data.training, IDENTIFY_HORIZON, 1)
    chosen = np.random.default_rng(seed).choice(windows.starts(), count, replace=False)
    few, all_ = np.sort(chosen[::3]), np.sort(chosen)
    joined = Run(name="", x=windows.x, u=windows.u)
    model = _fit(model, windows, few, first_guess(joined, few)[:, :STATES], NOISE_SCALES, ITERATIONS, report)
    rounds = [(NOISE_SCALES[-2:], ITERATIONS)] + REWEIGHTINGS * [(NOISE_SCALES[-1:], REWEIGHTED_ITERATIONS)]
    for scales, iterations in rounds:
        states = np.concatenate([model.estimate(run)[:, :STATES] for run in data.training])
        model = tune_observer(_fit(model, windows, all_, states[all_], scales, iterations, report), data)
        before, model = model.left, replace(model, left=prediction_rms(model, data))
        report(f"left of the readings, over their noise: {model.left / observer.READING_NOISE}")
        if np.abs(np.log(model.left / before)).max() < SETTLED_LEFT:
            break
    return model


def prediction_rms(model: StructuredModel, data: Data) -> FloatArray:
    """RMS prediction error of each reading on the validation runs, shape (5,), at least the noise."""
    check = _validation(model, data)
    return np.asarray(np.maximum(check.errors(model.flat), observer.READING_NOISE))


def _validation(model: StructuredModel, data: Data) -> StructuredObjective:
    validation = Windows(data.validation, 70, 35)
    check = StructuredObjective(model, validation, validation, batch=1, seed=0)
    check.refresh(model.flat)
    return check


def _fit(
    model: StructuredModel,
    windows: Windows,
    picked: Indices,
    guesses: FloatArray,
    scales: tuple[float, ...],
    iterations: int,
    report: Report,
) -> StructuredModel:
    """Constants fitted to the picked windows, their starts guessed."""
    learned = np.flatnonzero([entry.learned for entry in model.table])
    fit = identify.Fit(theta=model.theta, starts=guesses.copy())
    for scale in scales:
        noise = scale * model.left
        targets = (windows.targets(picked)[:, :, READING_COLUMNS] / noise).reshape(len(picked), -1)
        readings = _readings(model, windows.currents(picked), noise)
        for _ in range(iterations):
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
        full = np.zeros((len(starts), rollout.FULL))
        full[:, :STATES] = starts
        x = rollout.rollout(c, layers, center, scale, memories, full, np.ascontiguousarray(currents[part]))
        return (x[:, :, READING_COLUMNS] / noise).reshape(len(starts), -1)

    return readings


def tune_observer(model: StructuredModel, data: Data) -> StructuredModel:
    """Tune the observer's trust for the best predictions of the validation runs, each reading on its own scale."""
    best, least = model, np.inf
    for trust in (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0):
        tried = replace(model, trust=trust)
        error = float(np.mean(np.log(_validation(tried, data).errors(tried.flat))))
        if error < least:
            best, least = tried, error
    return best
