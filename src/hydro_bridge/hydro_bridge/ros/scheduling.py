# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling of a process."""

from __future__ import annotations

import gc
import os

from hydro_bridge.process.realtime import limit_run

PRIORITY = 20
"""Priority under SCHED_FIFO, [1, 99]: above all ordinary processes, below the kernel's own threads."""


def request_realtime(*, realtime: bool, priority: int = PRIORITY, inherited: bool = True) -> str:
    """Freeze the garbage collector and, if requested, switch to SCHED_FIFO; returns a sentence with the outcome.

    Call it after all long-lived objects are created, which the collector then skips. Without permission for SCHED_FIFO
    (CAP_SYS_NICE, or rtprio in limits.conf) the process keeps ordinary scheduling. A process that never blocks under it
    is ended (`hydro_bridge.process.realtime`).

    Parameters
    ----------
    realtime
        Request SCHED_FIFO.
    priority
        Priority under SCHED_FIFO.
    inherited
        False: processes and threads started later use ordinary scheduling (SCHED_RESET_ON_FORK).
    """
    gc.collect()
    gc.freeze()
    if not realtime:
        return "ordinary scheduling"
    limit_run()
    policy = os.SCHED_FIFO if inherited else os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        for thread in os.listdir("/proc/self/task"):  # the middleware's threads as well
            os.sched_setscheduler(int(thread), policy, os.sched_param(priority))
    except OSError as error:
        return f"ordinary scheduling, SCHED_FIFO was refused: {error.strerror}"
    return f"SCHED_FIFO, priority {priority}"
