# SPDX-License-Identifier: Apache-2.0
"""Relations between two channels: correlation, slope and delay.

Slow means (10 ms) for signs and sizes, rates of change for times: neither noise nor the dynamics of sensors and valve
weigh in them.
"""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import FloatArray

MEAN = 0.01
"""s, over which signs and sizes are averaged."""
RATE = 0.02
"""s, over which a rate of change is taken."""
REACH = 0.15
"""s, the longest delay that is looked for."""


VALLEY = 0.2
"""Drop of the correlation that separates two peaks."""


def slow(values: FloatArray, step: float) -> FloatArray:
    """Means over `MEAN`, shape (n // samples,)."""
    samples = max(round(MEAN / step), 1)
    count = len(values) // samples
    return np.asarray(values[: count * samples].reshape(count, samples).mean(axis=1))


def correlation(one: FloatArray, other: FloatArray, besides: FloatArray | None = None) -> float:
    """Pearson's, of what is left of both without `besides`; 0 where one of them does not move."""
    if besides is not None:
        one, other = _without(one, besides), _without(other, besides)
    one, other = one - one.mean(), other - other.mean()
    size = float(np.sqrt(np.dot(one, one) * np.dot(other, other)))
    return float(np.dot(one, other)) / size if size > 0.0 else 0.0


def slope(dependent: FloatArray, on: FloatArray) -> float:
    """Least squares; 0 where nothing moves."""
    on = on - on.mean()
    size = float(np.dot(on, on))
    return float(np.dot(on, dependent - dependent.mean())) / size if size > 0.0 else 0.0


def follows(leader: FloatArray, follower: FloatArray, step: float) -> tuple[float, float]:
    """Time in s by which `follower` moves after `leader` (negative: before), and the correlation of their rates then.

    Both are 0 where that cannot be said: nothing moves, or a swing comes again within `REACH`.
    """
    one, other = _rate(leader, step), _rate(follower, step)
    one, other = one - one.mean(), other - other.mean()
    size = float(np.sqrt(np.dot(one, one) * np.dot(other, other)))
    reach = min(round(REACH / step), len(one) - 1)
    if size == 0.0 or reach < 1:
        return 0.0, 0.0
    length = 1 << (2 * len(one) - 1).bit_length()
    products = np.fft.irfft(np.fft.rfft(other, length) * np.conj(np.fft.rfft(one, length)), length)
    near = np.concatenate([products[-reach:], products[: reach + 1]]) / size
    best = int(np.argmax(near))
    if _again(near, best):
        return 0.0, 0.0
    return (best - reach + _vertex(near, best)) * step, float(near[best])


def _again(values: FloatArray, at: int) -> bool:
    """Return whether there is a second peak, nearly as high, beyond a valley."""
    low = np.flatnonzero(values < values[at] - VALLEY)
    left, right = low[low < at], low[low > at]
    beyond = [values[: left[-1]] if len(left) else values[:0], values[right[0] :] if len(right) else values[:0]]
    return any(len(part) and float(part.max()) > values[at] - 0.5 * VALLEY for part in beyond)


def _vertex(values: FloatArray, at: int) -> float:
    """Position of the peak, near `at`, of the parabola through three values."""
    if at in (0, len(values) - 1):
        return 0.0
    left, middle, right = values[at - 1 : at + 2]
    bend = left - 2.0 * middle + right
    return float(0.5 * (left - right) / bend) if bend < 0.0 else 0.0


def _rate(values: FloatArray, step: float) -> FloatArray:
    samples = max(round(RATE / step), 2)
    sums = np.concatenate([[0.0], np.cumsum(values - values[0])])
    means = (sums[samples:] - sums[:-samples]) / samples
    return np.asarray(means[samples:] - means[:-samples])


def _without(values: FloatArray, besides: FloatArray) -> FloatArray:
    matrix = np.column_stack([besides, np.ones(len(besides))])
    return np.asarray(values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0])
