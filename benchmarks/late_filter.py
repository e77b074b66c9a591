# SPDX-License-Identifier: Apache-2.0
"""What a filter that is late does to the valve: RMS of u' and force error while it stands still now and then.

    python -m benchmarks.late_filter --stalls 0 8 16 40 --holds 0.02 0.003 --json FILE

Emulator, bridge and filter run as processes; gains at 100 Hz are drawn from the whole wide range, as exploration does.
The filter is stopped (SIGSTOP) for so many milliseconds four times a second. `hold` is `guard.correction_hold`: for how
long a correction acts. Keys of --json: the columns.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.latency import Driver
from hydro_bridge.bags.recording import read_bag
from hydro_bridge.cli.console import Table, add_json_argument, command
from hydro_bridge.ros import Companion
from hydro_bridge.signals import SAMPLE_PERIOD, Flag, StateArray

PERIOD = 0.25  # s between the stalls
WINDOW = 100  # samples
SETTLING = 2000  # samples left out
WIDE = ("-p", "guard.delta_kp_max:=285.0", "-p", "guard.delta_ki_max:=95.0")


class Stalls:
    """Stops a process now and then."""

    def __init__(self, process: int, length: float) -> None:
        self._process, self._length, self._ended = process, length, threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while self._length and not self._ended.wait(PERIOD - self._length):
            os.kill(self._process, signal.SIGSTOP)
            time.sleep(self._length)
            os.kill(self._process, signal.SIGCONT)


def record(folder: Path, stall: float, hold: float, seconds: float) -> StateArray:
    """Run the graph; the samples of the stalls."""
    port, prompt = str(folder / "box"), ["--realtime"]
    limits = ["--ros-args", *WIDE, "-p", f"guard.correction_hold:={hold}"]
    with ExitStack() as stack:
        driver = Driver(ranges=((0.0, 0.0), (285.0, 95.0)))
        stack.callback(driver.close)
        stalled = stack.enter_context(Companion("hydro_filter", "filter", prompt))
        driver.await_node("filter", 120.0)
        stack.enter_context(Companion("hydro_bridge", "recorder", ["--out", str(folder / "bag")]))
        stack.enter_context(Companion("hydro_sim", "emulator", ["--link", port]))
        driver.await_path(folder / "box")
        stack.enter_context(Companion("hydro_bridge", "bridge", ["--port", port, *prompt, *limits]))
        driver.arm()
        with Stalls(stalled.process.pid, stall):
            driver.run(seconds)
    states = read_bag(folder / "bag").state
    return states[(states["flags"] & Flag.ARMED) > 0][SETTLING:]


def measure(stall: float, hold: float, seconds: float) -> dict[str, float]:
    """One row: worst RMS of u' in 0.1 s [A/s], force RMSE [N], share of samples at base gains for want of a filter."""
    with tempfile.TemporaryDirectory() as folder:
        states = record(Path(folder), stall, hold, seconds)
    slope = np.square(np.diff(states["valve_current"]) / SAMPLE_PERIOD)
    chatter = np.sqrt(np.convolve(slope, np.full(WINDOW, 1.0 / WINDOW), "valid"))
    error = states["reference_force"] - states["load_force"]
    stale = (states["flags"] & Flag.FILTER_STALE) > 0
    return {
        "stall_ms": 1e3 * stall,
        "hold_ms": 1e3 * hold,
        "chatter_worst": round(float(chatter.max()), 3),
        "chatter_median": round(float(np.median(chatter)), 3),
        "force_rmse": round(float(np.sqrt(np.mean(np.square(error)))), 2),
        "stale_share": round(float(stale.mean()), 4),
    }


@command()
def main() -> None:
    """Measure in turns, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.late_filter", description=__doc__)
    parser.add_argument("--stalls", type=float, nargs="+", default=[0.0, 8.0, 16.0, 40.0], metavar="MS")
    parser.add_argument("--holds", type=float, nargs="+", default=[0.02, 0.003], metavar="S")
    parser.add_argument("--seconds", type=float, default=10.0)
    add_json_argument(parser)
    asked = parser.parse_args()
    columns = {
        "stall_ms": "ms that the filter stands still, four times a second",
        "hold_ms": "ms for which a correction acts",
        "chatter_worst": "A/s, largest RMS of u' over 0.1 s",
        "chatter_median": "A/s, median of the same",
        "force_rmse": "N, of f_r - f_l",
        "stale_share": "of the samples at base gains for want of a correction",
    }
    table = Table(columns, title="A filter that stands still four times a second, gains drawn from the wide range")
    for stall in asked.stalls:
        for hold in asked.holds:
            table.add(**measure(1e-3 * stall, hold, asked.seconds))
    table.show(asked.json)


if __name__ == "__main__":
    sys.exit(main())
