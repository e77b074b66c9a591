# SPDX-License-Identifier: Apache-2.0
"""Places of recordings: `runs/day`, a part of it `runs/day#t=3600,7200`, and the same in a store that speaks S3.

A part is named as in W3C's media fragments: from BEGIN up to END [s] since the first message; either may be absent.
`s3://BUCKET/day.mcap` is read with the keys that AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY name, or those of
`~/.aws`, at AWS_ENDPOINT_URL if it is no store of Amazon's.
"""

from __future__ import annotations

import io
import os
import re
from functools import cache
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

if TYPE_CHECKING:
    from pyarrow.fs import FileSystem

_PART = re.compile(r"^(?P<whole>.*)#t=(?P<begin>\d+\.?\d*)?(,(?P<end>\d+\.?\d*)?)?$")
_STORED = re.compile(r"^s3:/+")
_AHEAD = 4 << 20  # bytes read at once from a store, where each request takes its time


def parted(path: Path | str) -> tuple[Path, tuple[float, float] | None]:
    """Split a place into the whole recording's, and the part of it that is meant [s]; None: all."""
    found = _PART.match(str(path))
    if found is None:
        return Path(path), None
    return Path(found["whole"]), (float(found["begin"] or 0.0), float(found["end"] or inf))


def is_stored(path: Path | str) -> bool:
    """Return whether a place is in a store, not on a disk."""
    return _STORED.match(str(path)) is not None


def is_bag(path: Path | str) -> bool:
    """Return whether a place is a rosbag2 folder or an .mcap file, or a part of one."""
    whole, _ = parted(path)
    return whole.is_dir() or whole.suffix == ".mcap"


def is_there(path: Path | str) -> bool:
    """Return whether there is something at a place. Of a store that is known once it is read."""
    whole, part = parted(path)
    return is_stored(path) or (whole.exists() and (part is None or is_bag(path)))


def opened(path: Path) -> tuple[BinaryIO, int]:
    """Open a file for reading; also its size in bytes. Raises OSError."""
    if not is_stored(path):
        return path.open("rb"), path.stat().st_size
    file = _store().open_input_file(_key(path))
    return cast(BinaryIO, io.BufferedReader(file, _AHEAD)), file.size()


def stored_below(word: str) -> list[Path]:
    """The .mcap files at an address or below it, in order of their names. Raises OSError."""
    from pyarrow.fs import FileSelector

    whole, _ = parted(word)
    if whole.suffix == ".mcap":
        return [Path(word)]
    found: list[Any] = _store().get_file_info(FileSelector(_key(whole), recursive=True))
    return sorted(Path(f"s3:/{one.path}") for one in found if one.path.endswith(".mcap"))


def _key(path: Path) -> str:
    return _STORED.sub("", str(path))


@cache
def _store() -> FileSystem:
    from pyarrow.fs import S3FileSystem

    return S3FileSystem(endpoint_override=os.environ.get("AWS_ENDPOINT_URL") or None)
