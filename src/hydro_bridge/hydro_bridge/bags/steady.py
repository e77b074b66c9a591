# SPDX-License-Identifier: Apache-2.0
"""Times of a recording whose clock was set, or which stood still for long: they go on behind the message before."""

from __future__ import annotations

import numpy as np

from hydro_core.signals import FloatArray

BACK = 0.1
"""s by which messages of two topics may be out of order; more is a clock that was set back."""


class SteadyTimes:
    """Makes times without jumps of stamps that may have some.

    `ahead`: s from one message to the next beyond which the clock was set, or nothing was recorded that is worth
    waiting for or showing.
    """

    def __init__(self, ahead: float) -> None:
        self._ahead, self._offset = ahead, 0.0
        self._last: float | None = None
        self.jumps: list[tuple[float, float]] = []
        """Time on the steady clock, and step, of each jump [s]."""

    def take(self, stamps: FloatArray) -> FloatArray:
        """Return the times [s] of the next messages by their stamps [s], both of shape (n,)."""
        if not len(stamps):
            return stamps
        steps = np.diff(stamps, prepend=stamps[0] if self._last is None else self._last)
        jumps = (steps < -BACK) | (steps > self._ahead)
        offsets = self._offset - np.cumsum(np.where(jumps, steps, 0.0))
        self._last, self._offset = float(stamps[-1]), float(offsets[-1])
        times: FloatArray = stamps + offsets
        self.jumps += zip(times[jumps].tolist(), steps[jumps].tolist(), strict=True)
        return times
