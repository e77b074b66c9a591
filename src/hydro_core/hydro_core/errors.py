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


def is_user_error(error: Exception) -> bool:
    """Return whether it is a UserError, or the operating system's about a file or disk space: no programming error."""
    of_file = isinstance(error, OSError) and (error.filename is not None or error.errno in _UNWRITABLE_ERRNOS)
    return of_file or isinstance(error, UserError)


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
    if os.path.isfile(path) or not os.path.exists(path):  # no device
        _check_folder(Path(path).resolve().parent, path)  # a file is replaced by a new one
    return path


def writable_folder(path: str | Path) -> Path:
    """Return `path` if it is a writable folder or can be created; raises UnwritableError.

    The folder is not created yet, so that a command that then refuses another argument leaves nothing behind.
    """
    _check_folder(Path(path).absolute(), path)
    return Path(path)


def _check_folder(folder: Path, path: str | Path) -> None:
    there = next(place for place in (folder, *folder.parents) if os.path.exists(place))
    if not there.is_dir():
        raise UnwritableError(f"{path} cannot be written: {there} is not a folder: choose another place")
    if not os.access(there, os.W_OK):
        raise UnwritableError(f"{path} cannot be written: you may not write to {there}: choose another place")
