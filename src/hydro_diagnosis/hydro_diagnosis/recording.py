# SPDX-License-Identifier: Apache-2.0
"""A recording as the diagnosis sees it: segments of equally spaced samples, channels by BenchState field name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray

TEXTS = (".csv", ".txt", ".tsv", ".asc", ".ascii", ".lvm")
SUFFIXES = (*TEXTS, ".dat", ".parquet", ".pq", ".mat", ".h5", ".hdf5", ".mf4", ".mdf", ".tdms")
SPREADSHEETS = (".xlsx", ".xlsm", ".xls", ".ods")
LAST_THIRD = "the last third of the only recording was held back to check on"
"""Note on the quality of a data set."""


def named_in_full(paths: Sequence[str | Path]) -> set[Path]:
    """Recordings whose names are their paths, since another one has the same file name: most bags are called `bag`."""
    different = {Path(path) for path in paths}
    stems = Counter(path.stem for path in different)
    return {path for path in different if stems[path.stem] > 1}


def unreadable(path: Path) -> str:
    """Return why a file is no recording."""
    if path.suffix.lower() in SPREADSHEETS:
        return "a spreadsheet: save its table as CSV"
    return f"not a rosbag2 folder, nor a file .mcap, {', '.join(SUFFIXES)}"


MEASURED = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position")
"""Channels of the sensors; the rates are computed by the box and not used."""
UNITS = dict(zip(MEASURED, ("N", "N", "Pa", "Pa", "m"), strict=True))


class InputError(ValueError):
    """Input that cannot be diagnosed; the message is one sentence for the user."""


class UnusableRecordingError(InputError):
    """A readable recording without information; others beside it may have some."""


@dataclass(frozen=True)
class Segment:
    """Samples without a gap."""

    recording: str
    """Name of the recording it is part of."""
    start: float
    """s since the start of the recording."""
    step: float
    """s between samples."""
    channels: Mapping[str, FloatArray]
    """By field name, each of shape (n,)."""
    spacing: int = 1
    """Samples from one row that the logger recorded to the next: 1 at 1 kHz, 5 at 200 Hz; between them splines."""
    measured: npt.NDArray[np.bool_] | None = None
    """Whether a row was recorded, shape (n,); None: every one was."""
    thinner: Segment | None = None
    """The same stretch from half of the rows, where rows are missing: the missing ones may change as much."""

    def __len__(self) -> int:
        return len(next(iter(self.channels.values())))

    @property
    def time(self) -> FloatArray:
        """s since the start of the recording, shape (n,)."""
        return self.start + self.step * np.arange(len(self), dtype=np.float64)

    @property
    def phase(self) -> int:
        """First sample that lies at one of the logger's rows."""
        return 0 if self.measured is None else int(np.argmax(self.measured)) % self.spacing

    def evaluated_rows(self, begin: int, end: int, stride: int, margin: int) -> npt.NDArray[np.int64] | slice:
        """Return the rows at which residuals are evaluated: recorded ones, `stride` recorded rows apart.

        A slice where every row was recorded. None is missing within `margin` rows of them.
        """
        if self.measured is None:
            return slice(begin, end, stride)
        spacing = self.spacing
        phase = self.phase
        recorded = self.measured[phase::spacing]
        lost = np.convolve(~recorded, np.ones(2 * margin + 1), mode="same") > 0.5
        open_ = phase + spacing * np.flatnonzero(~lost)
        open_ = open_[(open_ >= begin) & (open_ < end)]
        chosen, at = [], 0
        while at < len(open_):
            chosen.append(open_[at])
            at = int(np.searchsorted(open_, open_[at] + stride * spacing))
        return np.array(chosen, dtype=np.int64)

    def cut(self, begin: int, end: int) -> Segment:
        """The samples from `begin` up to `end`."""
        return replace(
            self,
            start=self.start + self.step * begin,
            channels={name: values[begin:end] for name, values in self.channels.items()},
            measured=None if self.measured is None else self.measured[begin:end],
            thinner=None if self.thinner is None else self.thinner.cut(begin, end),
        )


@dataclass(frozen=True)
class Recording:
    """One run."""

    name: str
    segments: tuple[Segment, ...]
    quality: tuple[str, ...] = field(default=())
    """Faults that were found and repaired, one sentence each."""

    @property
    def seconds(self) -> float:
        """Recorded time in s, without gaps."""
        return sum(len(segment) * segment.step for segment in self.segments)
