# SPDX-License-Identifier: Apache-2.0
"""The error of recordings, and the definitions of the graph's messages, by which recording needs no ROS."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from hydro_core.errors import UserError


class RecordingError(UserError):
    """A recording cannot be read or written; the message is one sentence."""


@dataclass(frozen=True, kw_only=True)
class Definition:
    """Type definition for an MCAP channel."""

    text: str
    """Encoding ros2msg: the type's own .msg text, then each nested type below a rule and `MSG: package/Type`."""
    type_hash: str
    """RIHS01 hash of the type description."""


SCHEMA_FILE = Path(__file__).with_name("schemas.json")
"""Definitions by type; `python -m tests.schemas` renews them from the installed messages."""


@cache
def definition(type_name: str) -> Definition:
    """Return the definition of `package/msg/Type`; raises KeyError for a type that the graph does not record."""
    return Definition(**json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))[type_name])
