# SPDX-License-Identifier: Apache-2.0
"""Periodic execution against absolute deadlines."""

from __future__ import annotations

import contextlib
import ctypes
import time

from hydro_bridge.link.clock import HostClock
from hydro_bridge.process.latency import Latency

_PR_SET_TIMERSLACK = 29


class Pacer:
    """Deadlines at start + n period; delays are caught up, unless they are long.

    Parameters
    ----------
    period
        s between deadlines.
    give_up
        Delay [s] (the machine slept) from which on the lost time is not caught up, but skipped.
    """

    def __init__(self, period: float, *, give_up: float = 0.1) -> None:
        self.period_ns, self._give_up_ns = round(1e9 * period), round(1e9 * give_up)
        self.lateness = Latency()
        self.late = 0
        """Periods that began more than a period late."""
        self.skipped = 0.0
        """Time [s] skipped."""
        self.host_clock = HostClock()
        self.restart()

    def restart(self) -> None:
        """Let the first deadline be now."""
        self._deadline = time.monotonic_ns()

    @property
    def scheduled_ns(self) -> int:
        """ROS time [ns] at which the present period was due, without the jitter of waking up."""
        return self.host_clock.ros_time(self._deadline)

    def wait(self) -> None:
        """Sleep until the next deadline."""
        self._deadline += self.period_ns
        left = self._deadline - time.monotonic_ns()
        if left > 0:
            time.sleep(1e-9 * left)
            left = self._deadline - time.monotonic_ns()
        self.lateness.add(max(0.0, -1e-9 * left))
        self.late += -left > self.period_ns
        if -left > self._give_up_ns:
            self.skipped -= 1e-9 * left
            self._deadline -= left


def exact_timers() -> None:
    """Ask the kernel to wake the calling thread on time, without the default timer slack of 50 us."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)  # ns
