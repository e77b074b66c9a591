# SPDX-License-Identifier: Apache-2.0
"""Reads recordings: bags by `hydro_bridge.bags.recording` and `topics`, other files by `importers`; column maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydro_bridge.bags.recording import RecordingError, read_bag
from hydro_bridge.signals import STATE_FIELDS, FloatArray
from hydro_diagnosis.formats.file_columns import Columns
from hydro_diagnosis.formats.suffixes import SUFFIXES
from hydro_diagnosis.formats.topics import has_states, topic_columns
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.timebase import fields_of
from hydro_diagnosis.recording import InputError, UnusableRecordingError


@dataclass(frozen=True)
class RawTable:
    """A recording as it was read, before any check."""

    name: str
    time: FloatArray
    """s, shape (n,)."""
    sample: FloatArray | None
    """Number of each sample by the box's count, shape (n,), or None."""
    columns: dict[str, FloatArray]
    """BenchState fields, each of shape (n,)."""
    notes: tuple[str, ...] = ()
    """Conversions applied to the file, one sentence each."""


def read_table(path: str | Path, columns: ColumnMap | None = None) -> RawTable:
    """Read one recording.

    Parameters
    ----------
    path
        A rosbag2 folder or .mcap, or a file of one of `formats.suffixes`.
    columns
        Which of its columns is what. None: it holds a `time` column [s] and any of the BenchState field names as
        columns. A bag with /hydro/state needs none; of other bags `topics` makes the columns.

    Raises
    ------
    InputError
        In one sentence that names the path, and where a column is not found, the columns that there are.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such recording")
    if is_bag(path) and has_states(path):
        found = from_bag(path)
        return found if columns is None else mapped(path, found, columns)
    return _from_columns(path, columns_of(path), columns)


def is_bag(path: Path) -> bool:
    """Return whether a path is a rosbag2 folder or an .mcap file."""
    return path.is_dir() or path.suffix == ".mcap"


def columns_of(path: Path) -> Columns:
    """Columns of a recording before any map: the fields of a bag with /hydro/state, all numbers of other files.

    Raises
    ------
    InputError
        In one sentence that names the path.
    """
    if not path.exists():
        raise InputError(f"{path}: there is no such recording")
    if is_bag(path):
        if not has_states(path):
            return topic_columns(path)
        raw = from_bag(path)
        return Columns({"time": raw.time, **raw.columns}, units={"time": "s"})
    if path.suffix.lower() in SUFFIXES:
        from hydro_diagnosis.formats.importers import read_columns  # late: bags need no pandas

        return read_columns(path)
    raise InputError(f"{path}: not a rosbag2 folder, nor a file .mcap, {', '.join(SUFFIXES)}")


def mapped(path: Path, raw: RawTable, columns: ColumnMap) -> RawTable:
    """Apply a column map to a bag's fields.

    Raises
    ------
    InputError
        As `read_table`.
    """
    turned = _from_columns(path, Columns({"time": raw.time, **raw.columns}), columns)
    same = turned.time is not None and len(turned.time) == len(raw.time)
    return RawTable(raw.name, turned.time, raw.sample if same else None, turned.columns, turned.notes)


def from_bag(path: Path) -> RawTable:
    """Read a bag's whole /hydro/state.

    Raises
    ------
    InputError
        As `read_table`.
    """
    try:
        states = read_bag(path, topics=("/hydro/state",)).state
    except RecordingError as error:
        raise InputError(str(error)) from None
    if not len(states):
        raise InputError(f"{path}: the recording is empty")
    steps = np.diff(states["sequence"]).view(np.int32).astype(np.float64)
    columns = {name: np.ascontiguousarray(states[name]) for name in STATE_FIELDS}
    return RawTable(path.name, states["time"].copy(), np.concatenate([[0.0], np.cumsum(steps)]), columns)


def _from_columns(path: Path, found: Columns, columns: ColumnMap | None) -> RawTable:
    chosen = (columns or ColumnMap({})).completed(found.series)
    there = ", ".join(list(found.series)[:40])
    if "time" not in chosen.sources and not found.clocks:
        raise InputError(f"{path}: no column is the time: map one by --columns time=NAME,...; there are {there}")
    if not set(chosen.sources) - {"time"}:
        raise InputError(
            f"{path}: no column carries the name of a BenchState field, for instance piston_position: map them by "
            f"--columns time=NAME,piston_position=NAME,... (`inspect` proposes a map); there are {there}"
        )
    try:
        time, fields, notes = fields_of(found, chosen)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return RawTable(path.stem, time, None, fields, tuple(notes))


__all__ = ["InputError", "RawTable", "UnusableRecordingError", "read_table"]
