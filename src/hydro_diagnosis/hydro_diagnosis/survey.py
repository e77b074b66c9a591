# SPDX-License-Identifier: Apache-2.0
"""Recordings too long to hold in memory: looked through in stretches, of which only the telling windows are kept.

A bag is read twice. First every window of 10 s is judged by where it takes the bench, and forgotten; then those that
together visit most of position and velocity, of current and pressure, and of the recording's length, are read again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from hydro_bridge.recording import RecordingError, stream_bag
from hydro_bridge.signals import STATE_FIELDS, StateArray
from hydro_diagnosis.quality import checked
from hydro_diagnosis.recording import InputError, Recording, Segment, UnusableRecordingError
from hydro_diagnosis.table import RawTable
from hydro_diagnosis.windows import WINDOW, Visits, telling
from hydro_sim.bench import Bench

STRETCH = 60_000
"""Samples that are looked at together."""
WHOLE = 5
"""Stretches that are still held whole."""
FITTED, HELD = 10, 5
"""Windows kept of the first two thirds, and of the last, which serves as what is held out where nothing else does."""
NOTES = 5
"""Notes on the quality of single stretches that are passed on."""


@dataclass(frozen=True)
class Stretch:
    """Some samples of a recording."""

    start: float
    """s since the start of the recording."""
    table: RawTable


def read_bag_within(path: Path, bench: Bench) -> Recording:
    """A recording that can be diagnosed, whole if it is short, else its telling windows.

    Raises
    ------
    InputError
        In one sentence that names the path.
    """
    try:
        stretches = _stretches(path)
        head = list(islice(stretches, WHOLE + 1))
        if len(head) <= WHOLE:
            return checked(_joined(path, head), bench)
        del head, stretches
        return _kept(path, bench, *_surveyed(_stretches(path), bench))
    except RecordingError as error:
        raise InputError(str(error)) from None


def _stretches(path: Path) -> Iterator[Stretch]:
    """The recording in stretches; samples are numbered on from one to the next."""
    first = last = number = None
    for states in _pieces(path):
        first = float(states["time"][0]) if first is None else first
        counter = states["sequence"] if last is None else np.concatenate([last, states["sequence"]])
        steps = np.diff(counter).view(np.int32).astype(np.float64)
        samples = np.concatenate([[0.0], np.cumsum(steps)]) if number is None else number + np.cumsum(steps)
        number, last = float(samples[-1]), states["sequence"][-1:].copy()
        columns = {name: np.ascontiguousarray(states[name]) for name in STATE_FIELDS}
        yield Stretch(float(states["time"][0]) - first, RawTable(path.name, states["time"].copy(), samples, columns))


def _pieces(path: Path) -> Iterator[StateArray]:
    """`STRETCH` samples at a time; what is left comes last."""
    parts: list[StateArray] = []
    for block in stream_bag(path):
        parts.append(block)
        while sum(map(len, parts)) >= STRETCH:
            states = np.concatenate(parts)
            parts = [states[STRETCH:].copy()]
            yield states[:STRETCH]
    if any(map(len, parts)):
        yield np.concatenate(parts)


def _joined(path: Path, stretches: list[Stretch]) -> RawTable:
    if not stretches:
        raise InputError(f"{path}: the recording is empty")
    tables = [one.table for one in stretches]
    columns = {name: np.concatenate([table.columns[name] for table in tables]) for name in tables[0].columns}
    samples = np.concatenate([table.sample for table in tables if table.sample is not None])
    return RawTable(path.name, np.concatenate([table.time for table in tables]), samples, columns)


@dataclass(frozen=True)
class _Window:
    """Where a window lies: which stretch, which of its segments, from which sample on."""

    stretch: int
    segment: int
    begin: int
    start: float
    """s since the start of the recording."""


def _surveyed(stretches: Iterator[Stretch], bench: Bench) -> tuple[list[_Window], Visits, list[str], float]:
    """Every window with where it takes the bench, notes, and the recording's length in s; the samples are forgotten."""
    windows, visits, notes, reasons, idle, end = [], Visits(bench), [], [], 0, 0.0
    for number, stretch in enumerate(stretches):
        end = stretch.start + 1e-3 * len(stretch.table.time)
        try:
            recording = checked(stretch.table, bench)
        except UnusableRecordingError as error:
            idle += 1
            reasons.append(error)
            continue
        notes += [f"{note} (from {stretch.start:.0f} s on)" for note in recording.quality]
        for index, segment in enumerate(recording.segments):
            for begin, window in _cut(segment):
                windows.append(_Window(number, index, begin, stretch.start + window.start))
                visits.add(window)
    if not windows:
        raise reasons[0] if reasons else UnusableRecordingError("no window of the recording is long enough")
    more = [f"{len(notes) - NOTES} more notes of this kind"] if len(notes) > NOTES else []
    idled = [f"{idle} stretches of {STRETCH * 1e-3:.0f} s show nothing: {reasons[0]}"] if idle else []
    return windows, visits, [*notes[:NOTES], *more, *idled], end


def _cut(segment: Segment) -> Iterator[tuple[int, Segment]]:
    length = round(WINDOW / segment.step)
    for begin in range(0, len(segment) - length + 1, length):
        yield begin, segment.cut(begin, begin + length)


def _kept(
    path: Path, bench: Bench, windows: list[_Window], visits: Visits, notes: list[str], seconds: float
) -> Recording:
    """The telling windows, read again."""
    early = [k for k, window in enumerate(windows) if window.start < seconds * 2.0 / 3.0]
    late = [k for k in range(len(windows)) if k not in set(early)]
    chosen = {*telling(visits, FITTED, early), *telling(visits, HELD, late)}
    by_stretch: dict[int, list[_Window]] = {}
    for k in sorted(chosen):
        by_stretch.setdefault(windows[k].stretch, []).append(windows[k])
    segments = []
    for number, stretch in enumerate(_stretches(path)):
        found = checked(stretch.table, bench).segments if number in by_stretch else ()
        for window in by_stretch.get(number, []):
            segment = found[window.segment]
            kept = segment.cut(window.begin, window.begin + round(WINDOW / segment.step))
            channels = {name: values.copy() for name, values in kept.channels.items()}
            segments.append(replace(kept, start=window.start, channels=channels))
    notes.append(
        f"{path.name}: of {seconds:.0f} s {len(segments)} windows of {WINDOW:g} s were kept, which together visit most "
        "positions, velocities, currents and pressures; no other sample was judged"
    )
    return Recording(path.name, tuple(segments), tuple(notes))
