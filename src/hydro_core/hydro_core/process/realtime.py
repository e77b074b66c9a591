# SPDX-License-Identifier: Apache-2.0
"""Latencies, and a run-time limit that keeps SCHED_FIFO from hanging the machine.

RLIMIT_RTTIME counts the CPU time of a real-time thread since it last slept. At `CPU_TIME_SOFT_LIMIT` the kernel sends
SIGXCPU: the process drops to ordinary scheduling and ends cleanly (`Terminated`). A compiled loop, which Python cannot
interrupt, is killed at `CPU_TIME_HARD_LIMIT`; the box trips 200 ms after its last command.
"""

from __future__ import annotations

import os
import resource
import signal
import threading
from array import array
from contextlib import suppress
from dataclasses import dataclass, field
from types import FrameType

import numpy as np

from hydro_core.process.termination import Terminated

_BIN_COUNT = 20_000
CPU_TIME_SOFT_LIMIT = 1.0
"""Uninterrupted CPU time [s] at which SIGXCPU is sent: a hundred times the need of any of our processes."""
CPU_TIME_HARD_LIMIT = 3.0
"""Uninterrupted CPU time [s] at which the kernel kills the process."""


@dataclass
class Latency:
    """Histogram of durations in bins of 1 us up to 20 ms; longer ones count in the last bin."""

    count: int = 0
    longest: float = 0.0
    """Longest duration [s]."""
    _bins: array[int] = field(default_factory=lambda: array("q", bytes(8 * _BIN_COUNT)))  # numpy reads it in place

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self.count += 1
        self.longest = max(self.longest, seconds)
        self._bins[min(_BIN_COUNT - 1, max(0, int(seconds * 1e6)))] += 1

    def percentile(self, percent: float) -> float:
        """Return the `percent`-th percentile of the durations [s], to 1 us; NaN without data."""
        if not self.count:
            return float("nan")
        below = np.cumsum(np.frombuffer(self._bins, np.int64))
        place = int(np.searchsorted(below, percent / 100 * self.count))
        return self.longest if place >= _BIN_COUNT - 1 else (place + 1) * 1e-6

    def summary(self) -> str:
        """Return the 50th, 99th and 99.9th percentiles and the maximum [ms] as text; `none` without data."""
        if not self.count:
            return "none"
        shown = "  ".join(f"p{percent:g} {1e3 * self.percentile(percent):.3f}" for percent in (50.0, 99.0, 99.9))
        return f"{shown}  max {1e3 * self.longest:.3f} ms"


def limit_run_time() -> None:
    """Limit the uninterrupted run time of this process and its children under SCHED_FIFO or SCHED_RR.

    No effect under ordinary scheduling. The signal is handled if this is called in the main thread.
    """
    soft, hard = round(1e6 * CPU_TIME_SOFT_LIMIT), round(1e6 * CPU_TIME_HARD_LIMIT)
    _, limit = resource.getrlimit(resource.RLIMIT_RTTIME)
    hard = hard if limit == resource.RLIM_INFINITY else min(hard, limit)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGXCPU, _end)
    resource.setrlimit(resource.RLIMIT_RTTIME, (min(soft, hard), hard))


def drop_realtime() -> None:
    """Set this process to SCHED_OTHER at nice 0 or more, before work that must not delay others."""
    with suppress(OSError):
        for thread in map(int, os.listdir("/proc/self/task")):
            os.sched_setscheduler(thread, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, thread, max(os.getpriority(os.PRIO_PROCESS, thread), 0))


def _end(number: int, _: FrameType | None) -> None:
    drop_realtime()
    raise Terminated(number, f"ran {CPU_TIME_SOFT_LIMIT:g} s by SCHED_FIFO without a pause: it ends here")
