# SPDX-License-Identifier: Apache-2.0
"""Percentiles of durations measured a thousand times a second."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

_BINS = 20_000


@dataclass
class Latency:
    """Histogram of durations in bins of 1 us up to 20 ms; longer ones count in the last bin."""

    count: int = 0
    longest: float = 0.0
    """s."""
    _bins: array[int] = field(default_factory=lambda: array("q", bytes(8 * _BINS)))  # numpy reads it in place

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self.count += 1
        self.longest = max(self.longest, seconds)
        self._bins[min(_BINS - 1, max(0, int(seconds * 1e6)))] += 1

    def percentile(self, percent: float) -> float:
        """Return the duration [s] that `percent` of all do not exceed, to 1 us; NaN without data."""
        return self._percentiles(percent)[0]

    def _percentiles(self, *percents: float) -> list[float]:
        if not self.count:
            return [float("nan")] * len(percents)
        below = np.cumsum(np.frombuffer(self._bins, np.int64))
        places = np.searchsorted(below, np.array(percents) / 100 * self.count)
        return [self.longest if place >= _BINS - 1 else (int(place) + 1) * 1e-6 for place in places]

    def sentence(self) -> str:
        """Return the percentiles in ms as text."""
        if not self.count:
            return "none"
        named = (50.0, 99.0, 99.9)
        pairs = zip(named, self._percentiles(*named), strict=True)
        shown = "  ".join(f"p{percent:g} {1e3 * value:.3f}" for percent, value in pairs)
        return f"{shown}  max {1e3 * self.longest:.3f} ms"
