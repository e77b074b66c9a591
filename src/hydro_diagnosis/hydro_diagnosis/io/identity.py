# SPDX-License-Identifier: Apache-2.0
"""Identity of a recording in a report: its name, and the stamp of its first sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydro_bridge.bags.recording import RecordingError, stream_bag
from hydro_diagnosis.io.table import is_bag


def identified(path: str | Path) -> dict[str, Any]:
    """`name`, and `begin` [s since 1970] of a bag with /hydro/state; None for files of other loggers."""
    path = Path(path)
    if not is_bag(path):
        return {"name": path.stem, "begin": None}
    try:
        return {"name": path.name, "begin": float(next(stream_bag(path))["time"][0])}
    except (RecordingError, StopIteration, IndexError):  # a bag of other topics
        return {"name": path.stem, "begin": None}
