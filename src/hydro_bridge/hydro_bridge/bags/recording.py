# SPDX-License-Identifier: Apache-2.0
"""Public interface of recordings: reading, writing, checking and repairing bags.

>>> states = read_bag("runs/tuesday").state          # doctest: +SKIP
>>> states["load_force"].mean(), continuity(states)  # doctest: +SKIP
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from hydro_bridge.bags.continuity import Continuity, continuity
from hydro_bridge.bags.reader import STATE_TOPIC, Recording, messages, objects, read_bag, stream_bag
from hydro_bridge.bags.types import RecordingError, TopicQos
from hydro_bridge.bags.writer import BagWriter

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
