# SPDX-License-Identifier: Apache-2.0
"""Log messages for recordings and tools: on /rosout only, since the terminal already shows them."""

from __future__ import annotations

from rcl_interfaces.msg import Log
from rclpy.node import Node

from hydro_bridge.ros.topics import LOG, LOG_QOS

CALLS = "calls"
"""Last part of the logger name of service calls: caller, request and answer."""


class Journal:
    """Publishes sentences on /rosout under a node's name.

    Parameters
    ----------
    node
        Source of the messages.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(Log, LOG, LOG_QOS)

    def tell(self, sentence: str, warning: bool = False) -> None:
        """Add a sentence."""
        self._publish(self._node.get_name(), sentence, Log.WARN if warning else Log.INFO)

    def call(self, sentence: str) -> None:
        """Add a service call: caller, request and answer."""
        self._publish(f"{self._node.get_name()}.{CALLS}", sentence, Log.INFO)

    def _publish(self, name: str, sentence: str, level: int | bytes) -> None:
        level = level if isinstance(level, int) else level[0]
        stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(Log(stamp=stamp, level=level, name=name, msg=sentence))
