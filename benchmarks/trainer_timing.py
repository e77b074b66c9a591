# SPDX-License-Identifier: Apache-2.0
"""How punctual the gains are while a policy learns, and how long the policy takes: on the running graph.

Starts a trainer with emulator, bridge, filter and recorder, lets it learn for a while, ends it, and reads what the
recording says: intervals between the gains' stamps against 10 ms. Beside it a process by SCHED_FIFO does nothing but
sleep a millisecond at a time: how late it wakes is how late anybody can be on this machine.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.cli.console import Table, UserError, add_json_argument, command
from hydro_bridge.ros.companion import executable_path
from hydro_bridge.ros.topics import GAINS, TRAINING
from hydro_bridge.signals import FloatArray

STEP = 0.01  # s
_PROBE_PRIORITY = 50


def sleeper(results: Connection) -> None:
    """Sleep to the next millisecond until told to end; sends how late each waking was [s]."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PROBE_PRIORITY))
    late: list[float] = []
    due = time.monotonic()
    while not results.poll():
        due += 1e-3
        time.sleep(max(due - time.monotonic(), 0.0))
        late.append(time.monotonic() - due)
    results.send(np.array(late))


def jitter(stamps: FloatArray) -> FloatArray:
    """|interval - 10 ms| [s] of gains, shape (n,); pauses of five steps and more are none."""
    intervals = np.diff(stamps)
    return np.asarray(np.abs(intervals[intervals < 5 * STEP] - STEP))


def train(folder: Path, asked: argparse.Namespace) -> dict[str, Any]:
    """Let a trainer learn for a while; the last event of its run.json."""
    words = ["--plant", "emulator", "--runs", str(folder), "--name", "run", "--from", asked.start]
    words += ["--updates-per-step", str(asked.updates_per_step)]
    words += [] if asked.record else ["--no-record"]
    ros = ["--ros-args", "-p", "warmup_steps:=100", "-p", "exam.every:=0"]
    process = subprocess.Popen([str(executable_path("hydro_policy", "trainer")), *words, *ros], start_new_session=True)
    try:
        process.wait(asked.seconds + 8.0)  # what it takes to start
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        process.wait(30.0)
    record: dict[str, Any] = json.loads((folder / "run" / "run.json").read_text())
    end: dict[str, Any] = record["events"][-1]
    if end["kind"] != "end":
        raise UserError("the trainer did not come to its end")
    return end


def row(table: Table, what: str, durations: FloatArray) -> None:
    """Percentiles [ms] of durations [s]."""
    values = 1e3 * np.percentile(durations, (50.0, 99.0, 99.9))
    names = ("p50", "p99", "p99_9")
    table.add(what=what, **dict(zip(names, map(float, values), strict=True)), max=float(1e3 * durations.max()))


def measure(asked: argparse.Namespace, folder: Path) -> Table:
    """Train beside the sleeper, and make the table."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    beside = context.Process(target=sleeper, args=(theirs,), daemon=True)
    beside.start()
    end = train(folder, asked)
    ours.send(None)
    late = ours.recv()
    columns = {"what": "", "p50": "ms", "p99": "ms", "p99_9": "ms", "max": "ms"}
    table = Table(columns, title=f"Gains at 100 Hz while a policy learns on the emulator, {os.cpu_count()} cores")
    if asked.record:
        bag = read_bag(folder / "run" / "bag")
        row(table, "jitter of the gains' stamps, from the recording", jitter(bag[GAINS]["time"]))
        told = bag[TRAINING]
        learning = told["updates"] > 0
        seconds = float(np.ptp(told["time"][learning])) if learning.any() else 0.0
        updates = int(np.ptp(told["updates"][learning])) if learning.any() else 0
        print(
            f"{updates} updates in {seconds:.0f} s: {updates / max(seconds, 1e-9) * STEP:.1f} a step", file=sys.stderr
        )
    for name in ("jitter", "inference", "response"):
        table.add(what=f"{name}, by the trainer itself", p50="", p99=1e3 * end[f"{name}_p99"], p99_9="", max="")
    row(table, "a process that only sleeps, SCHED_FIFO: how late it wakes", late)
    return table


@command()
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trainer_timing", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=40.0, help="of training, default 40")
    parser.add_argument("--updates-per-step", type=float, default=8.0, help="default 8")
    parser.add_argument("--from", dest="start", default="scratch", help="agent to start from (default scratch)")
    parser.add_argument("--no-record", dest="record", action="store_false", help="without a recorder")
    add_json_argument(parser)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measure(asked, Path(folder)).show(asked.json)


if __name__ == "__main__":
    sys.exit(main())
