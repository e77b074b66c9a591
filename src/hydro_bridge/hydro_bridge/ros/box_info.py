# SPDX-License-Identifier: Apache-2.0
"""Subscription to the box's description on /hydro/box."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.subscription import Subscription

from hydro_bridge.ros.messages import box_from_message
from hydro_bridge.ros.topics import BOX, BOX_QOS
from hydro_bridge.safety.box_info import KnownBox
from hydro_msgs.msg import BoxInfo


def listen_to_box(node: Node, on_box: Callable[[KnownBox], None]) -> Subscription:
    """Call `on_box` with the box's description as soon as the plant node is discovered, and at each change."""
    return node.create_subscription(BoxInfo, BOX, lambda message: on_box(box_from_message(message)), BOX_QOS)
