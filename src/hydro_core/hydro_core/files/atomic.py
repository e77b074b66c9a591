# SPDX-License-Identifier: Apache-2.0
"""Atomic file replacement: complete or absent after kill -9, a full disk or a power failure."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec


def write_atomic(path: Path, content: bytes) -> None:
    """Write `content` to `path` atomically: the old file is replaced once the new one is on disk.

    Anything but a regular file (/dev/stdout, a pipe) is written directly. A link is kept and its target replaced; a
    file keeps its mode.

    Raises OSError: the file cannot be written; the previous one is unchanged, and no temporary file is left.
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
        error.filename = str(path)  # the error of a full disk names no file
        raise
    fsync_folder(path.parent)


def encode_json(content: Any) -> bytes:
    """Return mappings, sequences, dataclasses and numbers as JSON; non-finite numbers become null."""
    encoded = msgspec.json.encode(content, enc_hook=lambda number: number.item())
    return msgspec.json.format(encoded, indent=1) + b"\n"


def fsync_folder(folder: Path) -> None:
    """Flush a folder's entries to disk; until then a power failure can undo a rename."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
