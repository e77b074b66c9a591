# SPDX-License-Identifier: Apache-2.0
"""Reading recordings: rosbag2 folders and .mcap by `hydro_bridge.recording`, tables by `importers` and a column map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydro_bridge.recording import RecordingError, read_bag
from hydro_bridge.signals import STATE_FIELDS
from hydro_diagnosis.columns import ColumnMap, known_as_they_are
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.importers import SUFFIXES, Columns, read_columns
from hydro_diagnosis.recording import InputError, UnusableRecordingError


@dataclass(frozen=True)
class RawTable:
    """A recording as it was read, nothing checked yet."""

    name: str
    time: FloatArray
    """s, shape (n,)."""
    sample: FloatArray | None
    """Number of each sample by the box's count, shape (n,), or None."""
    columns: dict[str, FloatArray]
    """BenchState fields, each of shape (n,)."""


def read_table(path: str | Path, columns: ColumnMap | None = None) -> RawTable:
    """Read one recording.

    Parameters
    ----------
    path
        A rosbag2 folder or .mcap with /hydro/state, or a .csv, .parquet or .mat file.
    columns
        Which of such a file's columns is what. None: it holds a `time` column [s] and any of the BenchState field names
        as columns. Bags need none.

    Raises
    ------
    InputError
        In one sentence that names the path, and where a column is not found, the columns that there are.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such recording")
    if path.is_dir() or path.suffix == ".mcap":
        return _from_bag(path)
    if path.suffix.lower() in SUFFIXES:
        return _from_columns(path, read_columns(path), columns)
    raise InputError(f"{path}: not a rosbag2 folder, nor a file .mcap, {', '.join(SUFFIXES)}")


def _from_bag(path: Path) -> RawTable:
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
    chosen = columns or known_as_they_are(found.series)
    there = ", ".join(list(found.series)[:40])
    if "time" not in chosen.sources:
        raise InputError(f"{path}: no column is the time: map one by --columns time=NAME,...; there are {there}")
    if len(chosen.sources) == 1:
        raise InputError(
            f"{path}: no column carries the name of a BenchState field, for instance piston_position: map them by "
            f"--columns time=NAME,piston_position=NAME,...; there are {there}"
        )
    length = len(next(iter(found.series.values())))
    try:
        fields = {name: source.of(found.series, found.constants, length) for name, source in chosen.sources.items()}
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return RawTable(path.stem, fields.pop("time"), None, fields)


__all__ = ["InputError", "RawTable", "UnusableRecordingError", "read_table"]
