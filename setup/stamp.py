# SPDX-License-Identifier: Apache-2.0
"""Digests that tell whether a step's inputs have changed since it was last carried out."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

# What a built package depends on. Python modules are linked into the installation, so editing them needs no build.
CONTENT = (
    "package.xml",
    "setup.py",
    "setup.cfg",
    "CMakeLists.txt",
    "msg/*.msg",
    "srv/*.srv",
    "action/*.action",
    "resource/*",
)
# Files linked one by one: their names count, their text does not.
NAMES = ("launch/*", "config/*")


def digest(words: Iterable[str], contents: Iterable[Path] = (), names: Iterable[Path] = ()) -> str:
    """Return a digest of words, of files (names and contents) and of bare file names; order does not matter."""
    sha = hashlib.sha256()
    for word in sorted(words):
        sha.update(f"word {word}\n".encode())
    for path in sorted(contents):
        sha.update(f"file {path} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    for path in sorted(names):
        sha.update(f"name {path}\n".encode())
    return sha.hexdigest()


def package_inputs(source: Path) -> tuple[list[Path], list[Path]]:
    """Return (files whose content decides, files whose name decides) for the packages below `source`."""
    contents = [path for pattern in CONTENT for path in source.glob(f"*/{pattern}") if path.is_file()]
    names = [path for pattern in NAMES for path in source.glob(f"*/{pattern}")]
    return contents, names


def is_current(stamp: Path, wanted: str) -> bool:
    """Say whether `stamp` holds the digest `wanted`."""
    try:
        return stamp.read_text().strip() == wanted
    except OSError:
        return False


def write(stamp: Path, value: str) -> None:
    """Write a stamp; a partly written one cannot be taken for a whole one."""
    part = stamp.with_suffix(".part")
    part.write_text(value + "\n")
    part.replace(stamp)
