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

from hydro_bridge.bags.reader import STATE_TOPIC, Extent, Recording, messages, objects, read_bag, stream_bag
from hydro_bridge.bags.types import RecordingError, TopicQos
from hydro_bridge.bags.writer import BagWriter
from hydro_bridge.signals import StateArray

_RESTART = 600_000  # a sequence that jumps further was started again (as in stream.SequenceTracker)


@dataclass(frozen=True, kw_only=True)
class Continuity:
    """Counts over one recording; all but `samples` are zero if nothing is missing."""

    samples: int
    lost: int
    """Missing sequence numbers."""
    duplicates: int
    backward: int
    """Samples whose sequence number is lower than that of the sample before."""

    @property
    def whole(self) -> bool:
        """Whether every sample is present exactly once, in order."""
        return not (self.lost or self.duplicates or self.backward)


def continuity(states: StateArray) -> Continuity:
    """Count what is missing, twice or out of order in `STATE_DTYPE` records; a restarted box counts as nothing."""
    step = np.diff(states["sequence"]).view(np.int32).astype(np.int64)  # unsigned difference: wraps at 2^32
    step = step[np.abs(step) <= _RESTART]
    return Continuity(
        samples=len(states),
        lost=int((step[step > 1] - 1).sum()),
        duplicates=int((step == 0).sum()),
        backward=int((step < 0).sum()),
    )


__all__ = [
    "STATE_TOPIC", "BagWriter", "Continuity", "Extent", "Recording", "RecordingError", "TopicQos", "continuity",
    "messages", "objects", "read_bag", "repair", "stream_bag",
]  # fmt: skip


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
