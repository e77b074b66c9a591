# SPDX-License-Identifier: Apache-2.0
"""From paths to what is fitted and what is held out: recordings read side by side, split, and cut to what is needed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from joblib import Parallel, delayed

from hydro_diagnosis.columns import ColumnMap
from hydro_diagnosis.quality import checked
from hydro_diagnosis.recording import Recording, Segment
from hydro_diagnosis.table import InputError, UnusableRecordingError, read_table
from hydro_sim.bench import Bench

LONGEST = 90.0
"""s of recordings that are fitted; of more, the stretches with the most motion are taken, and the report says so."""


def taken(
    recordings: Sequence[str | Path],
    holdout: Sequence[str | Path],
    bench: Bench,
    columns: ColumnMap | None = None,
) -> tuple[list[Segment], list[Segment], list[str]]:
    """Segments to fit, segments held out, and what was noted about their quality; `columns`: see `read_table`.

    Joblib reads the recordings one after the other unless `joblib.parallel_config` says otherwise.

    Raises
    ------
    InputError
        If nothing of them can be diagnosed.
    """
    fitted, held, quality = _split(*_read(recordings, bench, columns), *_read(holdout, bench, columns))
    return _informative(fitted, quality), held, quality


def _read(paths: Sequence[str | Path], bench: Bench, columns: ColumnMap | None) -> tuple[list[Recording], list[str]]:
    """Recordings that show something, and a note on each that does not; if none does, the first reason is raised."""
    looked = Parallel()(delayed(_look)(path, bench, columns) for path in paths)
    recordings = [one for one in looked if isinstance(one, Recording)]
    refused = [one for one in looked if not isinstance(one, Recording)]
    if refused and not recordings:
        raise refused[0]
    notes = [f"{error}; it was left out" for error in refused]
    return recordings, [*notes, *(note for recording in recordings for note in recording.quality)]


def _look(path: str | Path, bench: Bench, columns: ColumnMap | None) -> Recording | UnusableRecordingError:
    try:
        return checked(read_table(path, columns), bench)
    except UnusableRecordingError as error:
        return error


def _split(
    fitted: list[Recording], notes: list[str], held: list[Recording], held_notes: list[str]
) -> tuple[list[Segment], list[Segment], list[str]]:
    """Segments to fit, segments held out, and what was noted about all."""
    if not fitted:
        raise InputError("no recording was given")
    quality = [*notes, *held_notes]
    if not held and len(fitted) > 1:
        held = [fitted.pop()]
        quality.append(f"{held[0].name} was held back to check on")
    first = [segment for recording in fitted for segment in recording.segments]
    if held:
        return first, [segment for recording in held for segment in recording.segments], quality
    longest = max(first, key=len)
    cut = len(longest) * 2 // 3
    quality.append("the last third of the only recording was held back to check on")
    return [*(s for s in first if s is not longest), longest.cut(0, cut)], [longest.cut(cut, len(longest))], quality


def _informative(segments: list[Segment], quality: list[str]) -> list[Segment]:
    """At most `LONGEST` seconds: pieces of 10 s in the order of how much moves in them."""
    total = sum(len(segment) * segment.step for segment in segments)
    if total <= LONGEST:
        return segments
    pieces = []
    for segment in segments:
        length = round(10.0 / segment.step)
        pieces += [segment.cut(at, at + length) for at in range(0, max(len(segment) - length + 1, 1), length)]
    lively = sorted(
        pieces,
        key=lambda piece: -float(piece.channels.get("piston_position", next(iter(piece.channels.values()))).std()),
    )
    kept = lively[: int(LONGEST / 10.0)]
    quality.append(f"of {total:.0f} s the {10 * len(kept)} s in which most moves were fitted, in pieces of 10 s")
    return kept
