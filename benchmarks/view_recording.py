# SPDX-License-Identifier: Apache-2.0
"""What it takes to look at a long recording: time and memory of `view`, and how soon a browser shows its page.

The recording is synthetic, written here by the project's own writer: every sample and every correction at 1 kHz,
training status at 2 Hz; numbers with noise in every digit, so that it compresses less than a measured one. It is armed
for 58 s of each minute.

python -m benchmarks.view_recording [--seconds 3600] [--json FILE]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags.cdr import fixed_layout
from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.bags.schema import definition
from hydro_bridge.cli.console import Table, add_json_argument, command, progress
from hydro_bridge.ros.companion import executable_path
from hydro_bridge.signals import STATE_DTYPE, STATE_FIELDS, Flag, StateArray

COLUMNS = {
    "seconds": "length of the recording",
    "size": "of the .mcap [MB]",
    "read": "`view`, from start to end [s]",
    "cpu": "of `view` [s]",
    "memory": "largest resident set of `view` [MB]",
    "page": "size of the page [MB]",
    "slot": "finest detail of the page [ms]",
    "shown": "from its address to all series drawn, in a headless Chromium [s]; null: none is installed",
    "load": "load average over the last minute",
}
BEGIN = 1.7e9
RATE = 1000
PIECE = 10
"""s that are written at a time."""


def states(first: int, count: int, random: np.random.Generator) -> StateArray:
    """Samples of a tracked sine with noise, and flags, from number `first` on."""
    number = first + np.arange(count)
    made = np.zeros(count, STATE_DTYPE)
    made["time"], made["sequence"] = BEGIN + number / RATE, number
    phase = 2.0 * np.pi * number / RATE
    for place, name in enumerate(STATE_FIELDS):
        made[name] = (place + 1.0) * (100.0 * np.sin(phase) + random.standard_normal(count))
    made["flags"] = np.where(number % (60 * RATE) < 58 * RATE, int(Flag.ARMED), 0)
    return made


def other(type_name: str, times: npt.NDArray[np.float64], random: np.random.Generator) -> list[bytes]:
    """Messages of a type of numbers: noise in what is real, the rest 0."""
    layout = fixed_layout(definition(type_name).text, type_name)
    table = np.zeros(len(times), layout.table)
    table["time"] = times
    for name, code in layout.fields:
        if code == "f8":
            table[name] = random.standard_normal(len(times))
    return [row.tobytes() for row in layout.encode(table)]


def write(folder: Path, seconds: int) -> None:
    """Write the recording."""
    random = np.random.default_rng(0)
    kinds = {
        "/hydro/correction": ("hydro_msgs/msg/Correction", 1),
        "/hydro/training": ("hydro_msgs/msg/TrainingStatus", RATE // 2),
    }
    with BagWriter(folder, metadata={"run": "synthetic"}) as writer:
        for topic, (kind, _) in kinds.items():
            writer.add_topic(topic, kind)
        for begin in progress(range(0, seconds, PIECE), label="writing", unit="piece", every=30.0):
            piece = states(begin * RATE, min(PIECE, seconds - begin) * RATE, random)
            writer.write_states(piece)
            for topic, (kind, every) in kinds.items():
                times = piece["time"][::every]
                for moment, data in zip(times, other(kind, times, random), strict=True):
                    writer.write(topic, data, round(moment * 1e9))


def looked_at(bag: Path, page: Path) -> tuple[float, float, float]:
    """Make the page: seconds, seconds of processor, MB at most."""
    words = [str(executable_path("hydro_bridge", "view")), str(bag), "--html", str(page), "--no-open"]
    begin = time.monotonic()
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"view ended with {process.returncode}")
    return time.monotonic() - begin, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def shown(page: Path, profile: Path) -> float | None:
    """Seconds until a browser has drawn it."""
    from tests.browser import MISSING, browser

    if MISSING:
        return None
    with browser(profile) as window:
        begin = time.monotonic()
        window.open(page.as_uri())
        window.wait("document.getElementById('at').textContent.includes(' of ')", timeout=120.0)
        return time.monotonic() - begin


@command()
def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=int, default=3600, help="length of the recording (3600)")
    add_json_argument(parser)
    options = parser.parse_args()
    table = Table(COLUMNS, title="A recording as a page")
    with tempfile.TemporaryDirectory() as place:
        bag, page = Path(place, "bag"), Path(place, "bag.html")
        write(bag, options.seconds)
        size = sum(file.stat().st_size for file in bag.glob("*.mcap"))
        took, cpu, memory = looked_at(bag, page)
        text = page.read_text(encoding="utf-8")
        slot = float(text.partition("finest detail</dt><dd>")[2].partition(" ms")[0])
        table.add(
            seconds=options.seconds, size=size / 1e6, read=took, cpu=cpu, memory=memory, page=len(text) / 1e6,
            slot=slot, shown=shown(page, Path(place, "profile")), load=os.getloadavg()[0],
        )  # fmt: skip
    table.show(options.json)


if __name__ == "__main__":
    main()
