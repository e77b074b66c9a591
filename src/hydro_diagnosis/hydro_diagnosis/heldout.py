# SPDX-License-Identifier: Apache-2.0
"""Does the corrected model predict better? Simulated against recordings that no parameter has seen.

Windows of 70 ms are simulated from the recorded valve current. Their four initial states are estimated from the
window itself
(multiple shooting): an encoder's step is finer than any estimate of the state before it could be. The free run, half
a second, starts from the recording's smoothed state and is not touched again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.effects.base import Claim, FloatArray
from hydro_diagnosis.model import SegmentModel
from hydro_diagnosis.simulate import Indices, Plant

HORIZON = 0.07
"""s."""
FREE_RUN = 0.5
"""s."""
WINDOWS = 48
"""Windows per horizon, spread evenly over the held-out recordings."""
_STATE_SCALE = np.array([1e-6, 1e-4, 1e3, 1e3])


@dataclass(frozen=True)
class ChannelError:
    """Root mean square error of one channel."""

    unit: str
    rmse_before: float
    rmse_after: float
    noise_floor: float


def errors(
    plant: Plant, begins: Indices, length: int, noise: dict[str, float], *, shooting: bool
) -> dict[str, FloatArray]:
    """Reading minus recording, by channel, shape (length, windows)."""
    state = plant.start(begins)
    if shooting:
        state = _shoot(plant, state, begins, length, noise)
    return _apart(plant, plant.run(state, begins, length), begins)


def _apart(plant: Plant, states: FloatArray, begins: Indices) -> dict[str, FloatArray]:
    lanes = np.tile(begins, states.shape[2] // len(begins))
    at = lanes[None, :] + np.arange(states.shape[0])[:, None]
    return {name: shown - plant.model.channels[name][at] for name, shown in plant.readings(states, begins).items()}


def _shoot(plant: Plant, state: FloatArray, begins: Indices, length: int, noise: dict[str, float]) -> FloatArray:
    """Initial states by two steps of least squares per window."""
    windows = len(begins)
    for _ in range(2):
        moved = [state] + [state + _STATE_SCALE[:, None] * (np.arange(4) == j)[:, None] for j in range(4)]
        apart = _apart(plant, plant.run(np.concatenate(moved, axis=1), begins, length), begins)
        names = [name for name in apart if noise.get(name, 0.0) > 0.0]
        stacked = np.concatenate([apart[name] / noise[name] for name in names])
        stacked = stacked.reshape(len(stacked), 5, windows)
        for w in range(windows):
            slopes = stacked[:, 1:, w] - stacked[:, :1, w]
            if np.all(np.isfinite(slopes)):
                step = np.linalg.lstsq(slopes, -stacked[:, 0, w], rcond=1e-10)[0]
                state[:, w] += _STATE_SCALE * step
    return state


def compare(
    models: Sequence[SegmentModel], before: Sequence[Claim], after: Sequence[Claim], noise: dict[str, float], *,
    seconds: float, windows: int, shooting: bool,
) -> dict[str, ChannelError]:  # fmt: skip
    """Errors of both claim sets over the same windows of held-out recordings."""
    squares: dict[str, list[list[FloatArray]]] = {}
    each = max(windows // len(models), 1)
    for model in models:
        length = round(seconds / model.step)
        if len(model.segment) < model.settle + length + 50:
            continue
        begins = np.unique(np.linspace(model.settle, len(model.segment) - length - 20, each).astype(np.int64))
        for which, claims in enumerate((before, after)):
            plant = Plant.of(model, claims)
            with np.errstate(all="ignore"):
                found = errors(plant, begins, length, noise, shooting=shooting)
            for name, apart in found.items():
                squares.setdefault(name, [[], []])[which].append(np.square(apart))
    return {name: _channel(name, parts, noise.get(name, 0.0)) for name, parts in squares.items()}


def _channel(name: str, parts: list[list[FloatArray]], floor: float) -> ChannelError:
    before, after = (_rms(part) for part in parts)
    return ChannelError(_UNITS[name], before, after, floor)


def _rms(parts: list[FloatArray]) -> float:
    mean = float(np.mean(np.concatenate([part.ravel() for part in parts])))
    return float(np.sqrt(mean)) if np.isfinite(mean) else float("inf")


_UNITS = {"hydraulic_force": "N", "load_force": "N", "pressure_a": "Pa", "pressure_b": "Pa", "piston_position": "m"}
