# SPDX-License-Identifier: Apache-2.0
"""Laws and tables of the sensors as effects: what a reading shows more than its signal, and how that is undone."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import FloatArray, Memory, Values
from hydro_diagnosis.effects.closure_terms import Closure
from hydro_sim.model.law_signals import sensed

_INVERSIONS = 6
"""Iterations that find a signal from its reading: each leaves the part of the error that is not a straight line."""
_FOUND = 1e-6
"""Pa: what is left of an error that is as good as nothing."""
_CURVE = 2000
"""Places over the range of a reading at which a curve is inverted."""
_BEYOND = 0.5
"""Share of its range by which a signal may lie outside what its curved reading spans."""


class SensorClosure(Closure):
    """What a sensor shows more than its signal."""

    @property
    def bends(self) -> bool:
        return self.law.where in (self.law.uses or self.law.where)

    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel != self.law.where:
            return signal
        at = sensed(channel, signal, memory.beside)
        return signal + self.given(self._remembering(at, memory, values), values)


class GaugeClosure(SensorClosure):
    """What a pressure sensor shows more than the pressure, which the flows follow."""

    @property
    def bends(self) -> bool:
        """A curve is taken by its slope where the reading says that it is."""
        return False

    @property
    def curves(self) -> str:
        along = self.element is not None and self.element.kind in ("path", "lag")
        return self.law.where if self.law.where in (self.law.uses or self.law.where) and not along else ""

    @property
    def _recalls(self) -> bool:
        """Whether its own signal's past counts."""
        return self.element is not None and self.element.signal == self.law.where

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel == self.law.where and self.element is None and self.curves and self.law.uses <= {channel}:
            return self._straightened(reading, values)
        signal = reading
        for _ in range(_INVERSIONS if channel == self.law.where else 0):
            at, before = sensed(channel, signal, memory.beside), signal
            signal = reading - self.given(self._remembering(at, memory, values), values)
            if not (self.curves or self._recalls) or float(np.max(np.abs(signal - before))) < _FOUND:
                break
        return signal

    def _straightened(self, reading: FloatArray, values: Values) -> FloatArray:
        """The signal under a curve of it alone; where a reading stays, the least that shows it."""
        low, high = float(np.min(reading)), float(np.max(reading))
        beyond = _BEYOND * max(high - low, 1.0)
        signal = np.linspace(low - beyond, high + beyond, _CURVE)
        shown = signal + self.given(sensed(self.law.where, signal), values)
        rising = np.maximum.accumulate(shown)
        risen = np.concatenate([[True], np.diff(rising) > 0.0])
        return np.asarray(np.interp(reading, rising[risen], signal[risen]))


class PlaceClosure(SensorClosure):
    """What the position sensor shows more than the position, on which all equations depend."""

    @property
    def bends(self) -> bool:
        return True

    @property
    def places(self) -> bool:
        return True

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        signal = reading
        for _ in range(_INVERSIONS if channel == self.law.where else 0):
            at = sensed(channel, signal, memory.beside)
            signal = reading - self.given(self._remembering(at, memory, values), values)
            if "position" not in self.law.uses:
                break
        return signal


class SnubberClosure(SensorClosure):
    """A pressure sensor that follows rises and falls at different rates."""

    @property
    def rounds(self) -> str:
        return self.law.where

    @property
    def turns(self) -> bool:
        return True

    @property
    def bends(self) -> bool:
        return True

    def measure(self, channel: str, signal: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel != self.law.where:
            return signal
        late = memory.turning(signal, values["rising"], values["falling"])
        return signal + values["coefficient"] * (late - signal)

    def unmeasure(self, channel: str, reading: FloatArray, memory: Memory, values: Values) -> FloatArray:
        if channel != self.law.where:
            return reading
        led = memory.lead(reading, 1.0, 0.0) - reading  # the slope, times 1 s
        return reading + values["coefficient"] * led * np.where(led > 0.0, values["rising"], values["falling"])
