# SPDX-License-Identifier: Apache-2.0
"""Detection of unpredictable held-out windows, whose outcome is decided by the uncertainty of the initial state.

Whether dry friction stops the piston, and when it breaks loose, can hang on a pressure that no sensor resolves. Two
runs of one model, both from starts that the sensors allow, then end far apart, and neither says anything against the
model. A window counts as such only if its error stands out, the model's own outcomes scatter by as much, and by far
more than in its other windows: where a wrong model is off by more than it scatters, or everywhere, the error stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.model.simulation import Plant
from hydro_diagnosis.model.window_memory import Indices
from hydro_diagnosis.preprocessing.smoothing import POSITION_NOISE_GAIN, TOTAL_NOISE_GAIN, VELOCITY_NOISE_GAIN

STANDS_OUT = 2.0
"""Error of a window from which it is examined [noise floors, root mean square over channels]."""
OF_THE_ERROR = 0.5
"""Share of a window's error that the scatter of the model's own outcomes must reach."""
UNSTEADY = 3.0
"""Multiple of the median over the windows that it must reach, too: some scatter goes with the search for the start."""
MOST = 0.25
"""Share of the windows that may be left out; a model that leaves more open is judged by all of them."""
DRAWS = 8
"""Starts per window."""


@dataclass(frozen=True)
class Window:
    """A stretch of a held-out recording."""

    recording: str
    start: float
    """s since the start of the recording."""


def unpredictable(
    plant: Plant, state: FloatArray, begins: Indices, length: int, noise: dict[str, float], apart: dict[str, FloatArray]
) -> npt.NDArray[np.bool_]:
    """Return whether the uncertainty of its start explains each window's error, shape (windows,).

    `state`: the start of each window, shape (4, windows); `apart`: reading minus recording from there, by channel.
    """
    error = _size(apart, noise)
    if not np.any(error > STANDS_OUT):
        return np.zeros(len(begins), dtype=bool)
    scatter = _scatter(plant, state, begins, length, noise)
    enough = np.maximum(OF_THE_ERROR * error, UNSTEADY * np.nanmedian(scatter))
    return np.asarray((error > STANDS_OUT) & (scatter >= enough))


def _scatter(plant: Plant, state: FloatArray, begins: Indices, length: int, noise: dict[str, float]) -> FloatArray:
    """Root mean square of how far outcomes of drawn starts are from that of the start itself, noise floors."""
    moved = np.random.default_rng(0).standard_normal((DRAWS, *state.shape)) * _doubt(plant, noise)[:, None]
    starts = np.concatenate([state[None], state + moved]).transpose(1, 0, 2).reshape(4, -1)
    shown = plant.readings(plant.run(starts, begins, length), begins)
    each = {name: one.reshape(length, DRAWS + 1, len(begins)) for name, one in shown.items()}
    return _size({name: (one[:, 1:] - one[:, :1]).reshape(-1, len(begins)) for name, one in each.items()}, noise)


def _doubt(plant: Plant, noise: dict[str, float]) -> FloatArray:
    """Standard deviation [m, m/s, Pa, Pa] of a state as the sensors give it at one instant, smoothed."""
    position, step = noise.get("piston_position", 0.0), plant.model.step * plant.model.spacing
    pressures = (TOTAL_NOISE_GAIN * noise.get("pressure_" + chamber, 0.0) for chamber in "ab")
    return np.array([POSITION_NOISE_GAIN * position, VELOCITY_NOISE_GAIN * position / step, *pressures])


def _size(apart: dict[str, FloatArray], noise: dict[str, float]) -> FloatArray:
    """Root mean square per window over time and channels, noise floors."""
    squares = [np.mean(np.square(one / noise[name]), axis=0) for name, one in apart.items() if noise.get(name, 0.0)]
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))
