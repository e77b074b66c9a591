# SPDX-License-Identifier: Apache-2.0
"""Reports of nodes: /diagnostics, /rosout, and conflicts with other nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Log
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from hydro_bridge.ros.topics import DIAGNOSTICS, LOG, create_publisher


class Level(IntEnum):
    """Levels of a status, as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, kw_only=True)
class Status:
    """A node's status: a level, a sentence, and values by name."""

    level: Level = Level.OK
    message: str = ""
    values: Mapping[str, object] = field(default_factory=dict)


class DiagnosticsPublisher:
    """Publishes the status that `collect` returns, once a second of the steady clock, by default in the node's name."""

    def __init__(self, node: Node, collect: Callable[[], Status], *, name: str = "") -> None:
        self._node, self._collect = node, collect
        self._name = name or node.get_name()
        self._publisher = create_publisher(node, DIAGNOSTICS)
        self._timer = node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish the status now."""
        status = self._collect()
        shown = {
            key: f"{value:.6g}" if isinstance(value, float) else str(value) for key, value in status.values.items()
        }
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        array.status = [
            DiagnosticStatus(
                level=bytes([status.level]),
                name=self._name,
                message=status.message,
                hardware_id="hydro",
                values=[KeyValue(key=key, value=value) for key, value in shown.items()],
            )
        ]
        self._publisher.publish(array)


def publisher_conflicts(node: Node, *topics: str) -> str:
    """Return a sentence about each topic with more than one publisher; empty if there is none."""
    crowded = []
    for topic in topics:
        if node.count_publishers(topic) > 1:
            names = sorted(info.node_name for info in node.get_publishers_info_by_topic(topic))
            crowded.append(f"{len(names)} nodes publish {topic} ({', '.join(names)}): end all but one")
    return "; ".join(crowded)


def with_publisher_conflicts(status: Status, trouble: str) -> Status:
    """Return the status, as an ERROR that reports `trouble` if there is any."""
    if not trouble:
        return status
    return Status(level=Level.ERROR, message=f"{trouble}; {status.message}", values=status.values)


CALL_LOGGER = "calls"
"""Last part of the logger name of service calls: caller, request and answer."""


class RosoutLogger:
    """Publishes log messages on /rosout under a node's name; `node`: source of the messages."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = create_publisher(node, LOG)

    def log(self, sentence: str, warning: bool = False, logger: str = "") -> None:
        """Log a message; `logger`: appended to the node's name."""
        level: int | bytes = Log.WARN if warning else Log.INFO
        level, name = level if isinstance(level, int) else level[0], self._node.get_name() + logger
        stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(Log(stamp=stamp, level=level, name=name, msg=sentence))

    def log_call(self, sentence: str) -> None:
        """Log a service call: caller, request and answer."""
        self.log(sentence, logger=f".{CALL_LOGGER}")


def warn_of_duplicate_nodes(node: Node, sentence: str) -> None:
    """Log the warning `sentence` once, as soon as the graph has another node of the same name."""

    def look() -> None:
        if node.get_node_names().count(node.get_name()) > 1:
            node.get_logger().warning(sentence)
            timer.cancel()

    timer = node.create_timer(1.0, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
