# SPDX-License-Identifier: Apache-2.0
"""A limit on uninterrupted run time, so that a SCHED_FIFO process cannot hang the machine.

A real-time thread that spins leaves its core to nobody, not even to the shell that would end it. RLIMIT_RTTIME counts
the CPU time of a real-time thread since it last slept. At `RUN_MAX` the kernel sends SIGXCPU: the process becomes an
ordinary one and ends in order (`RanTooLong`). What is beyond Python's reach then, a compiled loop, is killed at
`KILLED_AT`; the box trips 200 ms after its last command.
"""

from __future__ import annotations

import os
import resource
import signal
import threading
from contextlib import suppress
from types import FrameType

from hydro_bridge.process.endings import Ended

RUN_MAX = 1.0
"""s of CPU on end, a hundred times what any of our processes needs."""
KILLED_AT = 3.0
"""s."""


class RanTooLong(Ended):
    """A real-time process ran too long without blocking: something in it spins."""


def limit_run() -> None:
    """Limit how long this process, and all that it starts, may run on end by SCHED_FIFO or SCHED_RR.

    Without effect on ordinary scheduling. The signal is answered where this is called in the main thread.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    most = round(1e6 * KILLED_AT) if hard == resource.RLIM_INFINITY else min(hard, round(1e6 * KILLED_AT))
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGXCPU, _end)
    resource.setrlimit(resource.RLIMIT_RTTIME, (min(round(1e6 * RUN_MAX), most), most))


def drop_realtime() -> None:
    """Leave SCHED_FIFO: what comes now (plots, files) shall hold up nobody."""
    with suppress(OSError):
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))


def _end(number: int, _: FrameType | None) -> None:
    drop_realtime()
    raise RanTooLong(number, f"ran {RUN_MAX:g} s by SCHED_FIFO without a pause: something in it spins; it ends here")
