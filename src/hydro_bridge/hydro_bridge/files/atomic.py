# SPDX-License-Identifier: Apache-2.0
"""Atomic file replacement: complete or absent after kill -9, a full disk or a power failure."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path


def write_whole(path: Path, content: bytes) -> None:
    """Write `content` to `path` atomically: it replaces the old file once it is on disk.

    What is no plain file (/dev/stdout, a pipe) is written through, as it is. A link stays, its file is replaced; a file
    keeps its mode.

    Raises
    ------
    OSError
        It cannot be written; what was there is as it was, and nothing is left beside it.
    """
    if path.absolute().parts[1] in ("dev", "proc") or (path.exists() and not path.is_file()):
        path.write_bytes(content)
        return
    path = path.resolve()
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, partial)
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        if error.filename is None:  # a full disk says only that it is full
            error.filename = str(path)
        raise
    flush_folder(path.parent)


def flush_folder(folder: Path) -> None:
    """Flush a folder's entries to disk: until then a power failure can undo a rename."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
