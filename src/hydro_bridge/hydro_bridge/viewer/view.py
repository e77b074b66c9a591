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
from collections.abc import Callable
from dataclasses import dataclass, field
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
from hydro_bridge.bags.steady import MonotonicTimes
from hydro_bridge.bags.storage import BagSource, MessageDecoder, Table, decode_span
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.dashboard import series, status
from hydro_bridge.pages import environment
from hydro_bridge.viewer.marks import Mark, MarkCollector, find_report, read_windows, select_windows
from hydro_core.cli.console import UserError, bounded_number, command, make_parser, writable_file
from hydro_core.files.atomic import write_whole
from hydro_core.signals import FloatArray

CLOCK_OFFSET_MAX = 2.0
"""s between stamp and log time beyond which they belong to two clocks; a recorder's delay stays below."""


GAP_MAX = 3600.0
"""s without samples that the page does not show."""


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
"""Without it the paper's law acted."""
TOPIC_CONTENTS = {
    CORRECTION_TOPIC: "the filter's correction and certificate",
    TRAINING_TOPIC: "episodes and examinations",
    POLICY_TOPIC: "which weights acted",
    AUTHORITY_TOPIC: "who commanded",
    DIAGNOSTICS_TOPIC: "rollbacks and overrides",
    LOG_TOPIC: "who asked to arm, disarm or override, and what the nodes warned of,",
}
"""Content of the page that depends on each topic."""

_NEEDED = {
    STATE_TOPIC: frozenset[str](),  # `as_states` says what is missing
    CORRECTION_TOPIC: frozenset(column.field for column in series.CORRECTION_COLUMNS),
    LAW_TOPIC: frozenset(column.field for column in series.LAW_COLUMNS),
    TRAINING_TOPIC: frozenset(
        {"phase", "episode", "episode_return", "force_rmse", "critic_loss", "actor_loss", "learner_alive"}
    ),
    POLICY_TOPIC: frozenset({"weights"}),
}
_OBJECTS = {
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
    slot: float
    """s."""
    values: tuple[npt.NDArray[np.float32], ...]
    """States, corrections and laws: minimum and maximum, shape (slots, columns, 2)."""
    marks: list[Mark]
    curve: dict[str, Any]
    """Learning curve, as drawn by the live page."""
    messages: dict[str, int]
    """Number of messages by topic."""
    metadata: dict[str, str]
    attachments: list[str]
    notes: list[str]
    """Irregularities that the reader tolerated, and missing topics."""


@dataclass
class _Reading:
    """Content read so far."""

    span: tuple[float, float]
    """Requested part, s from the first sample."""
    begin: float = 0.0
    """s, of the first sample."""
    thinners: tuple[series.GrowingDownsampler, ...] = ()
    """Of states, corrections and laws; none before the first sample."""
    marks: MarkCollector = field(default_factory=MarkCollector)
    curve: status.LearningCurve = field(default_factory=status.LearningCurve)
    clock: SampleClock = field(default_factory=SampleClock)
    steady: dict[str, MonotonicTimes] = field(
        default_factory=lambda: {topic: MonotonicTimes(GAP_MAX) for topic in (STATE_TOPIC, CORRECTION_TOPIC, LAW_TOPIC)}
    )
    """Of the topics with the samples' stamps."""
    foreign: set[str] = field(default_factory=set)
    """Topics whose messages are of another version or type."""

    def within(self, table: Table) -> Table:
        """Return the requested part, which counts from the first sample."""
        if not self.thinners:
            return table[:0]
        since = table["time"] - self.begin
        return table[(since >= self.span[0]) & (since <= self.span[1])]

    def take_states(self, table: Table) -> None:
        """Add samples; all times count from the first one."""
        if not self.thinners and len(table):
            self.begin = float(table["time"][0])
            first = self.begin + self.span[0]
            self.thinners = tuple(series.GrowingDownsampler(len(columns), first) for columns in series.SERIES)
        table = self.within(table)
        if len(table):
            self.thinners[0].add(table["time"], series.state_values(table))
            self.marks.states(table)

    def take_series(self, number: int, table: Table) -> None:
        """Add corrections or states of the compensated law, by their number in `series.SERIES`."""
        table = self.within(table)
        if len(table):
            self.thinners[number].add(table["time"], series.column_values(series.SERIES[number], table))

    def take_training(self, table: Table) -> None:
        """Add the trainer's status."""
        for row in self.within(table):
            self.marks.training({name: row[name] for name in row.dtype.names})
            results = [float(row[name]) for name in ("force_rmse", "episode_return", "critic_loss", "actor_loss")]
            self.curve.add(int(row["phase"]), int(row["episode"]), *results)

    def take_object(self, topic: str, time: float, message: Any) -> None:
        """Add a message about the lease, of the diagnostics or of the log."""
        if topic == LOG_TOPIC:
            self.marks.log(time, int(message.level), message.name, message.msg)
            return
        if topic == AUTHORITY_TOPIC:
            self.marks.authority(time, message.holder)
            return
        for node in message.status:
            self.marks.diagnostics(time, node.name, {entry.key: entry.value for entry in node.values})


def read_page(path: Path | str, span: tuple[float, float] = (0.0, inf), report: Path | None = None) -> RecordingPage:
    """Read a recording into the content of its page.

    `path`: a rosbag2 folder or an .mcap file. `span`: part to show, s from the first sample; a shorter part is shown in
    finer detail. `report`: report.json of a diagnosis whose windows are marked. Raises RecordingError: the recording is
    missing, damaged, or has no bench samples at all or within the span; or the report is invalid.
    """
    windows = [] if report is None else read_windows(report)
    source = BagSource(Path(path))
    reading = _Reading(span=span)
    decoder = MessageDecoder(source)
    tables: dict[str, Callable[[Table], None]] = {
        STATE_TOPIC: lambda table: reading.take_states(as_states(table, source.path)),
        CORRECTION_TOPIC: lambda table: reading.take_series(1, table),
        LAW_TOPIC: lambda table: reading.take_series(2, table),
        TRAINING_TOPIC: reading.take_training,
        POLICY_TOPIC: lambda table: reading.marks.steps(reading.within(table)),
    }
    messages: dict[str, int] = {}
    for scan, channel, block, part in source.spans():
        topic = channel.topic
        messages[topic] = messages.get(topic, 0) + len(part.starts)
        if topic in tables:
            layout = source.layout(scan, channel)
            if layout is not None and set(layout.table.names or ()) >= _NEEDED[topic]:
                table = decode_span(scan.path, topic, layout, block, part)
                if topic in reading.steady:
                    table["time"] = reading.steady[topic].convert(table["time"])
                if topic == STATE_TOPIC:
                    reading.clock.update(part.log_times, table["time"])
                elif topic in (TRAINING_TOPIC, POLICY_TOPIC):  # the trainer stamps by the wall clock
                    table["time"] = reading.clock.sample_times(table["time"], 1e-9 * part.log_times)
                tables[topic](table)
            else:
                reading.foreign.add(topic)
        elif topic in _OBJECTS:
            if source.type_of(scan, channel)[0] != _OBJECTS[topic]:
                reading.foreign.add(topic)
                continue
            try:
                for logged, message in decoder.decode(scan, channel, block, part):
                    stamp = message.stamp if topic == LOG_TOPIC else message.header.stamp
                    time = float(reading.clock.sample_times(stamp.sec + 1e-9 * stamp.nanosec, logged))
                    reading.take_object(topic, time, message)
            except AttributeError:  # fields of another version
                reading.foreign.add(topic)
    for mark in select_windows(windows, Path(path), reading.begin):
        reading.marks.add(reading.begin + mark.time, mark.kind, mark.text)
    return _finished(source, reading, messages)


def _finished(source: BagSource, reading: _Reading, messages: dict[str, int]) -> RecordingPage:
    thinners = reading.thinners
    if not thinners:
        raise source.missing_topic_error(STATE_TOPIC, messages)
    begin = reading.begin + reading.span[0]
    slot = max(thinner.slot for thinner in thinners)
    values = tuple(thinner.values(slot) for thinner in thinners)
    if not len(values[0]):
        raise RecordingError(f"{source.path} has no samples from {reading.span[0]:g} to {reading.span[1]:g} s")
    seconds = thinners[0].end - begin
    metadata = {key: value for scan in source.scans for key, value in scan.metadata.get("hydro", {}).items()}
    return RecordingPage(
        path=source.path,
        begin=begin,
        seconds=seconds,
        slot=slot,
        values=values,
        marks=crop_marks(reading.marks.sorted(), begin, seconds),
        curve=reading.curve.content(),
        messages=messages,
        metadata=metadata,
        attachments=[name for scan in source.scans for name in scan.attachments],
        notes=[*source.notes, *_lacking(messages, reading)],
    )


def crop_marks(marks: list[Mark], begin: float, seconds: float) -> list[Mark]:
    """Return the marks from `begin` [s] for `seconds`, times relative to `begin`; the lease's holder comes first."""
    held = [mark for mark in marks if mark.kind == "authority" and mark.time < begin][-1:]
    shown = [Mark(begin, mark.kind, mark.text) for mark in held] + [mark for mark in marks if mark.time >= begin]
    return [Mark(mark.time - begin, mark.kind, mark.text) for mark in shown if mark.time - begin <= seconds]


def _lacking(messages: dict[str, int], reading: _Reading) -> list[str]:
    notes = [f"{topic} was not recorded: {what} cannot be shown" for topic, what in TOPIC_CONTENTS.items()
             if topic not in messages and (topic != POLICY_TOPIC or TRAINING_TOPIC in messages)]  # fmt: skip
    notes += [f"{topic} is of another version or type: it is not shown" for topic in sorted(reading.foreign)]
    notes += [f"the clock was set by {step:+.10g} s after {time - reading.begin:.1f} s: time goes on behind it"
              for time, step in reading.steady[STATE_TOPIC].jumps]  # fmt: skip
    if reading.marks.dropped:
        notes.append(f"{reading.marks.dropped} more marks are not shown: give a part of it by --from and --to")
    return notes


_POLICY = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data:"


def render_page(recorded: RecordingPage) -> str:
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


def _name(recorded: RecordingPage) -> str:
    folder = recorded.path.resolve()
    return f"{folder.parent.name}/{folder.name}" if folder.parent.name else folder.name


def _facts(recorded: RecordingPage) -> dict[str, str]:
    facts = {"length": f"{recorded.seconds:.1f} s", "finest detail": f"{1e3 * recorded.slot:g} ms", **recorded.metadata}
    return {**facts, **({"attached": ", ".join(recorded.attachments)} if recorded.attachments else {})}


def _about(recorded: RecordingPage) -> dict[str, Any]:
    """Return the script's data as JSON; non-finite values become null."""
    marks = [{"time": round(mark.time, 3), "kind": mark.kind, "text": mark.text} for mark in recorded.marks]
    about = {
        "seconds": recorded.seconds,
        "slot": recorded.slot,
        "series": series.column_descriptions(),
        "marks": marks,
        "curve": recorded.curve,
    }
    return dict(msgspec.json.decode(msgspec.json.encode(about)))


def _packed(values: npt.NDArray[np.float32]) -> str:
    return base64.b64encode(gzip.compress(np.ascontiguousarray(values, "<f4").tobytes(), 6, mtime=0)).decode()


def _module(name: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(_text(name).encode()).decode()}"


@cache
def _text(name: str) -> str:
    return resources.files("hydro_bridge").joinpath(name).read_text(encoding="utf-8")


def parser() -> argparse.ArgumentParser:
    """Return the argument parser."""
    result = make_parser("view", __doc__)
    result.add_argument("bag", type=Path, metavar="BAG", help="a rosbag2 folder or an .mcap file")
    result.add_argument(
        "--html", type=writable_file, metavar="FILE", help="the page (default: beside BAG, as BAG.html)"
    )
    result.add_argument(
        "--from", dest="begin", type=bounded_number(0.0), default=0.0, metavar="S", help="s from first sample"
    )
    result.add_argument(
        "--to", dest="end", type=bounded_number(0.0), default=inf, metavar="S", help="s from first sample"
    )
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
    page = Path(options.html or writable_file(str(bag.with_name(f"{bag.stem if bag.is_file() else bag.name}.html"))))
    report = options.report or find_report(bag)
    recorded = read_page(options.bag, (options.begin, options.end), report)
    page.parent.mkdir(parents=True, exist_ok=True)
    write_whole(page, render_page(recorded).encode())
    print(page)
    if options.open:
        webbrowser.open(page.absolute().as_uri())
