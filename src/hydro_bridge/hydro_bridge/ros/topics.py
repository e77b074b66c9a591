# SPDX-License-Identifier: Apache-2.0
"""Names, types and quality of service of the graph's topics, shared by publishers and subscribers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.node import Node
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


COMMANDS = (GAINS, REFERENCE, CORRECTION, LAW)
"""Topics that command a plant: one publisher each, or nothing is armed."""
