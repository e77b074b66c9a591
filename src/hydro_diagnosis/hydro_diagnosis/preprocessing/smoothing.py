# SPDX-License-Identifier: Apache-2.0
"""Weak form: signals and derivatives through Gaussian test functions, and the white noise in a signal.

Noisy signals are not differentiated directly. A first Gaussian (width 1 recorded row) gives position, velocity and
acceleration from the recorded position; a second brings measured forces, and forces computed from the motion, to the
same total width of 1.5 rows (1.5 ms at 1 kHz). `spacing`: samples of the box's clock per row recorded by the logger.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb

import numpy as np
import numpy.typing as npt
from scipy.ndimage import correlate1d
from scipy.signal import oaconvolve

from hydro_core.signals import FloatArray
from hydro_sim.jit import njit

KINEMATIC_WIDTH = 1.0
"""Standard deviation [recorded rows] of the Gaussian for position, velocity and acceleration."""
TOTAL_WIDTH = 1.5
"""Standard deviation [recorded rows] of the total Gaussian of every residual."""
STRIDE = 5
"""Recorded rows between the residuals that are evaluated: at this spacing their noise is nearly independent."""


@lru_cache(maxsize=64)
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


_REST_WIDTH = float(np.sqrt(TOTAL_WIDTH**2 - KINEMATIC_WIDTH**2))
_KINEMATIC_TAPS = tuple(_taps(KINEMATIC_WIDTH, derivative) for derivative in range(3))
_REST_TAPS = _taps(_REST_WIDTH, 0)
_TOTAL_TAPS = _taps(TOTAL_WIDTH, 0)

TOTAL_NOISE_GAIN = float(np.sqrt(np.sum(_TOTAL_TAPS**2)))
"""Noise gain of `smooth`: standard deviation of smoothed white noise over that of the noise."""
POSITION_NOISE_GAIN = float(np.sqrt(np.sum(_KINEMATIC_TAPS[0] ** 2)))
"""Noise gain of the position of `kinematics`, relative to the recorded position."""
VELOCITY_NOISE_GAIN = float(np.sqrt(np.sum(_KINEMATIC_TAPS[1] ** 2)))
"""Noise gain of the velocity of `kinematics`, times the sampling time, relative to the recorded position."""
ACCELERATION_NOISE_GAIN = float(np.sqrt(np.sum(np.convolve(_KINEMATIC_TAPS[2], _REST_TAPS) ** 2)))
"""Noise gain of the acceleration after `smooth_kinematic`, times the sampling time squared, relative to the recorded
position."""


def kinematics(position: FloatArray, step: float, spacing: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position [m], velocity [m/s] and acceleration [m/s2] by the first Gaussian, shape (n,) each; `step` [s]."""
    x, v, a = (_through(position, KINEMATIC_WIDTH * spacing, derivative) for derivative in range(3))
    return x, v / step, a / step**2


def second_derivative(position: FloatArray, step: float) -> FloatArray:
    """Acceleration [m/s2] by central differences of fourth order of a recorded position [m], (n,); `step` [s]."""
    weights = (-1.0 / 12.0, 4.0 / 3.0, -5.0 / 2.0, 4.0 / 3.0, -1.0 / 12.0)
    return np.asarray(correlate1d(position, np.array(weights) / step**2, mode="nearest"))


def smooth_kinematic(signal: FloatArray, spacing: int = 1) -> FloatArray:
    """Smooth a result of `kinematics` to the total width."""
    return _through(signal, _REST_WIDTH * spacing)


def smooth(signal: FloatArray, spacing: int = 1) -> FloatArray:
    """Smooth a measured signal to the total width."""
    return _through(signal, TOTAL_WIDTH * spacing)


def smooth_kinematic_at(signal: FloatArray, rows: npt.NDArray[np.int64], spacing: int = 1) -> FloatArray:
    """`smooth_kinematic` evaluated at the samples `rows` only, shape (len(rows),)."""
    return np.asarray(_correlated_at(signal, _taps(_REST_WIDTH * spacing, 0), rows))


def smooth_at(signal: FloatArray, rows: npt.NDArray[np.int64], spacing: int = 1) -> FloatArray:
    """`smooth` evaluated at the samples `rows` only, shape (len(rows),)."""
    return np.asarray(_correlated_at(signal, _taps(TOTAL_WIDTH * spacing, 0), rows))


@njit
def _correlated_at(signal, taps, rows):
    reach, last = len(taps) // 2, len(signal) - 1
    found = np.empty(len(rows))
    for k in range(len(rows)):
        total, first = 0.0, rows[k] - reach
        if first >= 0 and rows[k] + reach <= last:
            for j in range(len(taps)):
                total += taps[j] * signal[first + j]
        else:
            for j in range(len(taps)):
                total += taps[j] * signal[min(max(first + j, 0), last)]
        found[k] = total
    return found


def _through(signal: FloatArray, width: float, derivative: int = 0) -> FloatArray:
    taps = _taps(width, derivative)
    if len(taps) <= 60:  # longer filters are faster by FFT
        return np.asarray(correlate1d(signal, taps, mode="nearest"))
    reach = len(taps) // 2
    return np.asarray(oaconvolve(np.pad(signal, reach, mode="edge"), taps[::-1], mode="valid"))


def white_noise(signal: FloatArray, recorded: npt.NDArray[np.bool_] | None = None) -> float:
    """Standard deviation of the white noise in a signal, robust against rare jumps; `recorded`: mask, None for all."""
    order = 6
    differences = np.diff(signal, order) / sum(comb(order, k) ** 2 for k in range(order + 1)) ** 0.5
    if recorded is not None:
        differences = differences[np.lib.stride_tricks.sliding_window_view(recorded, order + 1).all(axis=1)]
        if not len(differences):
            return white_noise(signal)
    middle = float(np.median(np.abs(differences)))
    limit = 6.0 * middle if middle > 0.0 else np.inf  # at low speed an encoder mostly repeats its value
    kept = differences[np.abs(differences) <= limit]
    return float(np.sqrt(np.mean(np.square(kept)))) if len(kept) else 0.0
