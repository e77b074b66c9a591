# SPDX-License-Identifier: Apache-2.0
"""`ros2 bag info`."""

from __future__ import annotations

import argparse
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from hydro_bridge.bags.summary import RecordingSummary, summarized

GROUP, HELP = "bag", "recordings: info"
_UNITS = ("B", "KiB", "MiB", "GiB")


def add_verbs(verbs: Any) -> None:
    """Add the group's verbs."""
    info = verbs.add_parser("info", help="what a recording holds; of a recorder that was killed or still runs, too")
    info.add_argument("bag", type=Path, metavar="BAG", help="a rosbag2 folder or an .mcap file")
    info.set_defaults(carry_out=_info)


def _info(options: argparse.Namespace) -> None:
    print(text(summarized(options.bag)))


def text(summary: RecordingSummary) -> str:
    """Return a summary in the format of upstream's `ros2 bag info`, then the irregularities of the recording."""
    topics = [
        f"Topic: {topic} | Type: {kind} | Count: {count} | Serialization Format: cdr"
        for topic, (kind, count) in sorted(summary.topics.items())
    ]
    lines = {
        "Files:": "  ".join(path.name for path in summary.files),
        "Bag size:": _size(summary.size),
        "Storage id:": "mcap",
        "Duration:": f"{1e-9 * (summary.end_ns - summary.begin_ns):.9f}s",
        "Start:": _when(summary.begin_ns),
        "End:": _when(summary.end_ns),
        "Messages:": str(sum(count for _, count in summary.topics.values())),
        "Topic information:": f"\n{'':19}".join(topics),
    }
    return "\n".join([*(f"{name:<19}{value}" for name, value in lines.items()), *summary.notes])


def _when(time_ns: int) -> str:
    seconds, rest = divmod(time_ns, 1_000_000_000)
    words = datetime.fromtimestamp(seconds, timezone.utc).strftime("%b %d %Y %H:%M:%S")
    return f"{words}.{rest:09d} UTC ({seconds}.{rest:09d})"


def _size(count: float) -> str:
    unit = 0
    while count >= 1024.0 and unit < len(_UNITS) - 1:
        count, unit = count / 1024.0, unit + 1
    return f"{count:.1f} {_UNITS[unit]}"
