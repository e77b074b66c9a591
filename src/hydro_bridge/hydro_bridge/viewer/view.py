# SPDX-License-Identifier: Apache-2.0
"""Makes a page of a recording, with a time slider and marks where something happened, and opens it.

ros2 run hydro_bridge view runs/monday                       # writes runs/monday.html
ros2 run hydro_bridge view runs/monday --from 600 --to 660   # a part of it, in finer detail
"""

from __future__ import annotations

import argparse
import webbrowser
from math import inf, isfinite
from pathlib import Path

from hydro_bridge.cli.console import UserError, command, writable
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.viewer.findings import report_beside
from hydro_bridge.viewer.page import rendered
from hydro_bridge.viewer.recorded import read_recorded


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not isfinite(seconds) or seconds < 0.0:
        raise argparse.ArgumentTypeError(f"{text}: seconds from the first sample, 0 or more")
    return seconds


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="view", description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    result.add_argument("bag", type=Path, metavar="BAG", help="a rosbag2 folder or an .mcap file")
    result.add_argument("--html", type=writable, metavar="FILE", help="the page (default: beside BAG, as BAG.html)")
    result.add_argument("--from", dest="begin", type=_seconds, default=0.0, metavar="S", help="s from the first sample")
    result.add_argument("--to", dest="end", type=_seconds, default=inf, metavar="S", help="s from the first sample")
    result.add_argument(
        "--report", type=Path, metavar="FILE", help="report.json of a diagnosis (default: the one beside BAG)"
    )
    result.add_argument("--no-open", dest="open", action="store_false", help="open no browser")
    return result


@command()
def main() -> None:
    """Entry point."""
    options = parser().parse_args()
    if options.end <= options.begin:
        raise UserError(f"--from {options.begin:g} --to {options.end:g}: the end must come behind the begin")
    bag = options.bag.absolute()
    page = Path(options.html or writable(str(bag.with_name(f"{bag.stem if bag.is_file() else bag.name}.html"))))
    report = options.report or report_beside(bag)
    recorded = read_recorded(options.bag, (options.begin, options.end), report)
    page.parent.mkdir(parents=True, exist_ok=True)
    write_whole(page, rendered(recorded).encode())
    print(page)
    if options.open:
        webbrowser.open(page.absolute().as_uri())
