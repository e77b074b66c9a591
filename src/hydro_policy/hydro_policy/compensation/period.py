# SPDX-License-Identifier: Apache-2.0
"""Period of a reference from its own past, for n benches at once.

Squared difference of the reference to itself l steps earlier, averaged over about l steps; the period is the first lag
behind one of unlike values at which it has a minimum near 0. Source: YIN (de Cheveigne, Kawahara 2002, JASA 111(4),
1917), with exponential windows and without its normalisation, as the reference has no noise.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray

LONGEST = 400
"""Policy steps, 4 s: of a period."""
LEAST_WINDOW = 50
"""Policy steps over which a difference is averaged at least."""
ALIKE, UNLIKE = 0.01, 1.0
"""Squared difference over the reference's variance: below it a lag is a period, above it values are unlike."""
_POWER = 1.0 / 300.0  # per step, of the variance


class Period:
    """Periods of the references of n benches; arrays have one row per bench."""

    def __init__(self, count: int) -> None:
        self._lags = np.arange(1, LONGEST + 1)
        self._past: FloatArray = np.zeros((count, LONGEST))  # newest first
        self._unlike: FloatArray = np.zeros((count, LONGEST))
        self._mean: FloatArray = np.zeros(count)
        self._variance: FloatArray = np.zeros(count)
        self.steps: FloatArray = np.zeros(count)
        """Period [policy steps], shape (n,); 0: none is seen."""
        self.trust: FloatArray = np.zeros(count)
        """0 to 1: how alike the reference is to itself a period earlier, shape (n,)."""

    def step(self, reference: FloatArray, age: npt.NDArray[np.int64]) -> None:
        """Take a reference per policy step, shape (n,), and how many steps it has been known for, shape (n,)."""
        change = _POWER * (age > 0)
        self._mean = np.where(age > 1, self._mean + change * (reference - self._mean), reference)
        self._variance = np.where(
            age > 1, self._variance + change * ((reference - self._mean) ** 2 - self._variance), 0
        )
        seen = age[:, np.newaxis] - self._lags  # comparisons so far
        share = 1.0 / np.clip(seen, 1.0, np.maximum(self._lags, LEAST_WINDOW))
        difference = (reference[:, np.newaxis] - self._past) ** 2
        self._unlike = np.where(seen > 0, self._unlike + share * (difference - self._unlike), 0.0)
        self._past = np.concatenate((reference[:, np.newaxis], self._past[:, :-1]), axis=1)
        self._find(seen)

    def _find(self, seen: npt.NDArray[np.int64]) -> None:
        d, power = self._unlike, self._variance[:, np.newaxis] + 1e-12
        behind = np.maximum.accumulate(d, axis=1) > UNLIKE * power
        inner = d[:, 1:-1]
        low = (inner <= d[:, :-2]) & (inner < d[:, 2:]) & (inner < ALIKE * power) & behind[:, 1:-1]
        low &= seen[:, 1:-1] > np.maximum(LEAST_WINDOW, self._lags[1:-1]) // 2
        first, rows = np.argmax(low, axis=1), np.arange(len(d))
        found = low[rows, first]
        left, middle, right = (d[rows, first + k] for k in (0, 1, 2))
        bend = left - 2.0 * middle + right
        shift = np.clip(0.5 * (left - right) / np.where(bend > 0.0, bend, 1.0), -0.5, 0.5)
        least = np.maximum(middle - 0.25 * (left - right) * shift, 0.0)
        self.steps = np.where(found, self._lags[first + 1] + shift, 0.0)
        self.trust = np.where(found, 1.0 - np.clip(least / (ALIKE * power[:, 0]), 0.0, 1.0), 0.0)


class Past:
    """Last values of n benches, `width` each, one set per policy step."""

    def __init__(self, count: int, width: int, length: int) -> None:
        self._values: FloatArray = np.zeros((count, length, width))
        self._rows, self._steps = np.arange(count), 0

    def push(self, values: FloatArray) -> None:
        """Enter the values of a step, shape (n, width)."""
        self._steps += 1
        self._values[:, self._steps % self._values.shape[1]] = values

    def at(self, back: FloatArray) -> FloatArray:
        """Return the values so many steps back, between steps by linear interpolation; shapes (n,) and (n, width)."""
        low, length = np.floor(back).astype(int), self._values.shape[1]
        between = (back - low)[:, np.newaxis]
        late, early = (self._values[self._rows, (self._steps - low - k) % length] for k in (0, 1))
        return (1.0 - between) * late + between * early
