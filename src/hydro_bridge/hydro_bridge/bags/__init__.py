# SPDX-License-Identifier: Apache-2.0
"""Recordings: rosbag2 folders and single .mcap files, read, written, checked, repaired and replayed, without ROS.

A location is such a folder or file, or the part of one from BEGIN up to END s since its start, named as in W3C's media
fragments: `runs/day#t=3600,7200`; either number may be absent.
"""

from __future__ import annotations

import re
from math import inf
from pathlib import Path

from hydro_core.errors import UserError


class RecordingError(UserError):
    """A recording cannot be read or written; the message is one sentence."""


def split_location(path: Path | str) -> tuple[Path, tuple[float, float] | None]:
    """Split a location into the recording's path and the interval [s] that its `#t=` selects; None: all of it."""
    found = re.match(r"^(?P<whole>.*)#t=(?P<begin>\d+\.?\d*)?(,(?P<end>\d+\.?\d*)?)?$", str(path))
    if found is None:
        return Path(path), None
    return Path(found["whole"]), (float(found["begin"] or 0.0), float(found["end"] or inf))


def is_bag(path: Path | str) -> bool:
    """Return whether a location is a rosbag2 folder or an .mcap file, or a part of one."""
    whole, _ = split_location(path)
    return whole.is_dir() or whole.suffix == ".mcap"


def exists(path: Path | str) -> bool:
    """Return whether a location exists."""
    whole, part = split_location(path)
    return whole.exists() and (part is None or is_bag(path))
