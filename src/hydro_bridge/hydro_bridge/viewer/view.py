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
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import cache
from importlib import resources
from math import inf
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from hydro_bridge.bags.recording import STATE_TOPIC, as_states
from hydro_bridge.bags.storage import Bag, missing_topic_error
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.dashboard import series, status
from hydro_bridge.pages import environment
from hydro_bridge.viewer.marks import REPORT_FILE, Mark, MarkCollector, read_windows, select_windows
from hydro_bridge.viewer.monotonic_times import MonotonicTimes
from hydro_core.cli.console import UserError, bounded_number, command, make_parser, writable_file
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import FloatArray

CLOCK_OFFSET_MAX = 2.0
"""Largest difference [s] of stamp and log time on the same clock; a recorder's delay stays below."""


GAP_MAX = 3600.0
"""Longest interval without samples [s] that the page shows; longer ones are cut out."""


class SampleClock:
    """Converts times of messages to the samples' clock while a recording is read block by block."""

    def __init__(self) -> None:
        self._logged, self._time, self._rate = 0.0, 0.0, 0.0  # of the last sample; 0: none yet

    def update(self, logged: npt.NDArray[np.int64], times: FloatArray) -> None:
        """Add a block of samples: log times [ns] and stamps [s], both of shape (n,)."""
        if not len(logged):
            return
        span = 1e-9 * float(logged[-1] - logged[0])
        self._rate = float(times[-1] - times[0]) / span if span > 0.0 else self._rate
        self._logged, self._time = 1e-9 * float(logged[-1]), float(times[-1])

    def sample_times(self, stamps: npt.ArrayLike, logged: npt.ArrayLike) -> FloatArray:
        """Return the times [s] of messages on the samples' clock, from stamps and log times [s] of equal shape."""
        stamps, logged = np.asarray(stamps, np.float64), np.asarray(logged, np.float64)
        if not self._rate or abs(self._time - self._logged) <= CLOCK_OFFSET_MAX:  # no samples yet, or one clock
            return stamps
        by_wall_clock = np.abs(stamps - logged) <= CLOCK_OFFSET_MAX
        return np.where(by_wall_clock, self._time + self._rate * (logged - self._logged), stamps)


CORRECTION_TOPIC, TRAINING_TOPIC, AUTHORITY_TOPIC = "/hydro/correction", "/hydro/training", "/hydro/authority"
POLICY_TOPIC, DIAGNOSTICS_TOPIC, LOG_TOPIC = "/hydro/policy", "/diagnostics", "/rosout"
LAW_TOPIC = "/hydro/law_state"
"""Topic of the state of the force law; without messages the paper's law acted."""
TOPIC_CONTENTS = {
    CORRECTION_TOPIC: "the filter's correction and certificate",
    TRAINING_TOPIC: "episodes and examinations",
    POLICY_TOPIC: "which weights acted",
    AUTHORITY_TOPIC: "who commanded",
    DIAGNOSTICS_TOPIC: "rollbacks and overrides",
    LOG_TOPIC: "who asked to arm, disarm or override, and what the nodes warned of,",
}
"""Content of the page that depends on each topic."""

_REQUIRED_FIELDS = {
    STATE_TOPIC: frozenset[str](),  # `as_states` says what is missing
    CORRECTION_TOPIC: frozenset(column.field for column in series.CORRECTION_COLUMNS),
    LAW_TOPIC: frozenset(column.field for column in series.LAW_COLUMNS),
    TRAINING_TOPIC: frozenset(
        {"phase", "episode", "episode_return", "force_rmse", "critic_loss", "actor_loss", "learner_alive"}
    ),
    POLICY_TOPIC: frozenset({"weights"}),
}
_SERIES_TOPICS = (STATE_TOPIC, CORRECTION_TOPIC, LAW_TOPIC)
"""Topics of `series.SERIES_COLUMNS`, with the samples' stamps."""
_OBJECT_TYPES = {
    AUTHORITY_TOPIC: "hydro_msgs/msg/Authority",
    DIAGNOSTICS_TOPIC: "diagnostic_msgs/msg/DiagnosticArray",
    LOG_TOPIC: "rcl_interfaces/msg/Log",
}


@dataclass(frozen=True, kw_only=True)
class RecordingPage:
    """Content of the page of one recording: downsampled series, marks and notes."""

    path: Path
    begin: float
    """s since 1970 of the first sample; all other times count from it."""
    seconds: float
    bin_width: float
    """Width of a bin [s]."""
    values: tuple[npt.NDArray[np.float32], ...]
    """States, corrections and laws: minimum and maximum, shape (bins, columns, 2)."""
    marks: list[Mark]
    curve: dict[str, Any]
    """Learning curve, as drawn by the live page."""
    messages: dict[str, int]
    """Number of messages by topic."""
    metadata: dict[str, str]
    attachments: list[str]
    notes: list[str]
    """Irregularities that the reader tolerated, and missing topics."""


def read_page(path: Path | str, span: tuple[float, float] = (0.0, inf), report: Path | None = None) -> RecordingPage:
    """Read a recording into the content of its page.

    `path`: a rosbag2 folder or an .mcap file. `span`: part to show, s from the first sample; a shorter part is shown in
    finer detail. `report`: report.json of a diagnosis whose windows are marked. Raises RecordingError: the recording is
    missing, damaged, or has no bench samples at all or within the span; or the report is invalid.
    """
    windows = [] if report is None else read_windows(report)
    source = Bag(path)
    marks, curve, clock = MarkCollector(), status.LearningCurve(), SampleClock()
    clocks = {topic: MonotonicTimes(GAP_MAX) for topic in _SERIES_TOPICS}
    thinners: tuple[series.GrowingDownsampler, ...] = ()  # none before the first sample
    first = 0.0  # s, of the first sample
    messages: Counter[str] = Counter()
    foreign: set[str] = set()  # topics whose messages are of another version or type

    for piece in source.pieces():
        topic = piece.topic
        messages[topic] += len(piece.starts)
        if topic in _OBJECT_TYPES:
            try:
                if piece.schema.name != _OBJECT_TYPES[topic]:
                    raise AttributeError
                for logged, message in piece.messages():
                    stamp = message.stamp if topic == LOG_TOPIC else message.header.stamp
                    time = float(clock.sample_times(stamp.sec + 1e-9 * stamp.nanosec, logged))
                    if topic == LOG_TOPIC:
                        marks.add_log(time, int(message.level), message.name, message.msg)
                    elif topic == AUTHORITY_TOPIC:
                        marks.add_authority(time, message.holder)
                    else:
                        for node in message.status:
                            marks.add_diagnostics(time, node.name, {entry.key: entry.value for entry in node.values})
            except AttributeError:  # another type, or fields of another version
                foreign.add(topic)
        if topic not in _REQUIRED_FIELDS:
            continue
        table = piece.table()
        if table is None or not _REQUIRED_FIELDS[topic] <= set(table.dtype.names or ()):
            foreign.add(topic)
            continue
        if topic in clocks:
            table["time"] = clocks[topic].convert(table["time"])
        else:  # the trainer stamps by the wall clock
            table["time"] = clock.sample_times(table["time"], 1e-9 * piece.heads["log_time"])
        if topic == STATE_TOPIC:
            clock.update(piece.heads["log_time"], table["time"])
            table = as_states(table, source.path)
            if not thinners and len(table):
                first = float(table["time"][0])
                thinners = tuple(
                    series.GrowingDownsampler(len(columns), first + span[0]) for columns in series.SERIES_COLUMNS
                )
        since = table["time"] - first
        table = table[(since >= span[0]) & (since <= span[1])]
        if not (thinners and len(table)):
            continue
        if topic in _SERIES_TOPICS:
            number = _SERIES_TOPICS.index(topic)
            thinners[number].add(table["time"], series.column_values(number, table))
        if topic == STATE_TOPIC:
            marks.add_states(table)
        elif topic == POLICY_TOPIC:
            marks.add_steps(table)
        elif topic == TRAINING_TOPIC:
            for row in table:
                marks.add_training({name: row[name] for name in row.dtype.names})
                results = [float(row[name]) for name in ("force_rmse", "episode_return", "critic_loss", "actor_loss")]
                curve.add(int(row["phase"]), int(row["episode"]), *results)

    if not thinners:
        raise missing_topic_error(source.path, STATE_TOPIC, messages)
    for mark in select_windows(windows, Path(path), first):
        marks.add(first + mark.time, mark.kind, mark.text)
    begin, bin_width = first + span[0], max(thinner.bin_width for thinner in thinners)
    values, seconds = tuple(thinner.values(bin_width) for thinner in thinners), thinners[0].end - begin
    if not len(values[0]):
        raise RecordingError(f"{source.path} has no samples from {span[0]:g} to {span[1]:g} s")
    notes = [*source.notes]
    notes += [f"{topic} was not recorded: {what} cannot be shown" for topic, what in TOPIC_CONTENTS.items()
              if topic not in messages and (topic != POLICY_TOPIC or TRAINING_TOPIC in messages)]  # fmt: skip
    notes += [f"{topic} is of another version or type: it is not shown" for topic in sorted(foreign)]
    notes += [f"the clock was set by {step:+.10g} s after {time - first:.1f} s: time goes on behind it"
              for time, step in clocks[STATE_TOPIC].jumps]  # fmt: skip
    if marks.dropped:
        notes.append(f"{marks.dropped} more marks are not shown: give a part of it by --from and --to")
    return RecordingPage(
        path=source.path,
        begin=begin,
        seconds=seconds,
        bin_width=bin_width,
        values=values,
        marks=marks.crop(begin, seconds),
        curve=curve.content(),
        messages=dict(messages),
        metadata=source.metadata.get("hydro", {}),
        attachments=[*source.attachments],
        notes=notes,
    )


_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data:"
)


def render_page(recorded: RecordingPage) -> str:
    """Return the page as HTML."""
    folder = recorded.path.resolve()
    name = f"{folder.parent.name}/{folder.name}" if folder.parent.name else folder.name
    facts = {
        "length": f"{recorded.seconds:.1f} s",
        "finest detail": f"{1e3 * recorded.bin_width:g} ms",
        **recorded.metadata,
    }
    if recorded.attachments:
        facts["attached"] = ", ".join(recorded.attachments)
    about = {
        "seconds": recorded.seconds,
        "bin_width": recorded.bin_width,
        "series": series.column_descriptions(),
        "marks": [{"time": round(mark.time, 3), "kind": mark.kind, "text": mark.text} for mark in recorded.marks],
        "curve": recorded.curve,
    }
    modules = {f"./{file}": _text(f"dashboard/page/{file}") for file in ("plots.js", "series.js")}
    imports = {
        file: f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"
        for file, text in modules.items()
    }
    styles = ("dashboard/page/uPlot.min.css", "dashboard/page/page.css", "viewer/page/view.css")
    zipped = (gzip.compress(np.ascontiguousarray(table, "<f4").tobytes(), 6, mtime=0) for table in recorded.values)
    states, corrections, laws = (base64.b64encode(content).decode() for content in zipped)
    return environment("hydro_bridge", "viewer/page").get_template("view.html").render(
        policy=_CONTENT_SECURITY_POLICY,
        title=f"{name} - hydro",
        name=name,
        begin=datetime.fromtimestamp(recorded.begin, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC"),
        styles=[_text(style) for style in styles],
        uplot=_text("dashboard/page/uPlot.iife.min.js"),
        imports=imports,
        script=_text("viewer/page/view.js"),
        facts=facts,
        messages=dict(sorted(recorded.messages.items())),
        notes=recorded.notes,
        about=msgspec.json.decode(msgspec.json.encode(about)),  # non-finite values become null
        states=states,
        corrections=corrections,
        laws=laws,
    )  # fmt: skip


@cache
def _text(name: str) -> str:
    return resources.files("hydro_bridge").joinpath(name).read_text(encoding="utf-8")


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
        raise UserError(
            f"{options.bag} is not a bag: `ros2 run hydro_diagnosis inspect` lists its columns, "
            "the report of `diagnose` shows its signals"
        )
    page = Path(options.html or writable_file(str(bag.with_name(f"{bag.stem if bag.is_file() else bag.name}.html"))))
    beside = bag.parent / REPORT_FILE
    report = options.report or (beside if beside.is_file() else None)
    recorded = read_page(options.bag, (options.begin, options.end), report)
    page.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(page, render_page(recorded).encode())
    print(page)
    if options.open:
        webbrowser.open(page.absolute().as_uri())
