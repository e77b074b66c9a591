# SPDX-License-Identifier: Apache-2.0
"""Repair of a recording whose recorder was killed, or that is damaged: `recorder --repair FOLDER`.

What is readable is copied into a new recording, with the definitions, channels, times, metadata and attachments of its
writer. The copy replaces the files, which move to a sub-folder: a repair removes nothing.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from itertools import count
from pathlib import Path

from hydro_bridge.bags import RecordingError
from hydro_bridge.bags.recording import Bag
from hydro_bridge.bags.writer import BagWriter


def repair(folder: Path | str) -> tuple[int, list[str]]:
    """Repair a recording in place; return the number of messages kept, and sentences on what is not and on the backup.

    Raises RecordingError: the folder is no recording, or undamaged; a process has its files open, no message can be
    read, or there is no room. Nothing is changed then.
    """
    folder = Path(folder).resolve()
    if folder.is_file():
        raise RecordingError(f"{folder} is a file: name the folder of the recording")
    bag, scratch = Bag(folder, skip_damaged=True), folder / f".repair_{os.getpid()}"
    files = [*bag.files, *folder.glob("metadata.yaml")]
    for descriptor in Path("/proc").glob("[0-9]*/fd/*"):  # of the processes that this user may inspect
        with suppress(OSError):
            if any(descriptor.samefile(path) for path in files):
                raise RecordingError(f"{folder} is open in process {descriptor.parts[2]}: end that first")
    try:
        with BagWriter(scratch / folder.name) as writer:
            copied = _copy(bag, writer)
        if not bag.notes and (folder / "metadata.yaml").exists():
            raise RecordingError(f"{folder} is whole: there is nothing to repair")
        if not copied:
            raise RecordingError(f"{folder}: no message can be read: nothing was changed")
        names = (f"before_repair_{n}" if n else "before_repair" for n in count())
        backup = next(path for name in names if not (path := folder / name).exists())
        backup.mkdir()
        for path in files:
            os.replace(path, backup / path.name)
        for path in writer.folder.iterdir():
            os.replace(path, folder / path.name)
    except OSError as error:
        raise RecordingError(f"{folder} cannot be repaired: {error.strerror}: nothing was removed") from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return copied, [*bag.notes, f"the files as they were are in {backup}: remove them once you have seen the new ones"]


def _copy(bag: Bag, writer: BagWriter) -> int:
    """Copy what is readable of a recording into a new one, and return its number of messages."""
    copied = 0
    for piece in bag.pieces():
        writer.add_channel(piece.channel, piece.schema)
        for (log_time, data), (*_, number, _, published) in zip(piece.serialized(), piece.heads.tolist(), strict=True):
            writer.write(piece.topic, data, log_time, published, number)
        copied += len(piece.starts)
    for name, data in bag.attachments.items():
        writer.attach(name, data)
    for name, record in bag.metadata.items():
        if name != "rosbag2":  # of the file as it was
            writer.add_metadata(name, record)
    return copied
