# SPDX-License-Identifier: Apache-2.0
"""Detection of duplicate node names; each node warns its user once."""

from __future__ import annotations

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

_PERIOD = 1.0  # s


def warn_of_duplicate_nodes(node: Node, sentence: str) -> None:
    """Warn with `sentence`, once, as soon as another node of the same name is in the graph."""

    def look() -> None:
        if node.get_node_names().count(node.get_name()) > 1:
            node.get_logger().warning(sentence)
            timer.cancel()

    timer = node.create_timer(_PERIOD, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
