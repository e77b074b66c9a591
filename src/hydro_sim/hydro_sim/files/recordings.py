# SPDX-License-Identifier: Apache-2.0
"""Recordings as training data: gapless runs of x and u, split by recording and by time, never by sample."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from hydro_bridge.bags.recording import RecordingError, read_bag, read_messages
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import PLANT_FIELDS, Flag, FloatArray, StateArray, to_matrix
from hydro_sim.files.pairing import BoxIdentity, PairingError
from hydro_sim.model.equations import READINGS

LAW_TOPIC = "/hydro/box_law"

BOX_TOPIC = "/hydro/box"

MIN_SAMPLES = 2000
"""Shortest run [samples] that is used."""
MIN_VALIDATION_SAMPLES = 1000
"""Smallest number of validation samples of a run: room for a few predictions after an observer has settled."""
READING_COLUMNS = tuple(map(PLANT_FIELDS.index, READINGS))
"""Columns of x that are readings of sensors; the box computes the others from them."""


class DataError(ValueError):
    """Recordings that cannot be trained on; the message is one sentence."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """Consecutive samples without a gap; u[k] is held from x[k] to x[k + 1]."""

    name: str
    """Name of the recording."""
    x: FloatArray
    """Measurements x, SI units, shape (n, 8)."""
    u: FloatArray
    """Valve currents [A], shape (n,)."""
    first: int = 0
    """Index of x[0] in the recording."""

    def __len__(self) -> int:
        return len(self.u)

    @property
    def readings(self) -> FloatArray:
        """The five readings, shape (n, 5)."""
        return np.ascontiguousarray(self.x[:, READING_COLUMNS])

    def slice(self, begin: int, end: int) -> Run:
        """Return the samples `begin` to `end` (exclusive)."""
        return Run(name=self.name, x=self.x[begin:end], u=self.u[begin:end], first=self.first + begin)


def split_runs(name: str, states: StateArray) -> list[Run]:
    """Return the gapless runs of a recording that are long enough and have valid sensors."""
    x, u = to_matrix(states), np.ascontiguousarray(states["valve_current"])
    good = np.isfinite(x).all(axis=1) & np.isfinite(u) & ((states["flags"] & Flag.SENSOR_FAULT) == 0)
    joined = good[1:] & good[:-1] & (np.diff(states["sequence"]).view(np.int32) == 1)
    edges = np.flatnonzero(~np.concatenate(([False], joined, [False])))
    found = [Run(name=name, x=x[a:b], u=u[a:b], first=int(a)) for a, b in pairwise(edges)]
    return [run for run in found if len(run) >= MIN_SAMPLES and good[run.first]]


@dataclass(frozen=True, kw_only=True)
class Data:
    """Training and validation data."""

    training: list[Run]
    validation: list[Run]
    digests: dict[str, str]
    """SHA-256 of each recording's samples, by name."""


def load_states(paths: Sequence[str | Path]) -> dict[str, StateArray]:
    """Load the states of recordings, by recording name; raises hydro_bridge.bags.recording.RecordingError."""
    return {Path(path).name: read_bag(path).state for path in paths}


def box_law(path: str | Path) -> BoxLaw | None:
    """Return the last compensated law in a recording; None: its box has none.

    Raises hydro_bridge.bags.recording.RecordingError: damaged, or without the box's law.
    """
    *_, (_, message) = read_messages(path, LAW_TOPIC)
    return BoxLaw.of_message(message)


def require_same_box(path: str | Path, bench: BoxIdentity) -> None:
    """Raise PairingError if a recording is of a box with another bench file."""
    with suppress(RecordingError):  # without a box's description
        *_, (_, box) = read_messages(path, BOX_TOPIC)
        if box.bench_digest not in ("", bench.digest):
            told = f"the box of the recording {Path(path).name} believes bench {box.bench_digest}"
            raise PairingError(f"{told}: name the bench.yaml of its box by --bench")


def split(recordings: dict[str, StateArray], *, share: float = 0.15, gap: int = 1000) -> Data:
    """Return training and validation runs, which share no sample.

    With three recordings or more the last one validates. With fewer, the last `share` of each run's time does, at least
    `MIN_VALIDATION_SAMPLES` samples, `gap` samples after the training part; a run that is too short for that is
    used for training as a whole. The final evaluation of a model is on another recording: `validate`.

    Raises DataError if no run is long enough for training, or for a validation part.
    """
    digests = dict[str, str]()
    for name, states in recordings.items():  # of sequence, x and u
        sha = hashlib.sha256(states["sequence"].tobytes())
        sha.update(to_matrix(states, (*PLANT_FIELDS, "valve_current")).tobytes())
        digests[name] = sha.hexdigest()
    found = {name: split_runs(name, states) for name, states in recordings.items()}
    names = [name for name in found if found[name]]
    if not names:
        raise DataError(f"no recording has {MIN_SAMPLES} samples in a row: record more")
    if len(names) >= 3:
        training = [run for name in names[:-1] for run in found[name]]
        return Data(training=training, validation=found[names[-1]], digests=digests)
    training, validation = [], []
    for run in (run for name in names for run in found[name]):
        end = min(round((1.0 - share) * len(run)), len(run) - gap - MIN_VALIDATION_SAMPLES)
        if end < MIN_SAMPLES:
            training.append(run)
        else:
            training.append(run.slice(0, end))
            validation.append(run.slice(end + gap, len(run)))
    if not validation:
        longest, needed = max(map(len, training)), MIN_SAMPLES + gap + MIN_VALIDATION_SAMPLES
        raise DataError(f"the longest run has {longest} samples: name three recordings, or one with {needed} in a row")
    return Data(training=training, validation=validation, digests=digests)
