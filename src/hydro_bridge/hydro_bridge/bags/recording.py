# SPDX-License-Identifier: Apache-2.0
"""Public interface of recordings: reading, writing, checking and repairing bags.

>>> states = read_bag("runs/tuesday").state          # doctest: +SKIP
>>> states["load_force"].mean(), continuity(states)  # doctest: +SKIP
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydro_bridge.bags.reader import STATE_TOPIC, Recording, messages, objects, read_bag, stream_bag
from hydro_bridge.bags.types import RecordingError, TopicQos
from hydro_bridge.bags.writer import BagWriter
from hydro_bridge.signals import StateArray

_RESTART = 600_000  # a sequence that jumps further was started anew (as in stream.SequenceTracker)


@dataclass(frozen=True, kw_only=True)
class Continuity:
    """Counts over one recording; all but `samples` and `seconds` are zero if nothing is missing."""

    samples: int
    seconds: float
    """Last time minus first."""
    lost: int
    """Missing sequence numbers."""
    duplicates: int
    backward: int
    """Samples whose sequence number is lower than that of the sample before."""
    restarts: int
    time_jumps: int
    """Pairs of samples whose time difference deviates from their sequence numbers by more than the tolerance."""
    largest_jump: float
    """s, largest of these deviations."""

    @property
    def whole(self) -> bool:
        """Whether every sample is present exactly once, in order and on time."""
        return not (self.lost or self.duplicates or self.backward or self.restarts or self.time_jumps)


def continuity(states: StateArray, *, period: float = 1e-3, tolerance: float = 5e-3) -> Continuity:
    """Check sequence numbers and times of `STATE_DTYPE` records.

    Parameters
    ----------
    period
        s per sequence number.
    tolerance
        s by which the difference of two successive times may deviate from their sequence numbers.
    """
    if len(states) < 2:
        return Continuity(
            samples=len(states),
            seconds=0.0,
            lost=0,
            duplicates=0,
            backward=0,
            restarts=0,
            time_jumps=0,
            largest_jump=0.0,
        )
    step = np.diff(states["sequence"]).view(np.int32).astype(np.int64)  # unsigned difference: wraps at 2^32
    restart = np.abs(step) > _RESTART
    jump = np.where(restart, 0.0, np.abs(np.diff(states["time"]) - step * period))
    return Continuity(
        samples=len(states),
        seconds=float(states["time"][-1] - states["time"][0]),
        lost=int((step[(step > 1) & ~restart] - 1).sum()),
        duplicates=int((step == 0).sum()),
        backward=int(((step < 0) & ~restart).sum()),
        restarts=int(restart.sum()),
        time_jumps=int((jump > tolerance).sum()),
        largest_jump=float(jump.max() if jump.max() > tolerance else 0.0),
    )


__all__ = [
    "STATE_TOPIC",
    "BagWriter",
    "Continuity",
    "Recording",
    "RecordingError",
    "TopicQos",
    "continuity",
    "messages",
    "objects",
    "read_bag",
    "repair",
    "stream_bag",
]


def repair(folder: Path | str) -> int:
    """Finish a recording whose recorder was killed, so that other readers can open it too.

    The messages are copied into a complete file, which then replaces the broken one.

    Returns
    -------
    Number of messages recovered.

    Raises
    ------
    RecordingError
        The folder is not a recording of one .mcap, or is damaged.
    """
    folder = Path(folder)
    broken = read_bag(folder, topics=())
    if not broken.notes:
        raise RecordingError(f"{folder} is whole: there is nothing to repair")
    scratch = folder.with_name(f".{folder.name}.repair") / folder.name
    shutil.rmtree(scratch.parent, ignore_errors=True)
    metadata = {**broken.metadata.get("hydro", {}), "repaired": "the recorder was killed"}
    count = 0
    with BagWriter(scratch, metadata=metadata, attachments=broken.attachments) as writer:
        known: set[str] = set()
        for topic, type_name, time_ns, data in messages(folder):
            if topic not in known:
                known.add(topic)
                writer.add_topic(topic, type_name, broken.qos[topic])
            writer.write(topic, data, time_ns)
            count += 1
    old = set(folder.glob("*.mcap"))
    for path in scratch.iterdir():
        os.replace(path, folder / path.name)
        old.discard(folder / path.name)
    for path in old:
        path.unlink()
    shutil.rmtree(scratch.parent)
    return count
