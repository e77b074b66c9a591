# SPDX-License-Identifier: Apache-2.0
"""What the first start of each executable costs, beside the last one: `python -m benchmarks.startup`.

Nodes run until they say their first word, commands to the end of the smallest task that they have. Run it right after
set-up: a start that compiles shows in `compiled`, and then costs more than the last.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from benchmarks._report import parser
from hydro_bridge.cli.console import Table, command, progress
from hydro_bridge.ros.companion import executable_path
from hydro_sim.compilations import VARIABLE, read_compilations

NODES = ("hydro_sim emulator --link {out}/port", "hydro_bridge bridge --port {out}/none", "hydro_filter filter",
         "hydro_sim sim", "hydro_sim sim --model analytic",
         "hydro_bridge recorder --out {out}/recording")  # fmt: skip
BAG = "hydro_sim emulator --offline --seconds 8 --out {bag}"
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


def start(words: str, bag: Path, *, node: bool = False) -> tuple[float, float, float]:
    """Start an executable: s until its end or a node's first word, s of processor time, s of it for compiling."""
    package, executable, *rest = words.split()
    with tempfile.TemporaryDirectory() as out:
        log = Path(out) / "compilations"
        line = [str(executable_path(package, executable)), *(word.format(out=out, bag=bag) for word in rest)]
        before, began, wall = _cpu(), time.monotonic(), 0.0
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        process = subprocess.Popen(line, **streams, env={**os.environ, VARIABLE: str(log)}, start_new_session=True)
        assert process.stdout is not None
        if node:
            process.stdout.readline()
            wall = time.monotonic() - began
            process.send_signal(signal.SIGINT)
        printed, _ = process.communicate()
        if process.returncode not in ((0, 128 + signal.SIGINT) if node else (0,)):
            raise RuntimeError(f"{words} ended with exit status {process.returncode}: {printed.decode()}")
        wall = wall or time.monotonic() - began
        return wall, _cpu() - before, sum(one["seconds"] for one in read_compilations(log))


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@command()
def main() -> None:
    """Measure, print, write."""
    options = parser("startup", __doc__)
    options.add_argument("--times", type=int, default=10, metavar="N", help="starts of each (default: %(default)s)")
    asked = options.parse_args()
    columns = {"executable": "", "first": "s, wall time", "last": "s", "cpu_first": "s, of its process and all that "
               "it started", "cpu_last": "s", "compiled": "s, of the first for compiling"}  # fmt: skip
    table = Table(
        columns, title=f"Starts after set-up, the first and the last of {asked.times}, {os.cpu_count()} cores"
    )
    with tempfile.TemporaryDirectory() as folder:
        start(BAG, Path(folder) / "bag")
        for words in progress([*NODES, *COMMANDS], label="starts", unit="executable"):
            costs = [start(words, Path(folder) / "bag", node=words in NODES) for _ in range(asked.times)]
            (first, cpu_first, compiled), (last, cpu_last, _) = costs[0], costs[-1]
            table.add(executable=words, first=first, last=last, cpu_first=cpu_first, cpu_last=cpu_last,
                      compiled=compiled)  # fmt: skip
    table.show(asked.json)


if __name__ == "__main__":
    main()
