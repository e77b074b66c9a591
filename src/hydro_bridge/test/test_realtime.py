# SPDX-License-Identifier: Apache-2.0
"""A process of ours that spins by SCHED_FIFO ends by itself, in order if Python can still act, and else at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from hydro_core.process.realtime import CPU_TIME_HARD_LIMIT, CPU_TIME_SOFT_LIMIT
from tests.checks import ran

pytest.importorskip("rclpy")

NODE = """
import os, time
from rclpy.node import Node
from hydro_core.cli.console import command
from hydro_bridge.ros.node import request_realtime, run_node

class Spinning(Node):
    def __init__(self):
        super().__init__("spinning")
        print(request_realtime(realtime=True), flush=True)
        self.create_timer(0.01, self.spin)

    def spin(self):
        print("spins", time.monotonic(), flush=True)
        while True:
            pass

    def close(self):
        print("closed by", os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, flush=True)

command()(lambda: run_node(Spinning))()
"""
COMPILED = """
import itertools, os, time
from hydro_core.process.realtime import limit_run_time

limit_run_time()
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
print("spins", time.monotonic(), flush=True)
sum(itertools.repeat(0))  # never comes back to the interpreter
"""
needs_fifo = pytest.mark.skipif(ran("chrt", "-f", 1, "true").returncode != 0, reason="no right to SCHED_FIFO")


def run(program: str) -> tuple[subprocess.CompletedProcess[str], float]:
    """What has ended, and the seconds since its 'spins'."""
    ended = ran(sys.executable, "-c", program, timeout=60.0)
    return ended, time.monotonic() - float(ended.stdout.partition("spins ")[2].split()[0])


@needs_fifo
def test_a_node_whose_callback_spins_is_closed_and_ends_with_a_sentence() -> None:
    node, seconds = run(NODE)
    assert "SCHED_FIFO" in node.stdout
    assert f"closed by {os.SCHED_OTHER}" in node.stdout, "what puts things in order holds up nobody"
    assert node.stderr.splitlines()[-1].startswith("error: ran 1 s by SCHED_FIFO without a pause")
    assert node.returncode == 128 + signal.SIGXCPU and "Traceback" not in node.stderr
    assert CPU_TIME_SOFT_LIMIT - 0.1 < seconds < 10 * CPU_TIME_SOFT_LIMIT, (
        "CPU time is what counts; the machine may be busy"
    )


@needs_fifo
def test_a_compiled_loop_that_spins_is_killed() -> None:
    process, seconds = run(COMPILED)
    assert process.returncode == -signal.SIGKILL and seconds < 10 * CPU_TIME_HARD_LIMIT
