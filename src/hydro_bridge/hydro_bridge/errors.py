# SPDX-License-Identifier: Apache-2.0
"""What the user can put right, as one sentence; and whether something can be written where the user wants it."""

from __future__ import annotations

import argparse
import errno
import os
from pathlib import Path

_NO_PLACE = frozenset({errno.ENOTDIR, errno.EROFS, errno.ENOSPC, errno.EDQUOT})


class UserError(Exception):
    """Something that the user can put right; the message is one sentence. `main` prints it, exit status 2."""


class UnwritableError(UserError, argparse.ArgumentTypeError):
    """Nothing can be written there. Argparse, too, takes it for something that the user can put right."""


def of_a_file(error: Exception) -> bool:
    """Whether it is the system's, about a file or the room for one: then it is none of ours."""
    return isinstance(error, OSError) and (error.filename is not None or error.errno in _NO_PLACE)


def explained(error: Exception) -> str:
    """What an error says to a user: one of the system's names its file, says what to do, and has no number."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    file = "" if error.filename is None else f"{error.filename}: "
    remedy = ": choose another place" if error.errno in _NO_PLACE else ""
    return f"{file}{error.strerror}{remedy}"


def writable(path: str) -> str:
    """`path`, if a file can be written there: found out now, not after what may be hours.

    Raises
    ------
    UnwritableError
        It cannot; the sentence says why.
    """
    if os.path.isdir(path):
        raise UnwritableError(f"{path} is a folder: name a file")
    _refuse_unwritable(path, "written")
    if os.path.isfile(path):  # it is replaced by a new one, which takes its folder
        folder = Path(path).resolve().parent
        if not os.access(folder, os.W_OK):
            raise UnwritableError(f"{path} cannot be written: you may not write to {folder}: choose another place")
    return path


def writable_folder(path: str | Path) -> Path:
    """`path`, if it is a folder that can be written to, or one can be made there; raises UnwritableError.

    It is not made yet: a command that refuses something else leaves nothing behind.
    """
    _refuse_unwritable(path, "made")
    if os.path.exists(path) and not os.path.isdir(path):
        raise UnwritableError(f"{path} is a file: name a folder")
    return Path(path)


def _refuse_unwritable(path: str | Path, done: str) -> None:
    """Look at `path`, or else at the nearest folder above it that is there."""
    place = Path(path).absolute()
    there = next(place for place in (place, *place.parents) if os.path.exists(place))
    if there != place and not there.is_dir():
        raise UnwritableError(f"{path} cannot be {done}: {there} is no folder: choose another place")
    if not os.access(there, os.W_OK):
        raise UnwritableError(f"{path} cannot be {done}: you may not write to {there}: choose another place")
