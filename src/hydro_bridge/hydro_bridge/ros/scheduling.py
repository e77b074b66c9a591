# SPDX-License-Identifier: Apache-2.0
"""What a process can ask of the kernel so that a millisecond stays a millisecond."""

from __future__ import annotations

import gc
import os

PRIORITY = 20
"""Of SCHED_FIFO, [1, 99]: above all ordinary processes, below the kernel's own threads."""


def be_prompt(*, realtime: bool) -> str:
    """Take the garbage collector out of the way and, if asked, run this process by SCHED_FIFO; says what came of it.

    Call it after everything long-lived is made: the collector no longer walks it. Without the right to SCHED_FIFO
    (CAP_SYS_NICE, or rtprio in limits.conf) the process stays an ordinary one.
    """
    gc.collect()
    gc.freeze()
    if not realtime:
        return "ordinary scheduling"
    try:
        for thread in os.listdir("/proc/self/task"):  # those of the middleware too; later ones inherit it
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        return f"ordinary scheduling, SCHED_FIFO was refused: {error.strerror}"
    return f"SCHED_FIFO, priority {PRIORITY}"
