# SPDX-License-Identifier: Apache-2.0
"""What the live page costs, and how soon it disarms: the graph of `benchmarks.latency` with no dashboard and with one.

By turns, a new graph each time: without a dashboard, with one that has 0, 1 and 3 viewers, which read all that they are
sent, and with one that joins while the plant is armed. Then clicks on disarm in a headless Chromium, if there is one.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from benchmarks._report import parser
from benchmarks.latency import Driver, cpu_seconds, start
from hydro_bridge.bags.recording import continuity, read_bag
from hydro_bridge.cli.console import Table, UserError, command
from hydro_bridge.ros.companion import executable_path
from hydro_bridge.signals import Flag

COLUMNS = {
    "dashboard": "whether one runs, and how many look",
    "p50": "box frame in to correction frame out [ms], as the bridge counts it since it started",
    "p99": "the same",
    "lost": "sequence numbers missing in the recording",
    "stale": "samples without a correction of the last 20 ms (FILTER_STALE), while measured",
    "late": "samples with commands older than 50 ms (WATCHDOG), while measured",
    "cpu": "of the dashboard [% of a core]",
    "load": "load average of the machine over the last minute",
}
JOINS = -1
CASES = (None, 0, 1, 3, JOINS)
"""Viewers; None: no dashboard; JOINS: one that comes while the plant is armed."""


def launched() -> subprocess.Popen[str]:
    """The process of a dashboard on any free port."""
    words = [str(executable_path("hydro_bridge", "dashboard")), "--port", "0"]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


@contextmanager
def dashboard() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A dashboard on any free port, and its address with the token."""
    process = launched()
    try:
        assert process.stdout is not None
        found = re.search(r"http://\S+:\d+/#token=\S+", process.stdout.readline())
        if not found:
            raise UserError("the dashboard did not start")
        yield process, found[0]
    finally:
        process.kill()
        process.communicate()


@contextmanager
def viewers(address: str, count: int) -> Iterator[None]:
    """Let so many look. What a browser draws is not the dashboard's work, so these only read."""
    with ExitStack() as stack:
        for _ in range(count):
            page = stack.enter_context(connect(address.partition("#")[0].replace("http", "ws") + "live"))
            threading.Thread(target=_read, args=(page,), daemon=True).start()
        yield


def _read(page: ClientConnection) -> None:
    try:
        for _ in page:
            pass
    except ConnectionClosed:
        return


def cost(looking: int | None, seconds: float, folder: Path) -> dict[str, object]:
    """One graph with so many viewers: a row of the table."""
    with ExitStack() as stack:
        driver = Driver()
        stack.callback(driver.close)
        process = None
        if looking is not None and looking != JOINS:
            process, address = stack.enter_context(dashboard())
            stack.enter_context(viewers(address, looking))
        start(stack, driver, folder, metric=["--metric", "learned"], realtime=True)
        driver.run(2.0)
        if looking == JOINS:
            stack.callback(launched().kill)
        begin, before = time.monotonic(), cpu_seconds(process.pid) if process else 0.0
        driver.run(seconds)
        share = (cpu_seconds(process.pid) - before) / (time.monotonic() - begin) if process else float("nan")
        driver.run(1.2)  # the last diagnostics
    told = driver.told.get("bridge", {}).get("state in to correction out", "not told")
    found = re.search(r"p50 (\S+)\s+p99 (\S+)", told)
    if not found:
        raise UserError(f"the bridge does not say how soon corrections leave: {told}")
    states = read_bag(folder / "bag").state
    flags = states["flags"][states["time"] > states["time"][-1] - seconds - 1.0]
    return {
        "dashboard": {None: "none", JOINS: "joins"}.get(looking, f"{looking} viewers"),
        "p50": float(found[1]),
        "p99": float(found[2]),
        "lost": continuity(states).lost,
        "stale": int(np.count_nonzero(flags & Flag.FILTER_STALE)),
        "late": int(np.count_nonzero(flags & Flag.WATCHDOG)),
        "cpu": 100.0 * share,
        "load": os.getloadavg()[0],
    }


def disarmed_after(clicks: int) -> list[float]:
    """From each click on disarm to the first sample with valve current 0 [ms]; none where no browser is installed."""
    from tests.attacks import defended  # with selenium, which only tests need
    from tests.browser import MISSING, browser

    if MISSING:
        print(f"no clicks: {MISSING}")
        return []
    found = []
    with ExitStack() as stack:
        graph = stack.enter_context(defended(Path(stack.enter_context(tempfile.TemporaryDirectory()))))
        _, address = stack.enter_context(dashboard())
        page = stack.enter_context(browser(Path(stack.enter_context(tempfile.TemporaryDirectory()))))
        page.open(address)
        for _ in range(clicks):
            graph.arm()
            page.wait("document.getElementById('state').textContent == 'ARMED'", meanwhile=lambda: graph.drive(0.05))
            graph.probe.forget()
            clicked = page.click("disarm")
            graph.drive(0.5)
            found.append(1e3 * (graph.valve_closed_at() - clicked))
    return found


@command()
def main() -> None:
    """Measure, print, write."""
    options = parser("dashboard", __doc__)
    options.add_argument("--seconds", type=float, default=10.0, help="of each measurement (default 10)")
    options.add_argument("--rounds", type=int, default=2, help="of each number of viewers (default 2)")
    options.add_argument("--clicks", type=int, default=20, help="on disarm (default 20; 0: no browser)")
    asked = options.parse_args()
    table = Table(COLUMNS, title=f"The graph for {asked.seconds:g} s, {os.cpu_count()} cores, SCHED_FIFO")
    for _ in range(asked.rounds):
        for looking in CASES:
            with tempfile.TemporaryDirectory() as folder:
                table.add(**cost(looking, asked.seconds, Path(folder)))
    taken = disarmed_after(asked.clicks) if asked.clicks else []
    table.show(asked.json)
    if taken:
        print(
            f"click on disarm to valve current 0: median {np.median(taken):.0f} ms, "
            f"worst {max(taken):.0f} ms of {len(taken)}"
        )


if __name__ == "__main__":
    main()
