# SPDX-License-Identifier: Apache-2.0
"""Monotonic times for a recording whose clock was set, or that has long gaps."""

from __future__ import annotations

import numpy as np

from hydro_core.signals import FloatArray

BACKWARD_TOLERANCE = 0.1
"""Tolerated disorder [s] between messages of two topics; a larger step back means that the clock was set."""


class MonotonicTimes:
    """Converts stamps into monotonic times: jumps of the clock are removed and recorded.

    `ahead`: s between two messages beyond which a gap counts as a jump and is removed, too.
    """

    def __init__(self, ahead: float) -> None:
        self._ahead, self._offset = ahead, 0.0
        self._last: float | None = None
        self.jumps: list[tuple[float, float]] = []
        """Monotonic time and step [s] of each jump."""

    def convert(self, stamps: FloatArray) -> FloatArray:
        """Return the monotonic times [s] of the next messages from their stamps [s], both of shape (n,)."""
        if not len(stamps):
            return stamps
        steps = np.diff(stamps, prepend=stamps[0] if self._last is None else self._last)
        jumps = (steps < -BACKWARD_TOLERANCE) | (steps > self._ahead)
        offsets = self._offset - np.cumsum(np.where(jumps, steps, 0.0))
        self._last, self._offset = float(stamps[-1]), float(offsets[-1])
        times: FloatArray = stamps + offsets
        self.jumps += zip(times[jumps].tolist(), steps[jumps].tolist(), strict=True)
        return times
