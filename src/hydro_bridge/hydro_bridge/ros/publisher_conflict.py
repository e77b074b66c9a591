# SPDX-License-Identifier: Apache-2.0
"""Detection of several publishers on a topic that allows one: two trainers' gains would alternate unnoticed."""

from __future__ import annotations

from rclpy.node import Node

from hydro_bridge.ros.diagnostics import Level, Status


def publisher_conflicts(node: Node, *topics: str) -> str:
    """A sentence about each topic that more than one publishes; empty if there is none."""
    crowded = []
    for topic in topics:
        if node.count_publishers(topic) > 1:
            names = sorted(info.node_name for info in node.get_publishers_info_by_topic(topic))
            crowded.append(f"{len(names)} nodes publish {topic} ({', '.join(names)}): end all but one")
    return "; ".join(crowded)


def with_publisher_conflicts(status: Status, trouble: str) -> Status:
    """The status, made an ERROR that says so if there is `trouble`."""
    if not trouble:
        return status
    return Status(level=Level.ERROR, message=f"{trouble}; {status.message}", values=status.values)
