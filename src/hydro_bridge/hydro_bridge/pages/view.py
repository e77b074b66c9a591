# SPDX-License-Identifier: Apache-2.0
"""Makes a page of a recording, with a time slider and marks where something happened, and opens it.

ros2 run hydro_bridge view runs/monday                       # writes runs/monday.html
ros2 run hydro_bridge view runs/monday --from 600 --to 660   # a part of it, in finer detail
"""

from __future__ import annotations

import base64
import gzip
import webbrowser
from collections import Counter
from datetime import datetime, timezone
from importlib import resources
from math import inf
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from hydro_bridge.bags.recording import STATE_TOPIC, as_states
from hydro_bridge.bags.storage import Bag, Piece, missing_topic_error
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.pages import environment
from hydro_bridge.pages.marks import MarkCollector, read_windows
from hydro_bridge.pages.series import SERIES_COLUMNS, RecordedSeries, column_descriptions, column_values
from hydro_bridge.pages.status import LearningCurve
from hydro_core.cli.console import UserError, bounded_number, command, make_parser, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import FloatArray

SERIES_TOPICS = (STATE_TOPIC, "/hydro/correction", "/hydro/law_state")
"""Topics of `SERIES_COLUMNS`, with the samples' stamps."""
GAP_MAX = 3600.0
"""Longest interval without samples [s] that the page shows; longer ones, and steps of the clock, are cut out."""


class _Stamps:
    """Converts the stamps of one topic into times that go on where the clock was set, or has a long gap."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._offset = 0.0
        self.jumps: list[tuple[float, float]] = []
        """Time and step [s] of each jump."""

    def convert(self, stamps: FloatArray) -> FloatArray:
        steps = np.diff(stamps, prepend=stamps[0] if self._last is None else self._last)
        jumps = (steps < -0.1) | (steps > GAP_MAX)
        offsets = self._offset - np.cumsum(np.where(jumps, steps, 0.0))
        self._last, self._offset = float(stamps[-1]), float(offsets[-1])
        times: FloatArray = stamps + offsets
        self.jumps += zip(times[jumps].tolist(), steps[jumps].tolist(), strict=True)
        return times


class RecordingPage:
    """Content of the page of one recording: downsampled series, marks, and facts about it.

    `path`: a rosbag2 folder or an .mcap file. `span`: part to show, s from the first sample; a shorter part is shown in
    finer detail. `report`: report.json of a diagnosis whose windows are marked. Raises RecordingError: the recording is
    missing, damaged, or has no bench samples at all or within the span; or the report is invalid.
    """

    def __init__(self, path: Path | str, span: tuple[float, float] = (0.0, inf), report: Path | None = None) -> None:
        self.bag, self.messages = Bag(path), Counter[str]()
        """The recording, and its number of messages by topic."""
        self._span, self._collector, self._curve = span, MarkCollector(), LearningCurve()
        self._stamps = [_Stamps() for _ in SERIES_TOPICS]
        self._series: list[RecordedSeries] = []
        self._first = self._first_logged = 0.0  # s: stamp and log time of the first sample
        self._ahead = 0.0  # s: stamp minus log time of the last sample
        self._early: list[Piece] = []
        foreign: set[str] = set()
        for piece in self.bag.pieces():
            self.messages[piece.topic] += len(piece.starts)
            try:
                self._add(piece)
            except (AttributeError, KeyError, ValueError):  # fields of another version
                foreign.add(piece.topic)
        if not self._series:
            raise missing_topic_error(self.bag.path, STATE_TOPIC, self.messages)
        if report is not None:
            for mark in read_windows(report, Path(path), self._first):
                self._collector.add(self._first + mark.time, mark.kind, mark.text)
        begin, self.bin_width = self._first + span[0], max(series.bin_width for series in self._series)
        self.values = [series.values(self.bin_width) for series in self._series]
        """States, corrections and laws: minimum and maximum in bins of `bin_width` s, shape (bins, columns, 2)."""
        if not len(self.values[0]):
            raise RecordingError(f"{self.bag.path} has no samples from {span[0]:g} to {span[1]:g} s")
        self.seconds = self._series[0].end - begin
        self.marks, self.curve = self._collector.crop(begin, self.seconds), self._curve.content()
        recorded = self._first_logged + span[0]
        date = datetime.fromtimestamp(recorded, timezone.utc)
        self.begin = f"{date:%Y-%m-%d %H:%M:%S UTC}" if recorded > 1e9 else f"{begin:.1f} s"
        """When the first sample shown was recorded; of a simulation without a recorder, which begins at 0, its time."""
        self.notes = [*self.bag.notes, *(f"{topic} is of another version: not shown" for topic in sorted(foreign))]
        self.notes += [f"the clock was set by {step:+.10g} s after {time - self._first:.1f} s: time goes on behind it"
                       for time, step in self._stamps[0].jumps]  # fmt: skip
        if self._collector.dropped:
            self.notes.append(f"{self._collector.dropped} more marks are not shown: give a part by --from and --to")

    def _add(self, piece: Piece) -> None:
        if not self._series and piece.topic != STATE_TOPIC:
            self._early.append(piece)
        elif piece.topic in SERIES_TOPICS:
            self._add_series(piece, SERIES_TOPICS.index(piece.topic))
        elif piece.topic in ("/hydro/authority", "/diagnostics", "/rosout"):
            for logged, message in piece.messages():
                self._collector.add_message(logged + self._ahead, message)
        elif piece.topic in ("/hydro/training", "/hydro/policy") and (table := piece.table()) is not None:
            times = 1e-9 * piece.heads["log_time"] + self._ahead
            since = times - self._first
            shown = (since >= self._span[0]) & (since <= self._span[1])
            if piece.topic == "/hydro/policy":
                self._collector.add_steps(times[shown], table["weights"][shown].astype(np.int64))
                return
            for time, row in zip(times[shown], table[shown], strict=True):
                self._collector.add_training(float(time), row)
                results = (float(row[key]) for key in ("force_rmse", "episode_return", "critic_loss", "actor_loss"))
                self._curve.add(int(row["phase"]), int(row["episode"]), *results)

    def _add_series(self, piece: Piece, number: int) -> None:
        if (table := piece.table()) is None:
            return
        table["time"] = self._stamps[number].convert(table["time"])
        if number == 0:
            table = as_states(table, piece.path)
            self._ahead = float(table["time"][-1] - 1e-9 * piece.heads["log_time"][-1])
            if not self._series:
                self._first, self._first_logged = float(table["time"][0]), 1e-9 * float(piece.heads["log_time"][0])
                self._series = [RecordedSeries(len(columns), self._first + self._span[0]) for columns in SERIES_COLUMNS]
                for early in self._early:
                    self._add(early)
        since = table["time"] - self._first
        table = table[(since >= self._span[0]) & (since <= self._span[1])]
        if len(table):
            self._series[number].add(table["time"], column_values(number, table))
            if number == 0:
                self._collector.add_states(table)


def render_page(recorded: RecordingPage) -> str:
    """Return the page as HTML."""

    def text(file: str) -> str:
        return (resources.files("hydro_bridge.pages") / "static" / file).read_text(encoding="utf-8")

    def encoded(content: bytes) -> str:
        return base64.b64encode(content).decode()

    folder, bag = recorded.bag.path.resolve(), recorded.bag
    facts = {"length": f"{recorded.seconds:.1f} s", "finest detail": f"{1e3 * recorded.bin_width:g} ms"}
    attached = {"attached": ", ".join(bag.attachments)} if bag.attachments else {}
    about = {
        "seconds": recorded.seconds,
        "bin_width": recorded.bin_width,
        "series": column_descriptions(),
        "marks": [{"time": round(mark.time, 3), "kind": mark.kind, "text": mark.text} for mark in recorded.marks],
        "curve": recorded.curve,
    }
    tables = [gzip.compress(np.ascontiguousarray(table, "<f4").tobytes(), 6, mtime=0) for table in recorded.values]
    return environment("hydro_bridge", "pages/static").get_template("view.html").render(
        policy="default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data:",
        title=f"{folder.name} - hydro",
        name=f"{folder.parent.name}/{folder.name}".removeprefix("/"),
        begin=recorded.begin,
        styles=[text(style) for style in ("uPlot.min.css", "page.css", "view.css")],
        uplot=text("uPlot.iife.min.js"),
        imports={f"./{file}": f"data:text/javascript;base64,{encoded(text(file).encode())}"
                 for file in ("plots.js", "series.js")},
        script=text("view.js"),
        facts={**facts, **bag.metadata.get("hydro", {}), **attached},
        messages=dict(sorted(recorded.messages.items())),
        notes=recorded.notes,
        about=msgspec.json.decode(msgspec.json.encode(about)),  # non-finite values become null
        tables=[encoded(table) for table in tables],
    )  # fmt: skip


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("view", __doc__)
    parser.add_argument("bag", type=Path, metavar="BAG", help="a rosbag2 folder or an .mcap file")
    parser.add_argument(
        "--html", type=writable_file, metavar="FILE", help="the page (default: beside BAG, as BAG.html)"
    )
    span: dict[str, Any] = {"type": bounded_number(0.0), "metavar": "S", "help": "s from first sample"}
    parser.add_argument("--from", dest="begin", default=0.0, **span)
    parser.add_argument("--to", dest="end", default=inf, **span)
    parser.add_argument(
        "--report", type=Path, metavar="FILE", help="report.json of a diagnosis (default: the one beside BAG)"
    )
    parser.add_argument("--no-open", dest="open", action="store_false", help="open no browser")
    options = parser.parse_args()
    if options.end <= options.begin:
        raise UserError(f"--from {options.begin:g} --to {options.end:g}: the end must come behind the begin")
    bag = options.bag.absolute()
    if bag.is_file() and bag.suffix != ".mcap":
        raise UserError(f"{options.bag} is not a bag: `ros2 run hydro_diagnosis inspect` lists its columns")
    page = Path(options.html or writable_file(str(bag.with_name(f"{bag.stem if bag.is_file() else bag.name}.html"))))
    beside = bag.parent / "report.json"
    report = options.report or (beside if beside.is_file() else None)
    recorded = RecordingPage(options.bag, (options.begin, options.end), report)
    page.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(page, render_page(recorded).encode())
    print(page)
    if options.open:
        webbrowser.open(page.absolute().as_uri())
