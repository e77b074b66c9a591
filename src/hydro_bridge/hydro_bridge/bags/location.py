# SPDX-License-Identifier: Apache-2.0
"""Locations of recordings: `runs/day`, a part of it `runs/day#t=3600,7200`, and the same in a store that speaks S3.

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

_SECTION_PATTERN = re.compile(r"^(?P<whole>.*)#t=(?P<begin>\d+\.?\d*)?(,(?P<end>\d+\.?\d*)?)?$")
_STORE_PATTERN = re.compile(r"^s3:/+")
_READ_AHEAD_SIZE = 4 << 20  # bytes read at once from a store, where each request has its latency


def split_location(path: Path | str) -> tuple[Path, tuple[float, float] | None]:
    """Split a location into the recording's path and the interval [s] that its `#t=` selects; None: all of it."""
    found = _SECTION_PATTERN.match(str(path))
    if found is None:
        return Path(path), None
    return Path(found["whole"]), (float(found["begin"] or 0.0), float(found["end"] or inf))


def is_remote(path: Path | str) -> bool:
    """Return whether a location is in an S3 store rather than on disk."""
    return _STORE_PATTERN.match(str(path)) is not None


def is_bag(path: Path | str) -> bool:
    """Return whether a location is a rosbag2 folder or an .mcap file, or a part of one."""
    whole, _ = split_location(path)
    return whole.is_dir() or whole.suffix == ".mcap"


def exists(path: Path | str) -> bool:
    """Return whether a location exists; always True for an S3 store, which is not queried."""
    whole, part = split_location(path)
    return is_remote(path) or (whole.exists() and (part is None or is_bag(path)))


def open_file(path: Path) -> tuple[BinaryIO, int]:
    """Open a file on disk or in an S3 store; return the binary stream and its size in bytes. Raises OSError."""
    if not is_remote(path):
        return path.open("rb"), path.stat().st_size
    file = _store().open_input_file(_STORE_PATTERN.sub("", str(path)))
    return cast(BinaryIO, io.BufferedReader(file, _READ_AHEAD_SIZE)), file.size()


def list_remote_bags(word: str) -> list[Path]:
    """Return the .mcap files at or below an S3 address, sorted by name. Raises OSError."""
    from pyarrow.fs import FileSelector

    whole, _ = split_location(word)
    if whole.suffix == ".mcap":
        return [Path(word)]
    found: list[Any] = _store().get_file_info(FileSelector(_STORE_PATTERN.sub("", str(whole)), recursive=True))
    return sorted(Path(f"s3:/{one.path}") for one in found if one.path.endswith(".mcap"))


@cache
def _store() -> FileSystem:
    from pyarrow.fs import S3FileSystem

    return S3FileSystem(endpoint_override=os.environ.get("AWS_ENDPOINT_URL") or None)
