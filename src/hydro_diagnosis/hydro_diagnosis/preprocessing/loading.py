# SPDX-License-Identifier: Apache-2.0
"""Data sets: recordings are read once, split into fitted and held-out parts, and trimmed.

Recordings too long for memory are read in stretches, twice. The first pass counts the states that each window of 10 s
visits; the second reads the windows that together cover most of position and velocity, of current and pressure, and of
the recording's length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import combinations, islice, pairwise, product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags import exists, is_bag
from hydro_bridge.bags.recording import RecordingError, stream_bag
from hydro_core.signals import SAMPLE_PERIOD, STATE_FIELDS, FloatArray, StateArray
from hydro_diagnosis.bench_parameters import require_equation
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import Columns, median_step
from hydro_diagnosis.io.table import RawTable, columns_of, map_bag_fields, table_of
from hydro_diagnosis.io.topics import has_states
from hydro_diagnosis.preprocessing.quality import (
    MIN_SEGMENT_TIME,
    REMEDY,
    check_recording,
    least_travel,
)
from hydro_diagnosis.preprocessing.smoothing import STRIDE, kinematics
from hydro_diagnosis.recording import (
    HELD_THIRD_NOTE,
    MEASURED_CHANNELS,
    InputError,
    Recording,
    Segment,
    UnusableRecordingError,
    ambiguous_paths,
)
from hydro_diagnosis.wiring import PlausibilityCheck, check_plausibility
from hydro_sim.model.bench import Bench


def load_dataset(
    recordings: Sequence[str | Path], holdout: Sequence[str | Path], bench: Bench, columns: ColumnMap | None = None,
    inspection: PlausibilityCheck | None = None, reader: RecordingReader | None = None,
) -> tuple[list[Segment], list[Segment], list[str]]:  # fmt: skip
    """Return the segments to fit, the held-out segments, and notes on their quality; `columns`: as of `read_table`.

    `inspection` collects the doubts about the wiring of each recording, also if none can be diagnosed. `reader` holds
    what earlier calls have read; None: a new one.

    Raises InputError if no recording can be diagnosed, or two share data: held-out data must not be fitted.
    """
    inspection = PlausibilityCheck() if inspection is None else inspection
    in_full = ambiguous_paths([*recordings, *holdout])
    reader = reader or RecordingReader()
    to_fit, notes = _read(recordings, reader, bench, columns, inspection, in_full)
    to_check, more_notes = _read(holdout, reader, bench, columns, inspection, in_full, spare=True)
    _refuse_twice([*to_fit, *to_check])
    if not to_fit:
        raise InputError("no recording was given")
    quality = [*notes, *more_notes]
    if not to_check and len(to_fit) > 1:
        to_check = [to_fit.pop()]
        quality.append(f"{to_check[0].name} was held back to check on")
    fitted = [segment for recording in to_fit for segment in recording.segments]
    held = [segment for recording in to_check for segment in recording.segments]
    recorded = fitted
    if not to_check:
        fitted, held = split(fitted)
        quality.append(HELD_THIRD_NOTE)
    if fitted:
        require_equation(set.intersection(*(set(one.channels) for one in fitted)), bench, notes)
    _refuse_too_little(fitted, recorded, bench)
    fitted = _most_informative(fitted, "fitted", bench, quality)
    return fitted, _most_informative(held, "checked on", bench, quality), quality


BLOCKS = 9
"""Largest number of blocks of an only recording, of which every third is held out."""


def split(segments: Sequence[Segment]) -> tuple[list[Segment], list[Segment]]:
    """Return the fitted and the held-out segments of an only recording: its last third is held out.

    If that moves in another range, as where amplitudes grow, every third of up to `BLOCKS` blocks is, of two strokes or
    more each, so that both parts share the range.
    """
    fitted, held = _in_blocks(segments, 3)
    lasted = sum(len(one) * one.step for one in segments)
    most = min(lasted / (2.0 * MIN_SEGMENT_TIME), sum(map(_strokes, segments)) / 2.0, BLOCKS)
    return _in_blocks(segments, int(most) // 3 * 3) if most >= 6.0 and _beyond(fitted, held) else (fitted, held)


def _in_blocks(segments: Sequence[Segment], blocks: int) -> tuple[list[Segment], list[Segment]]:
    """Fitted and held-out segments, every third block of equal length; rests under `MIN_SEGMENT_TIME` are left out."""
    lasted = sum(len(one) * one.step for one in segments)
    parts: tuple[list[Segment], list[Segment]] = ([], [])
    before = 0.0
    for segment in segments:
        borders = ((np.arange(blocks + 1) * lasted / blocks - before) / segment.step).clip(0, len(segment)) + 1e-6
        for block, (begin, end) in enumerate(pairwise(borders.astype(int).tolist())):
            if block % 3 == 1:  # the second of three goes on from the first
                continue
            end = int(borders[block + 2]) if block % 3 == 0 else end
            if end - begin == len(segment) or (end - begin) * segment.step >= MIN_SEGMENT_TIME:
                parts[block % 3 == 2].append(segment.cut(begin, end))
        before += len(segment) * segment.step
    return parts


def _beyond(fitted: Sequence[Segment], held: Sequence[Segment]) -> bool:
    """Whether held-out segments move at speeds, or in places, beyond the fitted ones' by a quarter of their range."""
    if not fitted or not held or any("piston_position" not in one.channels for one in (*fitted, *held)):
        return False
    places = [np.concatenate([one.channels["piston_position"] for one in part]) for part in (fitted, held)]
    speeds = [
        max(float(np.percentile(np.abs(kinematics(one.channels["piston_position"], one.step, one.spacing)[1]), 99.0))
            for one in part)
        for part in (fitted, held)
    ]  # fmt: skip
    margin = 0.25 * float(np.ptp(places[0]))
    outside = places[1].min() < places[0].min() - margin or places[1].max() > places[0].max() + margin
    return bool(outside or speeds[1] > 1.25 * speeds[0])


def _strokes(segment: Segment) -> float:
    """Number of strokes of the piston: runs between turns by more than a tenth of its range."""
    position = segment.channels.get("piston_position")
    if position is None:
        return np.inf
    turn, count, side = 0.1 * float(np.ptp(position)), 0, 0
    extreme = float(position[0])
    for place in position[:: max(len(position) // 5000, 1)].tolist():
        if side * (place - extreme) > 0.0:
            extreme = place
        elif abs(place - extreme) > turn:
            side, extreme, count = (1 if place > extreme else -1), place, count + 1
    return count


def _refuse_twice(recordings: list[Recording]) -> None:
    """Raise InputError for copies: of recordings with a segment in which all sensors of both read the same.

    A single channel does not tell: a force may be computed from a command that two runs share.
    """
    contents = [  # what each sensor that moves read in each segment; in single precision, as any file has it
        [
            {
                name: sha256(segment.channels[name].astype(np.float32).tobytes()).digest()
                for name in MEASURED_CHANNELS
                if name in segment.channels and np.ptp(segment.channels[name]) > 0.0
            }
            for segment in recording.segments
        ]
        for recording in recordings
    ]
    for (one, first), (other, second) in combinations(zip(recordings, contents, strict=True), 2):
        for read, again in product(first, second):
            common = read.keys() & again.keys()
            if not common or any(read[name] != again[name] for name in common):
                continue
            raise InputError(f"{one.name} and {other.name} hold the same samples: give each recording once")


def _motion(segments: list[Segment], bench: Bench) -> tuple[float, float]:
    """Time for which the piston moves, and time recorded [s]; motion is counted in blocks of a quarter of a second."""
    moving = lasted = 0.0
    for segment in segments:
        length = max(round(0.25 / segment.step), 1)
        least = least_travel(segment.channels["piston_position"], bench) / 10.0
        position = segment.channels["piston_position"][: len(segment) // length * length].reshape(-1, length)
        lasted += len(segment) * segment.step
        moving += 0.25 * float(np.count_nonzero(np.ptp(position, axis=1) > least))
    return moving, lasted


def _refuse_too_little(fitted: list[Segment], recorded: list[Segment], bench: Bench) -> None:
    """Raise UnusableRecordingError for too little motion in `fitted`: any hypothesis would fit.

    `recorded`: before a part was held out, of which the sentence speaks.
    """
    if any("piston_position" not in segment.channels for segment in recorded):
        return
    if _motion(fitted, bench)[0] >= 2.0 * MIN_SEGMENT_TIME:
        return
    moving, lasted = _motion(recorded, bench)
    remedy = REMEDY if moving < 0.5 * lasted else "record 20 s of motion or more"
    raise UnusableRecordingError(
        f"the piston moves for {moving:.1f} s in all of what can be used: too little to be diagnosed; {remedy}"
    )


def _read(
    paths: Sequence[str | Path], reader: RecordingReader, bench: Bench, columns: ColumnMap | None,
    inspection: PlausibilityCheck, in_full: set[Path], *, spare: bool = False,
) -> tuple[list[Recording], list[str]]:  # fmt: skip
    """Recordings that can be diagnosed, and notes on their quality and on refused ones.

    If all are refused, the first error is raised, unless another recording can replace them (`spare`).
    """
    recordings, refused = list[Recording](), list[UnusableRecordingError]()

    def inspected(table: RawTable) -> RawTable:
        shown = check_plausibility(table, bench)
        inspection.doubts += shown.doubts
        inspection.units.update(shown.units)
        return table

    for path in map(Path, paths):
        try:
            if reader.is_state_bag(path):
                found = check_bag(path, bench, columns, inspected, reader)
            else:
                found = check_long_table(inspected(table_of(path, reader.columns(path), columns)), bench)
        except UnusableRecordingError as error:
            refused.append(error)
        else:
            if path in in_full:
                segments = tuple(replace(one, recording=str(path)) for one in found.segments)
                found = replace(found, name=str(path), segments=segments)
            recordings.append(found)
    if refused and not recordings and not spare:
        raise refused[0]
    notes = [f"{error}; it was left out" for error in refused]
    return recordings, [*notes, *(note for recording in recordings for note in recording.quality)]


def _most_informative(segments: list[Segment], what: str, bench: Bench, quality: list[str]) -> list[Segment]:
    """The most informative windows of the segments, `MAX_DATA_TIME` seconds at most, with a note."""
    total = sum(len(segment) * segment.step for segment in segments)
    if total <= MAX_DATA_TIME:
        return segments
    pieces, occupancy = [], StateOccupancy(bench)
    for segment in segments:
        length = window_length(segment)
        for at in range(0, max(len(segment) - length + 1, 1), length):
            pieces.append(segment.cut(at, at + length))
            occupancy.add(pieces[-1])
    kept = occupancy.select(int(MAX_DATA_TIME / WINDOW_TIME))
    quality.append(
        f"of {total:.0f} s the {len(kept)} most informative windows of {length * segment.step:.3g} s were {what}"
    )
    return [pieces[k] for k in kept]


# --- long recordings -----------------------------------------------------------------------------------------------

WINDOW_TIME = 10.0
"""Length of a window [s], unless the logger is slow: then a window has 100 rows."""


def window_length(segment: Segment) -> int:
    """Return the number of a segment's samples in a window."""
    return max(round(WINDOW_TIME / segment.step), 100 * segment.spacing)


_UNIFORM_EDGES = np.linspace(0.0, 1.0, 17)[1:-1]
"""Edges of the bins of position (shares of the stroke) and of pressure difference (shares of the supply)."""


class StateOccupancy:
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
            edges = [
                -1.2,
                -0.4,
                -0.12,
                -0.04,
                0.04,
                0.12,
                0.4,
                1.2,
            ]  # strokes a second: finer where friction changes most
            here = np.digitize(position / bench.stroke, _UNIFORM_EDGES) * 9
            here = here + np.digitize(velocity / bench.stroke, edges)
        if "valve_current" in channels:
            edges = [-0.3, -0.1, -0.03, -0.01, 0.01, 0.03, 0.1, 0.3]  # shares of the largest current
            there = np.digitize(channels["valve_current"] / bench.valve_current_max, edges)
        if {"pressure_a", "pressure_b"} <= channels.keys():
            difference = channels["pressure_a"] - channels["pressure_b"]
            there = there + 9 * np.digitize(0.5 * (1.0 + difference / bench.supply_pressure), _UNIFORM_EDGES)
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


STRETCH_SAMPLES = 60_000
"""Samples read at a time."""
MAX_DATA_TIME = 300.0
"""Largest duration [s] of fitted and of held-out data; longer data are reduced to informative windows, with a note."""
MAX_WHOLE_STRETCHES = round(MAX_DATA_TIME / (STRETCH_SAMPLES * SAMPLE_PERIOD))
"""Largest number of stretches of a recording that is used whole."""


CACHE_BYTES_MAX = 256e6
"""Largest memory of the recordings that a reader keeps; 300 s at 1 kHz with all fields of BenchState have 45 MB."""


class RecordingReader:
    """Reader of recordings, each read once, whatever column maps are applied to it: the hypotheses of a diagnosis.

    Files of more than `MAX_DATA_TIME` at 1 kHz, and those beyond `CACHE_BYTES_MAX` in all, are read again by each call.
    """

    def __init__(self) -> None:
        self._columns: dict[Path, Columns] = {}
        self._bags: dict[Path, tuple[list[RawTable], list[str]]] = {}
        self._long: set[Path] = set()
        self._has_states: dict[Path, bool] = {}
        self._bytes = 0

    def clear(self) -> None:
        """Release the memory."""
        self._columns, self._bags, self._bytes = {}, {}, 0

    def is_state_bag(self, path: Path) -> bool:
        """Return whether a recording is a bag with /hydro/state."""
        if path not in self._has_states:
            self._has_states[path] = exists(path) and is_bag(path) and has_states(path)
        return self._has_states[path]

    def _fits(self, rows: int, columns: int) -> bool:
        """Return whether so many numbers may be kept, and count them."""
        size = 8 * rows * columns
        fits = rows <= MAX_WHOLE_STRETCHES * STRETCH_SAMPLES and self._bytes + size <= CACHE_BYTES_MAX
        self._bytes += size if fits else 0
        return fits

    def columns(self, path: Path) -> Columns:
        """Return the columns of a file (`table.columns_of`). Raises InputError with a message that names the path."""
        if path in self._columns:
            return self._columns[path]
        found = columns_of(path)
        if self._fits(max(map(len, found.series.values()), default=0), len(found.series)):
            self._columns[path] = found
            for values in found.series.values():
                values.setflags(write=False)  # a column map makes new arrays, or refers to these
        return found

    def stretches(self, path: Path, notes: list[str]) -> Iterator[RawTable]:
        """Yield a bag's samples in stretches of `STRETCH_SAMPLES`; appends notes on its reading to `notes`."""
        if path in self._bags:
            head, said = self._bags[path]
            notes += said
            yield from head
            return
        said = []
        stretches = _stretches(path, said)
        head = [] if path in self._long else list(islice(stretches, MAX_WHOLE_STRETCHES + 1))
        if len(head) > MAX_WHOLE_STRETCHES:
            self._long.add(path)
        elif head and self._fits(sum(len(one.time) for one in head), 2 + len(head[0].columns)):
            self._bags[path] = list(head), said
        while head:
            yield head.pop(0)
        yield from stretches
        notes += said


def check_bag(
    path: Path,
    bench: Bench,
    columns: ColumnMap | None = None,
    inspected: Callable[[RawTable], RawTable] = lambda table: table,
    reader: RecordingReader | None = None,
) -> Recording:
    """Read a bag with /hydro/state and check it: whole if it is short, else its informative windows.

    `columns` is applied to its fields (`table.map_bag_fields`); `inspected` is called with the table or first stretch.

    Raises InputError if it cannot be diagnosed; the message names the path.
    """
    reader, notes = reader or RecordingReader(), list[str]()

    def stretches() -> Iterator[RawTable]:
        for table in reader.stretches(path, notes):
            yield table if columns is None else map_bag_fields(path, table, columns)

    try:
        begun = stretches()
        head = list(islice(begun, MAX_WHOLE_STRETCHES + 1))
        if not head:
            raise InputError(f"{path}: the recording is empty")
        if len(head) <= MAX_WHOLE_STRETCHES:
            whole = {name: np.concatenate([table.columns[name] for table in head]) for name in head[0].columns}
            numbers = [table.sample for table in head if table.sample is not None]
            samples = np.concatenate(numbers) if len(numbers) == len(head) else None
            time, said = np.concatenate([table.time for table in head]), (*notes, *head[0].notes)
            return check_recording(inspected(RawTable(path.name, time, samples, whole, said, head[0].units)), bench)
        inspected(head[0])
        del head, begun
        found = _informative(path.name, bench, stretches)
        return replace(found, quality=(*(f"{path.name}: {note}" for note in dict.fromkeys(notes)), *found.quality))
    except RecordingError as error:
        raise InputError(str(error)) from None


def check_long_table(table: RawTable, bench: Bench) -> Recording:
    """Check a table in memory as `check_bag` does a bag, one stretch at a time if it is long.

    Raises InputError if it cannot be diagnosed; the message names the recording.
    """
    rows = max(round(STRETCH_SAMPLES * SAMPLE_PERIOD / median_step(table.time)), STRETCH_SAMPLES)
    if len(table.time) <= MAX_WHOLE_STRETCHES * rows:
        return check_recording(table, bench)

    def stretches() -> Iterator[RawTable]:
        """Yield views of the table; its notes come with the first."""
        for begin in range(0, len(table.time), rows):
            part = slice(begin, begin + rows)
            columns = {name: values[part] for name, values in table.columns.items()}
            sample = None if table.sample is None else table.sample[part]
            yield RawTable(table.name, table.time[part], sample, columns, table.notes if begin == 0 else ())

    return _informative(table.name, bench, stretches)


def _stretches(path: Path, notes: list[str]) -> Iterator[RawTable]:
    """Yield the recording in stretches; the box's sample numbers continue from one to the next."""
    last = number = None
    for states in _pieces(path, notes):
        counter = states["sequence"] if last is None else np.concatenate([last, states["sequence"]])
        steps = np.diff(counter).view(np.int32).astype(np.float64)
        samples = np.concatenate([[0.0], np.cumsum(steps)]) if number is None else number + np.cumsum(steps)
        number, last = float(samples[-1]), states["sequence"][-1:].copy()
        fields = {name: np.ascontiguousarray(states[name]) for name in STATE_FIELDS}
        yield RawTable(path.name, states["time"].copy(), samples, fields)


def _pieces(path: Path, notes: list[str]) -> Iterator[StateArray]:
    """Yield blocks of `STRETCH_SAMPLES` samples; the last may be shorter."""
    parts: list[StateArray] = []
    for block in stream_bag(path, notes=notes, skip_damaged=True):
        parts.append(block)
        while sum(map(len, parts)) >= STRETCH_SAMPLES:
            states = np.concatenate(parts)
            parts = [states[STRETCH_SAMPLES:].copy()]
            yield states[:STRETCH_SAMPLES]
    if any(map(len, parts)):
        yield np.concatenate(parts)


def _informative(recording: str, bench: Bench, stretches: Callable[[], Iterator[RawTable]]) -> Recording:
    """Recording of the informative windows, selected in a first pass over the stretches and read in a second."""
    windows: list[tuple[int, int, int, float]] = []  # stretch, segment in it, first sample, s since the start
    occupancy, notes, idle = StateOccupancy(bench), list[str](), list[UnusableRecordingError]()
    origin = seconds = 0.0
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
            length = window_length(segment)
            for begin in range(0, len(segment) - length + 1, length):
                window = segment.cut(begin, begin + length)
                windows.append((number, index, begin, start + window.start))
                occupancy.add(window)
    if not windows:
        raise idle[0] if idle else UnusableRecordingError("no window of the recording is long enough")
    notes[5:] = [f"{len(notes) - 5} more notes of this kind"] if len(notes) > 5 else []
    if idle:
        notes.append(f"{len(idle)} stretches of {STRETCH_SAMPLES * 1e-3:.0f} s show nothing: {idle[0]}")
    early = [k for k, (*_, start) in enumerate(windows) if start < seconds * 2.0 / 3.0]
    late = [k for k, (*_, start) in enumerate(windows) if not start < seconds * 2.0 / 3.0]
    chosen = sorted({*occupancy.select(10, early), *occupancy.select(5, late)})  # the last third may be held out
    segments = []
    for number, table in enumerate(stretches()):
        here = [windows[k] for k in chosen if windows[k][0] == number]
        checked_again = check_recording(table, bench).segments if here else ()
        for _, index, begin, start in here:
            segment = checked_again[index]
            kept = segment.cut(begin, begin + window_length(segment))
            channels = {name: values.copy() for name, values in kept.channels.items()}
            segments.append(replace(kept, start=start, channels=channels))
    notes.append(
        f"{recording}: of {seconds:.0f} s the {len(segments)} most informative windows of {WINDOW_TIME:g} s were kept"
    )
    return Recording(recording, tuple(segments), tuple(notes))
