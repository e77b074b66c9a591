# SPDX-License-Identifier: Apache-2.0
"""Repair of a recording whose recorder was killed, or that is damaged: `recorder --repair FOLDER`.

The new file is complete, read back and counted before anything of the old ones is touched; what was not read to its end
is never removed. A recording that is still being written is refused: our recorder holds a lock on its file (`locked`),
and another's file grows.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from mcap.reader import make_reader

from hydro_bridge.bags.recording import messages, read_bag
from hydro_bridge.bags.storage import OF_SEVERAL, BagSource
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.bags.writer import BagWriter, locked

_RECENT, _GROWS = 10.0, 1.5
"""s since a file was written within which it is watched, and for how long, for another recorder's."""


def repair(folder: Path | str) -> tuple[int, list[str]]:
    """Finish a recording, so that other readers can open it too; damaged blocks are left out.

    Returns
    -------
    Number of messages kept, and sentences on what is missing.

    Raises
    ------
    RecordingError
        The folder is no recording, or whole; it is being written, holds files of which metadata.yaml says nothing or
        those of several recordings, or there is no room for the new file.
    """
    folder = Path(folder)
    if folder.is_file():
        raise RecordingError(f"{folder} is a file: name the folder of the recording, with its .mcap alone in it")
    source = BagSource(folder, salvages=True)
    files = [scan.path for scan in source.scans]
    if any(OF_SEVERAL in note for note in source.notes):
        raise RecordingError(f"{folder} holds files of several recordings: move each into a folder of its own first")
    if strange := sorted(path.name for path in set(folder.glob("*.mcap")) - set(files)):
        raise RecordingError(
            f"{folder} holds {', '.join(strange)}, of which its metadata.yaml says nothing: move that elsewhere first"
        )
    scratch = folder.with_name(f".{folder.name}.repair") / folder.name
    with ExitStack() as stack:
        for path in files:
            stack.enter_context(_at_rest(path))
        shutil.rmtree(scratch.parent, ignore_errors=True)
        stack.callback(shutil.rmtree, scratch.parent, ignore_errors=True)
        try:
            count, missing = _copied(folder, scratch)
        except OSError as error:
            raise RecordingError(f"{folder} cannot be repaired: {error.strerror}: nothing was changed") from None
        new = {path.name for path in scratch.glob("*.mcap")}
        for path in sorted(scratch.iterdir()):
            os.replace(path, folder / path.name)
        for path in files:
            if path.name not in new:
                path.unlink()
    return count, missing


def _copied(folder: Path, scratch: Path) -> tuple[int, list[str]]:
    """Copy what can be read into a complete recording, and check that it is there."""
    broken = read_bag(folder, topics=(), salvages=True)
    if not broken.notes:
        raise RecordingError(f"{folder} is whole: there is nothing to repair")
    metadata = {**broken.metadata.get("hydro", {}), "repaired": "; ".join(broken.notes)}
    count, known = 0, set[str]()
    with BagWriter(scratch, metadata=metadata, attachments=broken.attachments) as writer:
        for topic, type_name, time_ns, data in messages(folder, salvages=True):
            if topic not in known:
                known.add(topic)
                writer.add_topic(topic, type_name, broken.qos[topic])
            writer.write(topic, data, time_ns)
            count += 1
    with writer.path.open("rb") as stream:
        os.fsync(stream.fileno())
        there = sum(1 for _ in make_reader(stream).iter_messages())
    if there != count:
        raise RecordingError(f"{folder}: {count} messages were read, {there} came back: nothing was changed")
    return count, [note for note in broken.notes if "was not finished" not in note]


@contextmanager
def _at_rest(path: Path) -> Iterator[None]:
    """Hold the lock of a file that nobody writes; raises RecordingError."""
    if not path.exists():
        yield
        return
    with path.open("rb") as file:
        if not locked(file):
            raise RecordingError(f"{path} is being written by a recorder: end that first")
        before = path.stat()
        if time.time() - before.st_mtime < _RECENT:
            time.sleep(_GROWS)
            if path.stat().st_size != before.st_size:
                raise RecordingError(f"{path} grows: end the recorder that writes it first")
        yield
