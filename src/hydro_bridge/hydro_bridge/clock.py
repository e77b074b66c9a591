# SPDX-License-Identifier: Apache-2.0
"""Clock synchronisation from box time to ROS time, through the host's monotonic clock.

::

    box time ──BoxClock: slewed──> monotonic time ──HostClock: stepped when the host's clock is set──> ROS time

A sample taken at box time b arrives at monotonic time a = b + offset + delay, and the delay is never negative. So the
smallest a - b within a window, which is finite because the two clocks drift, is the best estimate of the offset. The
estimate is slewed: stamps are strictly monotone and keep the box's sample spacing. Only when the host's clock is set do
they step with it.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field


@dataclass(kw_only=True)
class BoxClock:
    """Maps box time to the host's monotonic time; a new instance for each connection and each restart of the box."""

    window: float = 2.0
    """Window of the smallest offset [s], [0.1, 60]; at 50 ppm the clocks drift by 0.1 ms in 2 s."""
    slew: float = 0.05
    """Maximum rate of change of the offset, (0, 0.5]: 5 % is 50 us per sample."""
    _quickest: deque[tuple[int, int]] = field(default_factory=deque)
    """(box time [us], offset [ns]) with ascending offsets; the first is the smallest of the window."""
    _offset: int = 0
    _last_us: int | None = None

    def stamp(self, box_us: int, arrival_ns: int) -> int:
        """Return the monotonic time [ns] at which a sample was taken, ascending.

        `box_us`: its box time [us], ascending. `arrival_ns`: monotonic time [ns] at which it arrived.
        """
        offset, queue = arrival_ns - 1000 * box_us, self._quickest
        while queue and queue[-1][1] >= offset:
            queue.pop()
        queue.append((box_us, offset))
        while queue[0][0] < box_us - 1e6 * self.window:
            queue.popleft()
        best = queue[0][1]
        if self._last_us is None:
            self._offset = best
        else:
            room = int(1000 * max(0, box_us - self._last_us) * self.slew)
            self._offset += max(-room, min(room, best - self._offset))
        self._last_us = box_us
        return 1000 * box_us + self._offset


class HostClock:
    """Maps the host's monotonic time to ROS time, and detects when the host's clock is set.

    NTP slews both clocks alike, so that their difference changes only by steps.
    """

    STEP_MIN = 1_000_000
    """ns, change of the difference that counts as a step; the error of reading two clocks in turn is smaller."""

    def __init__(self) -> None:
        while (offset := self._read()) is None:
            pass
        self.offset = offset
        """ROS time minus monotonic time, ns."""

    def detect_step(self) -> int:
        """Return the step [ns] of the host's clock since the last call, mostly 0; call it about once per sample."""
        offset = self._read()
        if offset is None or abs(offset - self.offset) < self.STEP_MIN:
            return 0
        self.offset, step = offset, offset - self.offset
        return step

    def _read(self) -> int | None:
        """Return wall time minus monotonic time, ns; None if this thread was interrupted between the two readings."""
        before, wall = time.monotonic_ns(), time.time_ns()
        return wall - before if time.monotonic_ns() - before <= 100_000 else None
