# SPDX-License-Identifier: Apache-2.0
"""Data sets: recordings are read, split into fitted and held-out parts, and trimmed.

Of long recordings, the windows that together cover most of the state space are retained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import combinations
from pathlib import Path

import numpy as np

from hydro_bridge.bags.location import exists, is_bag
from hydro_diagnosis.bench_numbers import require_equation
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import RawTable, read_table
from hydro_diagnosis.io.topics import has_states
from hydro_diagnosis.preprocessing.quality import MOVING, REMEDY, SATURATED, SHORTEST
from hydro_diagnosis.preprocessing.streaming import LONGEST, WINDOW, Visits, read_bag_within, table_within
from hydro_diagnosis.recording import (
    LAST_THIRD,
    MEASURED,
    InputError,
    Recording,
    Segment,
    UnusableRecordingError,
    named_in_full,
)
from hydro_diagnosis.wiring import PlausibilityCheck, check_plausibility
from hydro_sim.model.bench import Bench


def load_dataset(
    recordings: Sequence[str | Path], holdout: Sequence[str | Path], bench: Bench, columns: ColumnMap | None = None,
    inspection: PlausibilityCheck | None = None,
) -> tuple[list[Segment], list[Segment], list[str]]:  # fmt: skip
    """Return the segments to fit, the held-out segments, and notes on their quality; `columns`: as of `read_table`.

    `inspection` collects the doubts about the wiring of each recording, also if none can be diagnosed.

    Raises InputError if no recording can be diagnosed, or two share data: held-out data must not be fitted.
    """
    inspection = PlausibilityCheck() if inspection is None else inspection
    in_full = named_in_full([*recordings, *holdout])
    to_fit, notes = _read(recordings, bench, columns, inspection, in_full)
    to_check, more_notes = _read(holdout, bench, columns, inspection, in_full, spare=True)
    _refuse_twice([*to_fit, *to_check])
    if not to_fit:
        raise InputError("no recording was given")
    quality = [*notes, *more_notes]
    if not to_check and len(to_fit) > 1:
        to_check = [to_fit.pop()]
        quality.append(f"{to_check[0].name} was held back to check on")
    fitted = [segment for recording in to_fit for segment in recording.segments]
    held = [segment for recording in to_check for segment in recording.segments]
    if not to_check:
        quality.append(LAST_THIRD)
        border, whole, fitted = sum(map(len, fitted)) * 2 // 3, fitted, []
        for segment in whole:
            cut = min(max(border, 0), len(segment))
            border -= len(segment)
            if cut and (len(segment) == cut or cut * segment.step >= SHORTEST):
                fitted.append(segment.cut(0, cut))
            if cut < len(segment) and (cut == 0 or (len(segment) - cut) * segment.step >= SHORTEST):
                held.append(segment.cut(cut, len(segment)))
    require_equation(set.intersection(*(set(one.channels) for one in fitted)), bench, notes)
    _refuse_too_little(fitted, bench, notes)
    fitted = _informative(fitted, "fitted", bench, quality)
    return fitted, _informative(held, "checked on", bench, quality), quality


def _refuse_twice(recordings: list[Recording]) -> None:
    """Raise InputError for copies: a sensor's noise never repeats, so recordings with an equal segment are copies."""
    contents = [  # what each sensor that moves read in each segment; in single precision, as any file has it
        {
            (name, sha256(segment.channels[name].astype(np.float32).tobytes()).hexdigest())
            for segment in recording.segments
            for name in MEASURED
            if name in segment.channels and np.ptp(segment.channels[name]) > 0.0
        }
        for recording in recordings
    ]
    for (one, first), (other, second) in combinations(zip(recordings, contents, strict=True), 2):
        if first & second:
            twice, same = f"{one.name} was given twice", f"{one.name} and {other.name} hold the same"
            raise InputError(
                f"{twice if one.name == other.name else same}: what is checked on must not be fitted, and nothing "
                "counts twice"
            )


def _refuse_too_little(segments: list[Segment], bench: Bench, notes: list[str]) -> None:
    """Raise UnusableRecordingError for too little motion, of a bench that trips at once: any hypothesis would fit.

    `notes`: on discarded data. Motion is counted in blocks of a quarter of a second.
    """
    moving = lasted = 0.0
    for segment in segments:
        if "piston_position" not in segment.channels:
            return
        length = max(round(0.25 / segment.step), 1)
        position = segment.channels["piston_position"][: len(segment) // length * length].reshape(-1, length)
        lasted += len(segment) * segment.step
        moving += 0.25 * float(np.count_nonzero(np.ptp(position, axis=1) > MOVING / 10.0))
    if moving >= 2.0 * SHORTEST:
        return
    reasons = list(notes)
    currents = [segment.channels["valve_current"] for segment in segments if "valve_current" in segment.channels]
    if currents:
        share = float(np.mean(np.abs(np.concatenate(currents)) >= SATURATED * bench.valve_current_max))
        if share > 0.01:
            reasons.append(f"the valve current is saturated in {100.0 * share:.0f} % of what is left")
    why = "; ".join(reasons).replace(f"; {REMEDY}", "")
    raise UnusableRecordingError(
        f"the piston moves for {moving:.1f} s in all of what can be fitted: too little to be diagnosed"
        + (f" ({why})" if why else "")
        + (f"; {REMEDY}" if why or moving < 0.5 * lasted else "; record 20 s of motion or more")
    )


def _read(
    paths: Sequence[str | Path], bench: Bench, columns: ColumnMap | None, inspection: PlausibilityCheck,
    in_full: set[Path], *, spare: bool = False,
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
            if exists(path) and is_bag(path) and has_states(path):
                found = read_bag_within(path, bench, columns, inspected)
            else:
                found = table_within(inspected(read_table(path, columns)), bench)
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


def _informative(segments: list[Segment], what: str, bench: Bench, quality: list[str]) -> list[Segment]:
    """The most informative windows of the segments, `LONGEST` seconds at most, with a note."""
    total = sum(len(segment) * segment.step for segment in segments)
    if total <= LONGEST:
        return segments
    pieces, visits = [], Visits(bench)
    for segment in segments:
        length = round(WINDOW / segment.step)
        for at in range(0, max(len(segment) - length + 1, 1), length):
            pieces.append(segment.cut(at, at + length))
            visits.add(pieces[-1])
    kept = visits.select(int(LONGEST / WINDOW))
    quality.append(
        f"of {total:.0f} s the {len(kept)} windows of {WINDOW:g} s were {what} which together visit most positions, "
        "velocities, currents and pressures"
    )
    return [pieces[k] for k in kept]
