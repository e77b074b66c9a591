# SPDX-License-Identifier: Apache-2.0
"""Summary of a recording, finished or not: topics, counts, times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hydro_bridge.bags.source import BagSource


@dataclass(frozen=True, kw_only=True)
class RecordingSummary:
    """Counts over one recording."""

    files: tuple[Path, ...]
    size: int
    """Bytes of all files."""
    begin_ns: int
    """ns since 1970, log time of the first message; 0 without any."""
    end_ns: int
    topics: dict[str, tuple[str, int]]
    """Type and number of messages of each announced topic."""
    notes: tuple[str, ...]
    """Irregularities, a sentence each."""


def summarized(path: Path | str) -> RecordingSummary:
    """Count a recording's messages in one pass over its files.

    Raises
    ------
    RecordingError
        Nothing there, or damaged.
    """
    source = BagSource(Path(path))
    counts: dict[str, int] = {}
    first, last = 2**63 - 1, 0
    for _, channel, _, span in source.spans():
        counts[channel.topic] = counts.get(channel.topic, 0) + len(span.log_times)
        if len(span.log_times):
            first, last = min(first, int(span.log_times.min())), max(last, int(span.log_times.max()))
    announced = {
        channel.topic: scan.schemas[channel.schema_id].name if channel.schema_id in scan.schemas else ""
        for scan in source.scans
        for channel in scan.channels.values()
    }
    return RecordingSummary(
        files=tuple(scan.path for scan in source.scans),
        size=sum(scan.path.stat().st_size for scan in source.scans),
        begin_ns=first if last else 0,
        end_ns=last,
        topics={topic: (kind, counts.get(topic, 0)) for topic, kind in announced.items()},
        notes=tuple(source.notes),
    )
