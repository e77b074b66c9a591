# SPDX-License-Identifier: Apache-2.0
"""Elements with memory along many windows side by side: one column each, time down the first axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.model.memory import RecordMemory, amplifier

Indices = npt.NDArray[np.int64]
"""Samples at which windows begin."""


class ColumnMemory(RecordMemory):
    """A record memory whose time runs down the first axis, one column per window."""

    def low_pass(self, key: str, signal: FloatArray, bandwidth: float, damping: float) -> FloatArray:
        """See `RecordMemory`."""
        numerator, denominator = amplifier(round(bandwidth, 9), round(damping, 9), self.step)
        state = np.cumsum((numerator - denominator)[::-1])[::-1][1:, None] * signal[0]
        passed, _ = lfilter(numerator, denominator, signal, axis=0, zi=state)
        return np.asarray(passed, dtype=np.float64)

    def lag(
        self, key: str, signal: FloatArray, time_constant: float, start: float | None = None,
        falling: float | None = None,
    ) -> FloatArray:  # fmt: skip
        """See `RecordMemory`."""
        single = super().lag
        return np.apply_along_axis(lambda column: single(key, column, time_constant, start, falling), 0, signal)

    def turning(self, signal: FloatArray, rising: float, falling: float) -> FloatArray:
        """See `RecordMemory`."""
        return np.apply_along_axis(lambda column: super(ColumnMemory, self).turning(column, rising, falling), 0, signal)


class WindowMemory(ColumnMemory):
    """A column memory of windows that begin along a record, in the states in which it left what remembers."""

    def __init__(self, step: float, beside: Mapping[str, FloatArray], traces: dict[str, FloatArray],
                 at: Indices) -> None:  # fmt: skip
        super().__init__(step, beside)
        self._along, self._at = traces, at

    def lag(
        self, key: str, signal: FloatArray, time_constant: float, start: float | None = None,
        falling: float | None = None,
    ) -> FloatArray:  # fmt: skip
        """A slow state is the record's."""
        return self._along[key][self._at]

    def bristle(self, key: str, position: FloatArray, stiffness: float, limit: FloatArray) -> FloatArray:
        """See `RecordMemory`."""
        force, where = (self._along[name][self._at[0]] for name in (key, key + ".x"))
        course = np.empty_like(position)
        for k, now in enumerate(position):
            moved, where = now - where, now
            goal = np.sign(moved) * limit[k]
            course[k] = force = goal + (force - goal) * np.exp(-stiffness * np.abs(moved) / np.maximum(limit[k], 1e-6))
        return course
