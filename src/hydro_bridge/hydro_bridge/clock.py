# SPDX-License-Identifier: Apache-2.0
"""The box's clock mapped to ROS time.

A sample taken at box time b arrives at host time a = b + offset + delay, and the delay is never negative. So the
smallest a - b within a window is the best estimate of the offset, the quickest delivery's delay included; the window
forgets, for the two clocks drift. The estimate is slewed and never stepped: stamps are strictly monotone and a
sample's spacing stays the box's.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field


@dataclass(kw_only=True)
class BoxClock:
    """Maps box time to host time."""

    window: float = 2.0
    """s of samples in which the quickest delivery is looked for, [0.1, 60]; at 50 ppm of drift 2 s are worth 0.1 ms."""
    slew: float = 0.05
    """Share of the time passed by which the offset may change, (0, 0.5]: 5 % is 50 us a sample."""
    _quickest: deque[tuple[int, int]] = field(default_factory=deque)
    """(box time [us], offset [ns]) with ascending offsets: the first is the smallest of the window."""
    _offset: int = 0
    _last_us: int | None = None

    @property
    def offset_ns(self) -> int:
        """Host time minus box time as used now, ns."""
        return self._offset

    def reset(self) -> None:
        """Forget the mapping: a new connection or a restarted box."""
        self._quickest.clear()
        self._last_us = None

    def stamp(self, box_us: int, arrival_ns: int) -> int:
        """Host time of a sample.

        Parameters
        ----------
        box_us
            Box time of the sample, us, ascending.
        arrival_ns
            Host time at which it arrived, ns.

        Returns
        -------
        Host time at which it was taken, as far as can be told, ns, ascending.
        """
        best = self._best(box_us, arrival_ns - 1000 * box_us)
        if self._last_us is None:
            self._offset = best
        else:
            room = int(1000 * max(0, box_us - self._last_us) * self.slew)
            self._offset += max(-room, min(room, best - self._offset))
        self._last_us = box_us
        return 1000 * box_us + self._offset

    def _best(self, box_us: int, offset: int) -> int:
        """Smallest offset within the window, this one included."""
        queue = self._quickest
        while queue and queue[-1][1] >= offset:
            queue.pop()
        queue.append((box_us, offset))
        while queue[0][0] < box_us - 1e6 * self.window:
            queue.popleft()
        return queue[0][1]
