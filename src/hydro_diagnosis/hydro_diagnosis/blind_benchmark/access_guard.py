# SPDX-License-Identifier: Apache-2.0
"""Access guard: an audit hook that lets a process open only permitted files of the proof's folder.

An audit hook (PEP 578) cannot be removed; it refuses files, listings of folders, other processes, and the code
of the truth plant. It guards against a mistake, not against native code written to get around it.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

TRUTH = "hydro_sim.emulator"
"""Package whose code makes the recordings."""
_STARTS = ("subprocess.Popen", "os.exec", "os.posix_spawn", "os.system", "os.fork")


class SealedError(PermissionError):
    """The diagnosis reached for what it must not see."""


_worn: set[tuple[str, str]] = set()


def put_on(hidden: Path, seen: Path) -> None:
    """Refuse access below `hidden` except below `seen`; one call per process and pair of folders suffices."""
    pair = (os.path.realpath(hidden), os.path.realpath(seen))
    if pair in _worn:
        return
    _worn.add(pair)
    if any(name == TRUTH or name.startswith(TRUTH + ".") for name in sys.modules):
        raise SealedError(f"{TRUTH} is loaded already")

    def look(event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir"):
            path = arguments[0] if arguments else None
            if isinstance(path, (str, bytes, os.PathLike)) and _below(path, *pair):
                raise SealedError(f"{os.fsdecode(path)} is sealed")
        elif event == "import" and str(arguments[0]).startswith(TRUTH):
            raise SealedError(f"{arguments[0]} holds the truth")
        elif event in _STARTS:
            raise SealedError("the diagnosis starts no other process")

    sys.addaudithook(look)


def _below(path: str | bytes | os.PathLike[Any], hidden: str, seen: str) -> bool:
    real = os.path.realpath(os.fsdecode(path))
    return _within(real, hidden) and not _within(real, seen)


def _within(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder + os.sep)
