# SPDX-License-Identifier: Apache-2.0
"""Status of a node, published once a second on /diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from hydro_bridge.ros.topics import DIAGNOSTICS, DIAGNOSTICS_QOS


class Level(IntEnum):
    """As in diagnostic_msgs/DiagnosticStatus."""

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

    def __init__(
        self, node: Node, collect: Callable[[], Status], *, hardware_id: str = "hydro", name: str = ""
    ) -> None:
        self._node, self._collect, self._hardware_id = node, collect, hardware_id
        self._name = name or node.get_name()
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, DIAGNOSTICS_QOS)
        self._timer = node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish now."""
        status = self._collect()
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        array.status = [
            DiagnosticStatus(
                level=bytes([status.level]),
                name=self._name,
                message=status.message,
                hardware_id=self._hardware_id,
                values=[KeyValue(key=key, value=_shown(value)) for key, value in status.values.items()],
            )
        ]
        self._publisher.publish(array)


def _shown(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
