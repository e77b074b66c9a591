# SPDX-License-Identifier: Apache-2.0
"""Topic /hydro/policy: a learning policy's result of each step, for recordings and people; no plant subscribes."""

from __future__ import annotations

from rclpy.node import Node

from hydro_bridge.ros.topics import POLICY, POLICY_QOS
from hydro_msgs.msg import PolicyStep


class PolicySteps:
    """Publishes `PolicyStep` a hundred times a second, with one reused message object.

    Parameters
    ----------
    node
        Node that acts.
    """

    def __init__(self, node: Node) -> None:
        self._clock, self._message = node.get_clock(), PolicyStep()
        self._publisher = node.create_publisher(PolicyStep, POLICY, POLICY_QOS)

    def publish(self, step: int, mean: tuple[float, float], reward: float, weights: int) -> None:
        """See `hydro_policy.supervision.outputs.Outputs.acted`."""
        message = self._message
        message.header.stamp = self._clock.now().to_msg()
        message.step, message.weights, message.reward = step, weights, reward
        message.mean_delta_kp, message.mean_delta_ki = mean
        self._publisher.publish(message)
