# SPDX-License-Identifier: Apache-2.0
"""Makes a page of a recording, with a time slider and marks where something happened, and opens it.

ros2 run hydro_bridge view runs/monday                       # writes runs/monday.html
ros2 run hydro_bridge view runs/monday --from 600 --to 660   # a part of it, in finer detail
"""

from __future__ import annotations

import gzip
import webbrowser
from collections import Counter
from datetime import datetime, timezone
from math import inf, nan
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from hydro_bridge.bags import RecordingError
from hydro_bridge.bags.recording import STATE_TOPIC, Bag, Piece, as_states
from hydro_bridge.pages import environment
from hydro_bridge.pages.marks import MARKS_MAX, MarkCollector, read_windows
from hydro_bridge.pages.series import SERIES_COLUMNS, LearningCurve, RecordedSeries, column_values
from hydro_core.cli.console import UserError, bounded_number, command, make_parser, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import FloatArray

SERIES_TOPICS = (STATE_TOPIC, "/hydro/correction", "/hydro/law_state")
"""Topics of `SERIES_COLUMNS`, with the samples' stamps."""
GAP_MAX = 3600.0
"""Longest interval without samples [s] that the page shows; longer ones, and steps of the clock, are cut out."""


class _Clock:
    """Converts the stamps of one topic into times that go on where the clock was set, or has a long gap."""

    def __init__(self) -> None:
        self._last, self._offset = nan, 0.0
        self.jumps: list[tuple[float, float]] = []
        """Time and step [s] of each jump."""

    def convert(self, stamps: FloatArray) -> FloatArray:
        steps = np.diff(stamps, prepend=self._last)
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
        opening = next(Bag(path).pieces(STATE_TOPIC))
        if (table := opening.table()) is None:
            raise RecordingError(f"{opening.path}: {STATE_TOPIC} is not numbers only")
        first = float(as_states(table, opening.path)["time"][0])
        logged = 1e-9 * float(opening.heads["log_time"][0])
        self._collector, self._curve = MarkCollector(), LearningCurve()
        self._begin, self._end, self._ahead = first + span[0], first + span[1], first - logged
        self._clocks = [_Clock() for _ in SERIES_TOPICS]
        self._series = [RecordedSeries(len(columns), self._begin) for columns in SERIES_COLUMNS]
        for piece in self.bag.pieces():
            self.messages[piece.topic] += len(piece.starts)
            self._add(piece)
        for mark in read_windows(report, Path(path), first) if report else ():
            self._collector.add(first + mark.time, mark.kind, mark.text)
        self.bin_width = max(series.bin_width for series in self._series)
        self.values = [series.values(self.bin_width) for series in self._series]
        """States, corrections and laws: minimum and maximum in bins of `bin_width` s, shape (bins, columns, 2)."""
        if not len(self.values[0]):
            raise RecordingError(f"{self.bag.path} has no samples from {span[0]:g} to {span[1]:g} s")
        self.seconds = self._series[0].end - self._begin
        self.marks, self.curve = self._collector.crop(self._begin, self.seconds), self._curve.content()
        recorded = logged + span[0]
        date = datetime.fromtimestamp(recorded, timezone.utc)
        self.begin = f"{date:%Y-%m-%d %H:%M:%S UTC}" if recorded > 1e9 else f"{self._begin:.1f} s"
        """When the first sample shown was recorded; of a simulation without a recorder, which begins at 0, its time."""
        self.notes = list(self.bag.notes) + [
            f"the clock was set by {step:+.10g} s after {time - first:.1f} s: time goes on behind it"
            for time, step in self._clocks[0].jumps
        ]
        if len(self.marks) == MARKS_MAX:
            self.notes.append(f"the first {MARKS_MAX} marks are shown: give a part by --from and --to")

    def _add(self, piece: Piece) -> None:
        if piece.topic in SERIES_TOPICS and (table := piece.table()) is not None:
            number = SERIES_TOPICS.index(piece.topic)
            table["time"] = self._clocks[number].convert(table["time"])
            if number == 0:
                table = as_states(table, piece.path)
                self._ahead = float(table["time"][-1] - 1e-9 * piece.heads["log_time"][-1])
            table = table[(table["time"] >= self._begin) & (table["time"] <= self._end)]
            if len(table):
                self._series[number].add(table["time"], column_values(number, table))
            if len(table) and number == 0:
                self._collector.add_states(table)
        elif piece.topic == "/hydro/policy" and (table := piece.table()) is not None:
            self._collector.add_steps(1e-9 * piece.heads["log_time"] + self._ahead, table["weights"].astype(np.int64))
        elif piece.topic in ("/hydro/authority", "/hydro/training", "/diagnostics", "/rosout"):
            for logged, message in piece.messages():
                time = logged + self._ahead
                self._collector.add_message(piece.topic, time, message)
                if piece.topic == "/hydro/training" and self._begin <= time <= self._end:
                    self._curve.add(message)


def render_page(recorded: RecordingPage) -> str:
    """Return the page as HTML."""
    folder, bag = recorded.bag.path.resolve(), recorded.bag
    about = {name: getattr(recorded, name) for name in ("seconds", "bin_width", "marks", "curve")}
    about["series"] = SERIES_COLUMNS
    return environment("hydro_bridge", "pages/static").get_template("view.html").render(
        title=f"{folder.name} - hydro",
        name=f"{folder.parent.name}/{folder.name}".removeprefix("/"),
        begin=recorded.begin,
        facts={"length": f"{recorded.seconds:.1f} s", "finest detail": f"{1e3 * recorded.bin_width:g} ms",
               **bag.metadata.get("hydro", {}), "attached": ", ".join(bag.attachments) or "nothing"},
        messages=dict(sorted(recorded.messages.items())),
        notes=recorded.notes,
        about=msgspec.json.decode(msgspec.json.encode(about)),  # non-finite values become null
        tables=[gzip.compress(np.ascontiguousarray(table, "<f4").tobytes(), mtime=0) for table in recorded.values],
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
    bag, beside = options.bag.absolute(), options.bag.absolute().parent / "report.json"
    if options.end <= options.begin:
        raise UserError(f"--from {options.begin:g} --to {options.end:g}: the end must come behind the begin")
    if bag.is_file() and bag.suffix != ".mcap":
        raise UserError(f"{options.bag} is not a bag: `ros2 run hydro_diagnosis inspect` lists its columns")
    page = Path(options.html or writable_file(str(bag.with_name(f"{bag.stem if bag.is_file() else bag.name}.html"))))
    report = options.report or (beside if beside.is_file() else None)
    recorded = RecordingPage(options.bag, (options.begin, options.end), report)
    page.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(page, render_page(recorded).encode())
    print(page)
    if options.open:
        webbrowser.open(page.absolute().as_uri())
