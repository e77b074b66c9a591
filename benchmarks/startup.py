# SPDX-License-Identifier: Apache-2.0
"""What the first start of each executable costs, beside the tenth: `python -m benchmarks.startup`.

Nodes run until they say their first word, commands to the end of the smallest task that they have. Run it right after
set-up: a start that compiles shows in `compiled`, and then costs more than the tenth.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks import _report
from hydro_bridge.cli.console import Table, command, progress
from hydro_bridge.ros.companion import executable_path
from hydro_sim.compilations import VARIABLE, read_compilations

COLUMNS = {
    "executable": "",
    "first": "s, wall time of the first start",
    "tenth": "s, of the last one (the tenth by default)",
    "cpu_first": "s, of its process and all that it started",
    "cpu_tenth": "s, of the last one",
    "compiled": "s, of it for compiling, first start",
}

NODES = ("hydro_sim emulator --link {out}/port", "hydro_bridge bridge --port {out}/none", "hydro_filter filter",
         "hydro_filter filter --metric constant", "hydro_sim sim", "hydro_sim sim --model analytic",
         "hydro_bridge recorder --out {out}/recording")  # fmt: skip

COMMANDS = (
    "hydro_sim emulator --offline --seconds 8 --out {out}/bag",
    "hydro_sim learn {bag} --out {out}/learnt.yaml",
    "hydro_sim validate {bag}",
    "hydro_filter validate --seeds 1 --seconds 1 --jobs 1 --cases stable",
    "hydro_policy pretrain --out {out}/agent --episodes 1 --steps 20",
    "hydro_policy trainer --help",
    "hydro_policy evaluate --plant sim --runs {out}/runs --fixed 60 10 --frequencies 2 --settle 0.5",
    "hydro_diagnosis diagnose {bag} --out {out}/diagnosis",
)

ENDED = (0, 128 + signal.SIGINT)
"""Of a node that is asked to end: the second where the signal falls into its start."""


@dataclass(frozen=True)
class Cost:
    """Of one start, s."""

    wall: float
    cpu: float
    compiled: float


def start(words: str, *, node: bool) -> Cost:
    """Start an executable in a folder of its own and wait for its end, or a node's first word."""
    package, executable, *rest = words.split()
    with tempfile.TemporaryDirectory() as out:
        log = Path(out) / "compilations"
        command_line = [str(executable_path(package, executable)), *(word.format(out=out) for word in rest)]
        before, began = _cpu(), time.monotonic()
        process = subprocess.Popen(
            command_line,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={**os.environ, VARIABLE: str(log)},
            start_new_session=True,
        )
        assert process.stdout is not None
        if node:
            process.stdout.readline()
            wall = time.monotonic() - began
            process.send_signal(signal.SIGINT)
        printed = process.stdout.read()
        process.stdout.close()
        status = process.wait()
        if status not in (ENDED if node else (0,)):
            sys.stderr.write(printed.decode(errors="replace"))
            raise RuntimeError(f"{words} ended with exit status {status}")
        wall = wall if node else time.monotonic() - began
        return Cost(wall, _cpu() - before, sum(line["seconds"] for line in read_compilations(log)))


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(times: int) -> Table:
    """Start everything so many times, the first times first."""
    table = Table(COLUMNS, title=f"Starts after set-up, the first and the last of {times}, {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        words = ["emulator", "--offline", "--seconds", "8", "--out", str(bag)]
        everything = [(text, True) for text in NODES] + [(text, False) for text in COMMANDS]
        for text, node in progress(everything, total=len(everything), label="starts", unit="executable"):
            if "{bag}" in text and not bag.exists():
                subprocess.run([str(executable_path("hydro_sim", words[0])), *words[1:]], check=True)
            costs = [start(text.replace("{bag}", str(bag)), node=node) for _ in range(times)]
            first, last = costs[0], costs[-1]
            table.add(
                executable=text,
                first=first.wall,
                tenth=last.wall,
                cpu_first=first.cpu,
                cpu_tenth=last.cpu,
                compiled=first.compiled,
            )
    return table


@command()
def main() -> None:
    """Measure, print, write."""
    parser = _report.parser("startup", (__doc__ or "").splitlines()[0])
    parser.add_argument("--times", type=int, default=10, metavar="N", help="starts of each (default: %(default)s)")
    asked = parser.parse_args()
    measure(asked.times).show(asked.json)


if __name__ == "__main__":
    main()
