# SPDX-License-Identifier: Apache-2.0
"""Recordings too long for memory: read in stretches, of which only the informative windows are retained.

A bag is read twice. The first pass counts the states that each window of 10 s visits; the second reads the windows that
together cover most of position and velocity, of current and pressure, and of the recording's length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags.recording import RecordingError, stream_bag
from hydro_core.signals import SAMPLE_PERIOD, STATE_FIELDS, FloatArray, StateArray
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import median_step
from hydro_diagnosis.io.table import RawTable, mapped
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.preprocessing.smoothing import STRIDE, kinematics
from hydro_diagnosis.recording import InputError, Recording, Segment, UnusableRecordingError
from hydro_sim.model.bench import Bench

WINDOW = 10.0
"""Length of a window [s]."""
_SPEEDS = np.array([-0.1, -0.03, -0.01, -0.003, 0.003, 0.01, 0.03, 0.1])
"""Edges of the velocity bins [m/s]: finer where friction changes most."""
_OPENINGS = np.array([-0.3, -0.1, -0.03, -0.01, 0.01, 0.03, 0.1, 0.3])
"""Edges of the current bins, as shares of the largest current."""
_PLACES = np.linspace(0.0, 1.0, 17)[1:-1]
"""Edges of the bins of position (shares of the stroke) and of pressure difference (shares of the supply)."""


class Visits:
    """Occupancy per window: sample counts in cells of position by velocity and of current by pressure difference."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._cells: list[FloatArray] = []
        self._starts: list[float] = []

    def add(self, window: Segment) -> None:
        """Append the occupancy of one window."""
        channels, bench = window.channels, self._bench
        here: npt.NDArray[np.integer] = np.zeros(len(window), dtype=np.int64)
        there: npt.NDArray[np.integer] = np.zeros(len(window), dtype=np.int64)
        if "piston_position" in channels:
            position, velocity, _ = kinematics(channels["piston_position"], window.step, window.spacing)
            here = np.digitize(position / bench.stroke, _PLACES) * 9 + np.digitize(velocity, _SPEEDS)
        if "valve_current" in channels:
            there = np.digitize(channels["valve_current"] / bench.valve_current_max, _OPENINGS)
        if {"pressure_a", "pressure_b"} <= channels.keys():
            difference = channels["pressure_a"] - channels["pressure_b"]
            there = there + 9 * np.digitize(0.5 * (1.0 + difference / bench.supply_pressure), _PLACES)
        counts = [np.bincount(cells[::STRIDE], minlength=9 * 16) for cells in (here, there)]
        self._cells.append(np.concatenate(counts).astype(np.float64))
        self._starts.append(window.start)

    def select(self, count: int, among: Sequence[int] | None = None) -> list[int]:
        """Select at most `count` windows greedily, by the increase of the summed square roots of all cells' counts.

        A window also counts in a cell for its tenth of the recording's length, so that drift is observed. `among`:
        indices of the candidate windows, None for all. Returns ascending indices.
        """
        starts, cells = np.array(self._starts), np.array(self._cells)
        part = np.minimum((starts / max(float(starts.max()), 1e-9) * 10).astype(np.int64), 9)
        cells = np.hstack([cells, np.eye(10)[part] * cells.sum(axis=1, keepdims=True) / 2.0])
        open_ = list(range(len(cells)) if among is None else among)
        chosen: list[int] = []
        held = np.zeros(cells.shape[1])
        while open_ and len(chosen) < count:
            gains: npt.NDArray[np.float64] = np.sqrt(held + cells[open_]).sum(axis=1)
            chosen.append(open_.pop(int(np.argmax(gains))))
            held += cells[chosen[-1]]
        return sorted(chosen)


STRETCH = 60_000
"""Samples read at a time."""
LONGEST = 300.0
"""Largest duration [s] of fitted and of held-out data; longer data are reduced to informative windows, with a note."""
WHOLE = round(LONGEST / (STRETCH * SAMPLE_PERIOD))
"""Largest number of stretches of a recording that is used whole."""


def read_bag_within(
    path: Path,
    bench: Bench,
    columns: ColumnMap | None = None,
    inspected: Callable[[RawTable], RawTable] = lambda table: table,
) -> Recording:
    """Read a bag with /hydro/state and check it: whole if it is short, else its informative windows.

    `columns` is applied to its fields (`table.mapped`); `inspected` is called with the whole table or first stretch.

    Raises InputError if it cannot be diagnosed; the message names the path.
    """
    notes: list[str] = []
    try:
        stretches = _stretches(path, columns, notes)
        head = list(islice(stretches, WHOLE + 1))
        if not head:
            raise InputError(f"{path}: the recording is empty")
        if len(head) <= WHOLE:
            whole = {name: np.concatenate([table.columns[name] for table in head]) for name in head[0].columns}
            numbers = [table.sample for table in head if table.sample is not None]
            samples = np.concatenate(numbers) if len(numbers) == len(head) else None
            time, said = np.concatenate([table.time for table in head]), (*notes, *head[0].notes)
            return check_recording(inspected(RawTable(path.name, time, samples, whole, said, head[0].units)), bench)
        inspected(head[0])
        del head, stretches
        found = _informative(path.name, bench, lambda: _stretches(path, columns, notes))
        return replace(found, quality=(*(f"{path.name}: {note}" for note in dict.fromkeys(notes)), *found.quality))
    except RecordingError as error:
        raise InputError(str(error)) from None


def table_within(table: RawTable, bench: Bench) -> Recording:
    """Check a table in memory as `read_bag_within` does a bag, one stretch at a time if it is long.

    Raises InputError if it cannot be diagnosed; the message names the recording.
    """
    rows = max(round(STRETCH * SAMPLE_PERIOD / median_step(table.time)), STRETCH)
    if len(table.time) <= WHOLE * rows:
        return check_recording(table, bench)

    def stretches() -> Iterator[RawTable]:
        """Yield views of the table; its notes come with the first."""
        for begin in range(0, len(table.time), rows):
            part = slice(begin, begin + rows)
            columns = {name: values[part] for name, values in table.columns.items()}
            sample = None if table.sample is None else table.sample[part]
            yield RawTable(table.name, table.time[part], sample, columns, table.notes if begin == 0 else ())

    return _informative(table.name, bench, stretches)


def _stretches(path: Path, columns: ColumnMap | None, notes: list[str]) -> Iterator[RawTable]:
    """Yield the recording in stretches; the box's sample numbers continue from one to the next."""
    last = number = None
    for states in _pieces(path, notes):
        counter = states["sequence"] if last is None else np.concatenate([last, states["sequence"]])
        steps = np.diff(counter).view(np.int32).astype(np.float64)
        samples = np.concatenate([[0.0], np.cumsum(steps)]) if number is None else number + np.cumsum(steps)
        number, last = float(samples[-1]), states["sequence"][-1:].copy()
        fields = {name: np.ascontiguousarray(states[name]) for name in STATE_FIELDS}
        table = RawTable(path.name, states["time"].copy(), samples, fields)
        yield table if columns is None else mapped(path, table, columns)


def _pieces(path: Path, notes: list[str]) -> Iterator[StateArray]:
    """Yield blocks of `STRETCH` samples; the last may be shorter."""
    parts: list[StateArray] = []
    for block in stream_bag(path, notes=notes, salvages=True):
        parts.append(block)
        while sum(map(len, parts)) >= STRETCH:
            states = np.concatenate(parts)
            parts = [states[STRETCH:].copy()]
            yield states[:STRETCH]
    if any(map(len, parts)):
        yield np.concatenate(parts)


def _informative(recording: str, bench: Bench, stretches: Callable[[], Iterator[RawTable]]) -> Recording:
    """Recording of the informative windows, selected in a first pass over the stretches and read in a second."""
    windows: list[tuple[int, int, int, float]] = []  # stretch, segment in it, first sample, s since the start
    visits, notes, idle, origin, seconds = Visits(bench), list[str](), list[UnusableRecordingError](), 0.0, 0.0
    for number, table in enumerate(stretches()):
        origin = origin if number else float(table.time[0])
        start, seconds = (float(table.time[at]) - origin for at in (0, -1))
        try:
            found = check_recording(table, bench)
        except UnusableRecordingError as error:
            idle.append(error)
            continue
        notes += [f"{note} (from {start:.0f} s on)" for note in found.quality]
        for index, segment in enumerate(found.segments):
            length = round(WINDOW / segment.step)
            for begin in range(0, len(segment) - length + 1, length):
                window = segment.cut(begin, begin + length)
                windows.append((number, index, begin, start + window.start))
                visits.add(window)
    if not windows:
        raise idle[0] if idle else UnusableRecordingError("no window of the recording is long enough")
    notes[5:] = [f"{len(notes) - 5} more notes of this kind"] if len(notes) > 5 else []
    if idle:
        notes.append(f"{len(idle)} stretches of {STRETCH * 1e-3:.0f} s show nothing: {idle[0]}")
    early = [k for k, (*_, start) in enumerate(windows) if start < seconds * 2.0 / 3.0]
    late = [k for k, (*_, start) in enumerate(windows) if not start < seconds * 2.0 / 3.0]
    chosen = sorted({*visits.select(10, early), *visits.select(5, late)})  # the last third may be held out
    segments = []
    for number, table in enumerate(stretches()):
        here = [windows[k] for k in chosen if windows[k][0] == number]
        checked_again = check_recording(table, bench).segments if here else ()
        for _, index, begin, start in here:
            segment = checked_again[index]
            kept = segment.cut(begin, begin + round(WINDOW / segment.step))
            channels = {name: values.copy() for name, values in kept.channels.items()}
            segments.append(replace(kept, start=start, channels=channels))
    notes.append(
        f"{recording}: of {seconds:.0f} s {len(segments)} windows of {WINDOW:g} s were kept, which together visit most "
        "positions, velocities, currents and pressures; no other sample was judged"
    )
    return Recording(recording, tuple(segments), tuple(notes))
