# SPDX-License-Identifier: Apache-2.0
"""Recordings prepared for the diagnosis: segments of equally spaced samples, channels by BenchState field name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray

RECORDING_SUFFIXES = (
    ".csv", ".txt", ".tsv", ".asc", ".ascii", ".lvm", ".dat", ".parquet", ".pq", ".mat", ".h5", ".hdf5", ".nc", ".mf4",
    ".mdf", ".tdms", ".gz", ".zip",
)  # fmt: skip
HELD_THIRD_NOTE = "a third of the only recording was held back to check on"
"""Note on a data set of one recording, of which a third is held out."""


def ambiguous_paths(paths: Sequence[str | Path]) -> set[Path]:
    """Paths that share a file name with another, and are therefore named in full (most bags are called `bag`)."""
    different = {Path(path) for path in paths}
    stems = Counter(path.stem for path in different)
    return {path for path in different if stems[path.stem] > 1}


def unreadable_reason(path: Path) -> str:
    """Return the reason why a file cannot be read as a recording."""
    if path.suffix.lower() in (".xlsx", ".xlsm", ".xls", ".ods"):
        return "a spreadsheet: save its table as CSV"
    return f"not a rosbag2 folder, nor a file .mcap, {', '.join(RECORDING_SUFFIXES)}"


MEASURED_CHANNELS = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position")
"""Channels of the sensors; the rates are computed by the box and not used."""
CHANNEL_UNITS = dict(zip(MEASURED_CHANNELS, ("N", "N", "Pa", "Pa", "m"), strict=True))


class InputError(ValueError):
    """Input that cannot be diagnosed; the message is one sentence for the user."""


class UnusableRecordingError(InputError):
    """Readable recording that cannot be diagnosed; others of the data set may be."""


@dataclass(frozen=True)
class Segment:
    """Contiguous segment of a recording, with equally spaced samples."""

    recording: str
    """Name of the recording that contains the segment."""
    start: float
    """s since the start of the recording."""
    step: float
    """Sampling time [s]."""
    channels: Mapping[str, FloatArray]
    """Signals by field name, SI units, each of shape (n,)."""
    spacing: int = 1
    """Samples per row of the logger: 1 at 1 kHz, 5 at 200 Hz; the samples between rows are interpolated by splines."""
    measured: npt.NDArray[np.bool_] | None = None
    """Mask of the recorded samples, shape (n,); None: all are recorded."""
    half_rows: Segment | None = None
    """The same segment from half of the rows, if rows are missing: shows how much these may change results."""

    def __len__(self) -> int:
        return len(next(iter(self.channels.values())))

    @property
    def time(self) -> FloatArray:
        """Times [s] since the start of the recording, shape (n,)."""
        return self.start + self.step * np.arange(len(self), dtype=np.float64)

    @property
    def phase(self) -> int:
        """Index of the first sample on the grid of the logger's rows."""
        return 0 if self.measured is None else int(np.argmax(self.measured)) % self.spacing

    def evaluated_rows(self, begin: int, end: int, stride: int, margin: int) -> npt.NDArray[np.int64] | slice:
        """Return the recorded samples in [`begin`, `end`) for residuals, `stride` recorded rows apart or more.

        A slice if all samples are recorded. No row is missing within `margin` rows of any of them.
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
        """Return the segment of the samples from `begin` up to `end`."""
        return replace(
            self,
            start=self.start + self.step * begin,
            channels={name: values[begin:end] for name, values in self.channels.items()},
            measured=None if self.measured is None else self.measured[begin:end],
            half_rows=None if self.half_rows is None else self.half_rows.cut(begin, end),
        )


@dataclass(frozen=True)
class Recording:
    """Recording as contiguous segments, with notes on its quality."""

    name: str
    segments: tuple[Segment, ...]
    quality: tuple[str, ...] = field(default=())
    """Notes on faults and their repair, one sentence each."""

    @property
    def seconds(self) -> float:
        """Recorded time in s, without gaps."""
        return sum(len(segment) * segment.step for segment in self.segments)
