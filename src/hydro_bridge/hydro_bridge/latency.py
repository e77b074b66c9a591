# SPDX-License-Identifier: Apache-2.0
"""Percentiles of a duration that is measured a thousand times a second."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

_BINS = 20_000


@dataclass
class Latency:
    """Histogram of durations in bins of 1 us up to 20 ms; what is longer falls into the last bin."""

    count: int = 0
    longest: float = 0.0
    """s."""
    _bins: list[int] = field(default_factory=lambda: [0] * _BINS)

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self.count += 1
        self.longest = max(self.longest, seconds)
        self._bins[min(_BINS - 1, max(0, int(seconds * 1e6)))] += 1

    def percentile(self, percent: float) -> float:
        """Duration [s] that `percent` of all do not exceed, to 1 us; NaN if there is none."""
        if not self.count:
            return float("nan")
        below = np.cumsum(self._bins)
        place = int(np.searchsorted(below, percent / 100 * self.count))
        return self.longest if place >= _BINS - 1 else (place + 1) * 1e-6

    def sentence(self) -> str:
        """Percentiles in ms, for people."""
        if not self.count:
            return "none"
        shown = "  ".join(f"p{percent:g} {1e3 * self.percentile(percent):.3f}" for percent in (50, 99, 99.9))
        return f"{shown}  max {1e3 * self.longest:.3f} ms"
