# SPDX-License-Identifier: Apache-2.0
"""Detection of several publishers on a topic that allows one: the gains of two trainers would alternate unnoticed."""

from __future__ import annotations

from rclpy.node import Node

from hydro_bridge.ros.diagnostics import Level, Status


def publisher_conflicts(node: Node, *topics: str) -> str:
    """Return a sentence about each topic with more than one publisher; empty if there is none."""
    crowded = []
    for topic in topics:
        if node.count_publishers(topic) > 1:
            names = sorted(info.node_name for info in node.get_publishers_info_by_topic(topic))
            crowded.append(f"{len(names)} nodes publish {topic} ({', '.join(names)}): end all but one")
    return "; ".join(crowded)


def with_publisher_conflicts(status: Status, trouble: str) -> Status:
    """Return the status, turned into an ERROR that reports `trouble` if there is any."""
    if not trouble:
        return status
    return Status(level=Level.ERROR, message=f"{trouble}; {status.message}", values=status.values)
