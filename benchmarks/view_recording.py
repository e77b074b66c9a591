# SPDX-License-Identifier: Apache-2.0
"""What it takes to look at a long recording: time and memory of `view`, and how soon a browser shows its page.

The recording is the emulator's, off-line: every sample at 1 kHz with the sensors' noise, no corrections.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from pathlib import Path

from benchmarks._report import parser
from hydro_bridge.cli.console import Table, command
from hydro_bridge.ros.companion import executable_path

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
    options = parser("view_recording", __doc__)
    options.add_argument("--seconds", type=int, nargs="+", default=[60, 3600], help="of each recording (60 3600)")
    asked = options.parse_args()
    table = Table(COLUMNS, title="A recording as a page")
    for seconds in asked.seconds:
        with tempfile.TemporaryDirectory() as place:
            bag, page = Path(place, "bag"), Path(place, "bag.html")
            words = ["--offline", "--seconds", str(seconds), "--out", str(bag)]
            subprocess.run([executable_path("hydro_sim", "emulator"), *words], check=True, stdout=subprocess.DEVNULL)
            took, cpu, memory = looked_at(bag, page)
            text = page.read_text(encoding="utf-8")
            slot = float(text.partition("finest detail</dt><dd>")[2].partition(" ms")[0])
            size = sum(file.stat().st_size for file in bag.glob("*.mcap"))
            table.add(
                seconds=seconds, size=size / 1e6, read=took, cpu=cpu, memory=memory, page=len(text) / 1e6, slot=slot,
                shown=shown(page, Path(place, "profile")), load=os.getloadavg()[0],
            )  # fmt: skip
    table.show(asked.json)


if __name__ == "__main__":
    main()
