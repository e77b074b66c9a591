# SPDX-License-Identifier: Apache-2.0
"""Makes a page of a recording, with a time slider and marks where something happened, and opens it.

ros2 run hydro_bridge view runs/monday                       # writes runs/monday.html
ros2 run hydro_bridge view runs/monday --from 600 --to 660   # a part of it, in finer detail
"""

from __future__ import annotations

import argparse
import base64
import gzip
import webbrowser
from datetime import datetime, timezone
from functools import cache
from importlib import resources
from math import inf, isfinite
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from hydro_bridge.cli.console import UserError, command, writable
from hydro_bridge.dashboard import series
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.pages import environment
from hydro_bridge.viewer.marks import report_beside
from hydro_bridge.viewer.recorded import Recorded, read_recorded

_POLICY = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data:"


def rendered(recorded: Recorded) -> str:
    """Return the page as HTML."""
    imports = {f"./{name}": _module(f"dashboard/page/{name}") for name in ("plots.js", "series.js")}
    styles = ("dashboard/page/uPlot.min.css", "dashboard/page/page.css", "viewer/page/view.css")
    return environment("hydro_bridge", "viewer/page").get_template("view.html").render(
        policy=_POLICY,
        title=f"{_name(recorded)} - hydro",
        name=_name(recorded),
        begin=datetime.fromtimestamp(recorded.begin, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC"),
        styles=[_text(name) for name in styles],
        uplot=_text("dashboard/page/uPlot.iife.min.js"),
        imports=imports,
        script=_text("viewer/page/view.js"),
        facts=_facts(recorded),
        messages=dict(sorted(recorded.messages.items())),
        notes=recorded.notes,
        about=_about(recorded),
        states=_packed(recorded.values[0]),
        corrections=_packed(recorded.values[1]),
        laws=_packed(recorded.values[2]),
    )  # fmt: skip


def _name(recorded: Recorded) -> str:
    folder = recorded.path.resolve()
    return f"{folder.parent.name}/{folder.name}" if folder.parent.name else folder.name


def _facts(recorded: Recorded) -> dict[str, str]:
    facts = {"length": f"{recorded.seconds:.1f} s", "finest detail": f"{1e3 * recorded.slot:g} ms", **recorded.metadata}
    return {**facts, **({"attached": ", ".join(recorded.attachments)} if recorded.attachments else {})}


def _about(recorded: Recorded) -> dict[str, Any]:
    """Return the script's data as JSON; non-finite values become null."""
    marks = [{"time": round(mark.time, 3), "kind": mark.kind, "text": mark.text} for mark in recorded.marks]
    about = {
        "seconds": recorded.seconds,
        "slot": recorded.slot,
        "series": series.described(),
        "marks": marks,
        "curve": recorded.curve,
    }
    return dict(msgspec.to_builtins(msgspec.json.decode(msgspec.json.encode(about))))


def _packed(values: npt.NDArray[np.float32]) -> str:
    return base64.b64encode(gzip.compress(np.ascontiguousarray(values, "<f4").tobytes(), 6, mtime=0)).decode()


def _module(name: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(_text(name).encode()).decode()}"


@cache
def _text(name: str) -> str:
    return resources.files("hydro_bridge").joinpath(name).read_text(encoding="utf-8")


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
    if bag.is_file() and bag.suffix != ".mcap":
        raise UserError(
            f"{options.bag} is not a bag: `ros2 run hydro_diagnosis inspect` lists its columns, "
            "the report of `diagnose` shows its signals"
        )
    page = Path(options.html or writable(str(bag.with_name(f"{bag.stem if bag.is_file() else bag.name}.html"))))
    report = options.report or report_beside(bag)
    recorded = read_recorded(options.bag, (options.begin, options.end), report)
    page.parent.mkdir(parents=True, exist_ok=True)
    write_whole(page, rendered(recorded).encode())
    print(page)
    if options.open:
        webbrowser.open(page.absolute().as_uri())
