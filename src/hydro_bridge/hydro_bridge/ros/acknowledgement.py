# SPDX-License-Identifier: Apache-2.0
"""Acknowledgement of samples to a plant that runs by its own clock (`hydro_bridge.plant_clock`)."""

from __future__ import annotations

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from hydro_bridge.ros.topics import ANSWERED, create_publisher
from hydro_msgs.msg import Answered


class SampleAcknowledger:
    """Acknowledges samples to a plant that runs by its own clock, on /hydro/answered.

    `node`: the node. `window`: number of samples that the plant may be ahead of this node. `states`: its subscription
    to the states.
    """

    def __init__(self, node: Node, window: int, states: Subscription) -> None:
        self._states = states
        self._publisher = create_publisher(node, ANSWERED)
        self._message = Answered(node=node.get_name(), window=window)
        self._looks, self._met = 0, False
        node.create_timer(0.05, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def acknowledge(self, sequence: int, commands: int = 0) -> None:
        """Publish that all samples up to `sequence` are answered; `commands`: number of commands sent so far."""
        message = self._message
        message.answers, message.sequence, message.commands = True, sequence, commands
        self._publisher.publish(message)

    def _look(self) -> None:
        """Announce this node once it receives the plant's samples, and repeat its last answer once a second."""
        met, self._met = self._met, self._states.get_publisher_count() > 0
        self._looks += 1
        if self._met and (not met or self._looks % 20 == 0):
            self._publisher.publish(self._message)
