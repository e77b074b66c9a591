# SPDX-License-Identifier: Apache-2.0
"""Weak form: signals and derivatives seen through Gaussian test functions; nothing noisy is differentiated.

Two Gaussians follow each other. The first (1 ms) makes position, velocity and acceleration out of the recorded
position;
the second brings everything, forces computed from these and forces measured, to the same total width of 1.5 ms.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d

from hydro_diagnosis.effects.base import FloatArray

KINEMATIC_WIDTH = 1.0
"""Samples, of the Gaussian behind position, velocity and acceleration."""
TOTAL_WIDTH = 1.5
"""Samples, of the Gaussian behind every residual."""
STRIDE = 5
"""Samples between the residuals that are kept: at this distance their noise is all but independent."""


def _taps(width: float, derivative: int) -> FloatArray:
    reach = int(np.ceil(5.0 * width)) + 1
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    bell = np.exp(-0.5 * (at / width) ** 2)
    bell /= bell.sum()
    if derivative == 0:
        return bell
    shape = bell * (at if derivative == 1 else at * at - np.sum(bell * at * at))
    moment = np.sum(shape * at) if derivative == 1 else 0.5 * np.sum(shape * at * at)
    scaled: FloatArray = shape / moment
    return scaled


_KINEMATIC = tuple(_taps(KINEMATIC_WIDTH, derivative) for derivative in range(3))
_REST = _taps(float(np.sqrt(TOTAL_WIDTH**2 - KINEMATIC_WIDTH**2)), 0)
_TOTAL = _taps(TOTAL_WIDTH, 0)

TOTAL_NOISE_GAIN = float(np.sqrt(np.sum(_TOTAL**2)))
"""Standard deviation of smoothed white noise over that of the noise."""
POSITION_NOISE_GAIN = float(np.sqrt(np.sum(_KINEMATIC[0] ** 2)))
"""Standard deviation of the position over that of the encoder."""
VELOCITY_NOISE_GAIN = float(np.sqrt(np.sum(_KINEMATIC[1] ** 2)))
"""Standard deviation of the velocity times the sampling time, over that of the position."""
ACCELERATION_NOISE_GAIN = float(np.sqrt(np.sum(np.convolve(_KINEMATIC[2], _REST) ** 2)))
"""The same of the finished acceleration, times the sampling time squared."""


def kinematics(position: FloatArray, step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity, acceleration through the first Gaussian; shapes as given, `step` in s."""
    x, v, a = (correlate1d(position, taps, mode="nearest") for taps in _KINEMATIC)
    return x, v / step, a / step**2


def finish(signal: FloatArray) -> FloatArray:
    """What was computed from `kinematics`, brought to the total width."""
    return np.asarray(correlate1d(signal, _REST, mode="nearest"))


def smooth(signal: FloatArray) -> FloatArray:
    """A measured signal, brought to the total width."""
    return np.asarray(correlate1d(signal, _TOTAL, mode="nearest"))
