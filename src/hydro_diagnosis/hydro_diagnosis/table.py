# SPDX-License-Identifier: Apache-2.0
"""Reading recordings: rosbag2 folders and .mcap through `hydro_bridge.recording`, CSV and Parquet tables by pandas."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_bridge.recording import RecordingError, read_bag
from hydro_bridge.signals import STATE_FIELDS
from hydro_diagnosis.effects.base import FloatArray


class InputError(ValueError):
    """What was given cannot be diagnosed; the message is one sentence for the person who gave it."""


class UnusableRecordingError(InputError):
    """A recording that was read but shows nothing; others beside it may."""


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


def read_table(path: str | Path) -> RawTable:
    """Read one recording.

    Parameters
    ----------
    path
        A rosbag2 folder or .mcap with /hydro/state, or a .csv or .parquet table with a `time` column [s] and any of the
        BenchState field names as columns.

    Raises
    ------
    InputError
        In one sentence that names the path.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such recording")
    if path.is_dir() or path.suffix == ".mcap":
        return _from_bag(path)
    if path.suffix.lower() in (".csv", ".parquet", ".pq"):
        return _from_frame(path)
    raise InputError(f"{path}: not a rosbag2 folder, .mcap, .csv or .parquet file")


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


def _from_frame(path: Path) -> RawTable:
    try:
        frame = pd.read_csv(path) if path.suffix.lower() == ".csv" else pd.read_parquet(path)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: the file is empty") from None
    except (ImportError, OSError, ValueError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}") from None
    if "time" not in frame:
        raise InputError(f"{path}: there is no column named 'time'")
    known = [name for name in STATE_FIELDS if name in frame]
    if not known:
        raise InputError(f"{path}: no column carries the name of a BenchState field, for instance piston_position")
    numbers = frame[["time", *known]].apply(pd.to_numeric, errors="coerce")
    columns = {name: numbers[name].to_numpy(dtype=np.float64) for name in known}
    return RawTable(path.stem, numbers["time"].to_numpy(dtype=np.float64), None, columns)
