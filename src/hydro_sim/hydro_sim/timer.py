# SPDX-License-Identifier: Apache-2.0
"""Periodic deadlines and exact timers, for plants that run at the pace of a clock."""

from __future__ import annotations

import ctypes
import time
from contextlib import suppress

from hydro_core.process.realtime import Latency


def disable_timer_slack() -> None:
    """Ask the kernel to wake the calling thread on time, without the default timer slack of 50 us."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None, use_errno=True).prctl(29, 1, 0, 0, 0)  # PR_SET_TIMERSLACK, 1 ns


class PeriodicTimer:
    """Periodic deadlines at start + n `period`: delays up to `catch_up_max` are caught up, longer ones are skipped.

    `period`: s between deadlines. `catch_up_max`: delay [s], as after a suspend of the machine, beyond which the lost
    time is skipped.
    """

    def __init__(self, period: float, *, catch_up_max: float = 0.1) -> None:
        self.period_ns, self._catch_up_max_ns = round(1e9 * period), round(1e9 * catch_up_max)
        self.lateness = Latency()
        self.late = 0
        """Number of periods that began more than one period late."""
        self.skipped = 0.0
        """Time [s] skipped."""
        self.restart()

    def restart(self) -> None:
        """Restart the deadlines at the present time."""
        self.deadline_ns = time.monotonic_ns()
        """ns, monotonic time at which the present period was due."""

    def wait(self) -> None:
        """Sleep until the next deadline."""
        self.deadline_ns += self.period_ns
        left = self.deadline_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(1e-9 * left)
            left = self.deadline_ns - time.monotonic_ns()
        self.lateness.add(max(0.0, -1e-9 * left))
        self.late += -left > self.period_ns
        if -left > self._catch_up_max_ns:
            self.skipped -= 1e-9 * left
            self.deadline_ns -= left
