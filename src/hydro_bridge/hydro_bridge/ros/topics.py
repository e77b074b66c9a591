# SPDX-License-Identifier: Apache-2.0
"""Names, types and quality of service of the graph's topics, shared by publishers and subscribers."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from hydro_msgs.msg import (
    Authority,
    BenchState,
    BoxInfo,
    BoxLaw,
    Correction,
    Gains,
    LawCommand,
    LawState,
    PolicyStep,
    ReferenceSignal,
    TrainingStatus,
)

STATE = "/hydro/state"
GAINS = "/hydro/gains"
BOX = "/hydro/box"
LAW = "/hydro/law"
LAW_STATE = "/hydro/law_state"
BOX_LAW = "/hydro/box_law"
AUTHORITY = "/hydro/authority"
CORRECTION = "/hydro/correction"
REFERENCE = "/hydro/reference"
TRAINING = "/hydro/training"
POLICY = "/hydro/policy"
DIAGNOSTICS = "/diagnostics"
LOG = "/rosout"
"""ROS's own topic: log messages of every node, and its service calls (`hydro_bridge.ros.diagnostics`)."""
CLOCK = "/clock"
"""ROS's own topic, from a simulation off real time; not in GRAPH, since it is not recorded."""
ARM_SERVICE = "/hydro/arm"
CLAIM_SERVICE = "/hydro/claim"
OVERRIDE_SERVICE = "/hydro/override"
END_SERVICE = "/hydro/end"
FREEZE_SERVICE = "/hydro/freeze_compensation"


def _qos(depth: int, *, reliable: bool, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


_SAMPLES = _qos(200, reliable=False)  # an old sample has no value; 200 ms of samples for a delayed reader
_LATCHED = _qos(1, reliable=True, latched=True)
_EVENTS = _qos(10, reliable=True)

GRAPH: dict[str, tuple[type[Any], QoSProfile]] = {
    STATE: (BenchState, _SAMPLES),
    BOX: (BoxInfo, _LATCHED),
    BOX_LAW: (BoxLaw, _LATCHED),
    LAW_STATE: (LawState, _SAMPLES),
    AUTHORITY: (Authority, _LATCHED),
    CORRECTION: (Correction, _qos(50, reliable=False)),
    GAINS: (Gains, _EVENTS),
    LAW: (LawCommand, _EVENTS),
    REFERENCE: (ReferenceSignal, _LATCHED),
    TRAINING: (TrainingStatus, _EVENTS),
    POLICY: (PolicyStep, _qos(100, reliable=True)),
    DIAGNOSTICS: (DiagnosticArray, _EVENTS),
    LOG: (Log, _qos(1000, reliable=True, latched=True)),
}
"""Type and quality of service of every topic."""


def create_publisher(node: Node, topic: str) -> Publisher:
    """Publish a topic of `GRAPH`."""
    kind, qos = GRAPH[topic]
    return node.create_publisher(kind, topic, qos)


def create_subscription(node: Node, topic: str, callback: Callable[[Any], None]) -> Subscription:
    """Subscribe to a topic of `GRAPH`."""
    kind, qos = GRAPH[topic]
    return node.create_subscription(kind, topic, callback, qos)


def mailbox_name(name: str) -> str:
    """Return the name of the hidden node of a `Mailbox` for node `name`."""
    return f"_{name}_mailbox"


class Mailbox:
    """Subscriptions whose messages wait until they are fetched, on a hidden node of their own that is never spun.

    An executor wakes for each message, which costs several times what fetching does.

    `name`: of the node that fetches.
    """

    def __init__(self, name: str) -> None:
        self._node = Node(
            mailbox_name(name),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )

    def subscribe(self, topic: str, kind: type[Any], qos: QoSProfile) -> Subscription:
        """Subscribe to the serialized messages of a topic; the depth of `qos` is that of the queue."""
        return self._node.create_subscription(kind, topic, _never, qos, raw=True)

    @staticmethod
    def fetch(subscription: Subscription, most: int) -> list[tuple[bytes, int]]:
        """Return at most so many of the serialized messages that wait, oldest first, each with its arrival [ns]."""
        fetched: list[tuple[bytes, int]] = []
        with subscription.handle:
            while len(fetched) < most and (taken := subscription.handle.take_message(subscription.msg_type, True)):
                fetched.append((taken[0], taken[1]["received_timestamp"] or time.time_ns()))
        return fetched

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()


def _never(_: object) -> None:
    """Callback of a node that is not spun."""


COMMANDS = (GAINS, REFERENCE, CORRECTION, LAW)
"""Topics that command a plant: one publisher each, or nothing is armed."""
