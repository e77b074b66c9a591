# SPDX-License-Identifier: Apache-2.0
"""Stamps in safetensors files: the box that a file was made for; tensors are not touched.

A safetensors file is the header's length (u64, little endian), the header as JSON, filled with blanks to a multiple of
eight, and the tensors, whose places count from the header's end.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hydro_sim.files.pairing import ENTRY, MadeFor, made_for

_LENGTH = 8


def header_of(blob: bytes) -> dict[str, Any]:
    """Return the header of this project's files, JSON under `hydro`.

    Raises
    ------
    ValueError
        If the bytes are not of such a file.
    """
    try:
        outer = json.loads(blob[_LENGTH : _LENGTH + int.from_bytes(blob[:_LENGTH], "little")])
        header: dict[str, Any] = json.loads(outer["__metadata__"]["hydro"])
        return header
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError("its header has no readable entry 'hydro'") from error


def stamp_of(path: Path) -> MadeFor | None:
    """Return the stamp of a file; None if it has none or is of another project."""
    try:
        return made_for(header_of(path.read_bytes()))
    except ValueError:
        return None


def stamped(blob: bytes, made: MadeFor | None) -> bytes:
    """Return the same file with this stamp instead of its own; None: without.

    Raises
    ------
    ValueError
        See `header_of`.
    """
    header = {key: value for key, value in header_of(blob).items() if key != ENTRY}
    if made is not None:
        header[ENTRY] = made.to_header()
    length = int.from_bytes(blob[:_LENGTH], "little")
    outer = json.loads(blob[_LENGTH : _LENGTH + length])
    outer["__metadata__"]["hydro"] = json.dumps(header)
    text = json.dumps(outer, separators=(",", ":")).encode()
    text += b" " * (-len(text) % _LENGTH)
    return len(text).to_bytes(_LENGTH, "little") + text + blob[_LENGTH + length :]
