# SPDX-License-Identifier: Apache-2.0
"""Errors that the user can correct, with messages of one sentence, and checks of output paths."""

from __future__ import annotations

import argparse
import errno
import os
from pathlib import Path

_UNWRITABLE_ERRNOS = frozenset({errno.ENOTDIR, errno.EROFS, errno.ENOSPC, errno.EDQUOT})


class UserError(Exception):
    """An error that the user can correct; the message is one sentence. `main` prints it and exits with status 2."""


class UnwritableError(UserError, argparse.ArgumentTypeError):
    """An output path that cannot be written to. Argparse reports it like a wrong option."""


def is_file_error(error: Exception) -> bool:
    """Return whether the error is the operating system's about a file or disk space, not a programming error."""
    return isinstance(error, OSError) and (error.filename is not None or error.errno in _UNWRITABLE_ERRNOS)


def user_message(error: Exception) -> str:
    """Return the text of an error for the user; a system error names its file and the remedy, without an errno."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    file = "" if error.filename is None else f"{error.filename}: "
    remedy = ": choose another place" if error.errno in _UNWRITABLE_ERRNOS else ""
    return f"{file}{error.strerror}{remedy}"


def writable_file(path: str) -> str:
    """Return `path` if a file can be written there; an argparse type, so that a command fails before its work.

    Raises UnwritableError: the file cannot be written; the sentence gives the reason.
    """
    if os.path.isdir(path):
        raise UnwritableError(f"{path} is a folder: name a file")
    _refuse_unwritable(path, "written")
    if os.path.isfile(path):  # replaced by a new file, which needs write access to its folder
        folder = Path(path).resolve().parent
        if not os.access(folder, os.W_OK):
            raise UnwritableError(f"{path} cannot be written: you may not write to {folder}: choose another place")
    return path


def writable_folder(path: str | Path) -> Path:
    """Return `path` if it is a writable folder or can be created; raises UnwritableError.

    The folder is not created yet, so that a command that then refuses another argument leaves nothing behind.
    """
    _refuse_unwritable(path, "made")
    if os.path.exists(path) and not os.path.isdir(path):
        raise UnwritableError(f"{path} is a file: name a folder")
    return Path(path)


def _refuse_unwritable(path: str | Path, done: str) -> None:
    """Check `path`, or the nearest existing folder above it."""
    place = Path(path).absolute()
    there = next(place for place in (place, *place.parents) if os.path.exists(place))
    if there != place and not there.is_dir():
        raise UnwritableError(f"{path} cannot be {done}: {there} is not a folder: choose another place")
    if not os.access(there, os.W_OK):
        raise UnwritableError(f"{path} cannot be {done}: you may not write to {there}: choose another place")
