# SPDX-License-Identifier: Apache-2.0
"""Names, types and quality of service of the graph's topics, shared by publishers and subscribers; access rights.

`ACCESS_RIGHTS` is the source of security policies and keys. A graph test compares the running nodes with it, endpoint
by endpoint (tests/test_graph_rights.py): a topic added to a node is added here as well.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock

from hydro_msgs import msg

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
"""ROS's own topic, published by a plant that runs by its own clock; not in `RECORDED_TOPICS`."""
ANSWERED = "/hydro/answered"
"""Acknowledgement of samples by a node (`hydro_bridge.plant_clock`); not in `RECORDED_TOPICS`."""
ARM_SERVICE = "/hydro/arm"
CLAIM_SERVICE = "/hydro/claim"
OVERRIDE_SERVICE = "/hydro/override"
END_SERVICE = "/hydro/end"
FREEZE_SERVICE = "/hydro/freeze_compensation"


def qos_profile(depth: int, *, reliable: bool, latched: bool = False) -> QoSProfile:
    """Return the quality of service that keeps the last `depth` messages; `latched`: also for later subscribers."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


_SAMPLE_QOS = qos_profile(200, reliable=False)  # an old sample has no value; 200 ms of samples for a delayed reader
_LATCHED_QOS = qos_profile(1, reliable=True, latched=True)
_EVENT_QOS = qos_profile(10, reliable=True)

RECORDED_TOPICS: dict[str, tuple[type[Any], QoSProfile]] = {
    STATE: (msg.BenchState, _SAMPLE_QOS),
    BOX: (msg.BoxInfo, _LATCHED_QOS),
    BOX_LAW: (msg.BoxLaw, _LATCHED_QOS),
    LAW_STATE: (msg.LawState, _SAMPLE_QOS),
    AUTHORITY: (msg.Authority, _LATCHED_QOS),
    CORRECTION: (msg.Correction, qos_profile(50, reliable=False)),
    GAINS: (msg.Gains, _EVENT_QOS),
    LAW: (msg.LawCommand, _EVENT_QOS),
    REFERENCE: (msg.ReferenceSignal, _LATCHED_QOS),
    TRAINING: (msg.TrainingStatus, _EVENT_QOS),
    POLICY: (msg.PolicyStep, qos_profile(100, reliable=True)),
    DIAGNOSTICS: (DiagnosticArray, _EVENT_QOS),
    LOG: (Log, qos_profile(1000, reliable=True, latched=True)),
}
"""Type and quality of service of every topic that is recorded."""

_ALL_TOPICS = {
    **RECORDED_TOPICS,
    # Published by several nodes, none of which may displace another's message.
    ANSWERED: (msg.Answered, qos_profile(10, reliable=True, latched=True)),
    CLOCK: (Clock, _EVENT_QOS),
}


def type_name(kind: type[Any]) -> str:
    """Return the name of a message class, `package/msg/Type`."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def create_publisher(node: Node, topic: str) -> Publisher:
    """Create a publisher of a topic of the graph."""
    kind, qos = _ALL_TOPICS[topic]
    return node.create_publisher(kind, topic, qos)


def create_subscription(node: Node, topic: str, callback: Callable[[Any], None]) -> Subscription:
    """Create a subscription to a topic of the graph."""
    kind, qos = _ALL_TOPICS[topic]
    return node.create_subscription(kind, topic, callback, qos)


def hidden_node(name: str) -> Node:
    """Return a node without parameter services, type description service and log publisher."""
    return Node(
        name,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
    )


def mailbox_name(name: str) -> str:
    """Return the name of the hidden node of a `Mailbox` for node `name`."""
    return f"_{name}_mailbox"


class Mailbox:
    """Subscriptions that are polled: messages queue until `fetch`, on a hidden node that is never spun.

    An executor wakes for each message, which costs several times as much as fetching.

    `name`: of the node that fetches.
    """

    def __init__(self, name: str) -> None:
        self._node = hidden_node(mailbox_name(name))

    def subscribe(self, topic: str, kind: type[Any], qos: QoSProfile) -> Subscription:
        """Subscribe to the serialized messages of a topic; the depth of `qos` is that of the queue."""
        return self._node.create_subscription(kind, topic, lambda _: None, qos, raw=True)

    @staticmethod
    def fetch(subscription: Subscription, most: int) -> list[tuple[bytes, int]]:
        """Return up to `most` queued serialized messages, oldest first, each with its arrival time [ns]."""
        fetched: list[tuple[bytes, int]] = []
        with subscription.handle:
            while len(fetched) < most and (taken := subscription.handle.take_message(subscription.msg_type, True)):
                fetched.append((taken[0], taken[1]["received_timestamp"] or time.time_ns()))
        return fetched

    def close(self) -> None:
        """Destroy the hidden node."""
        self._node.destroy_node()


COMMAND_TOPICS = (GAINS, REFERENCE, CORRECTION, LAW)
"""Topics that command a plant: one publisher each, or nothing is armed."""

PARAMETER_EVENTS = "/parameter_events"
DESCRIPTION_SERVICE = "get_type_description"
PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
"""Parameter services of each node, below its name. No node may call them, since our parameters are read-only."""


@dataclass(frozen=True, kw_only=True)
class AccessRights:
    """Access rights of a node: its topics and services, each by its absolute name."""

    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    """Services it offers."""
    calls: tuple[str, ...] = ()
    """Services it calls."""


def _with_rclpy(name: str, rights: AccessRights) -> AccessRights:
    """Return the rights extended by those that rclpy needs for any ordinary node of that name."""
    services = (f"/{name}/{service}" for service in (*PARAMETER_SERVICES, DESCRIPTION_SERVICE))
    return replace(rights, publishes=(*rights.publishes, LOG, PARAMETER_EVENTS), answers=(*rights.answers, *services))


_ARMING_SERVICES = (ARM_SERVICE, CLAIM_SERVICE)
"""Services of a plant. Our own programs call the second, under their names; the first is open to all."""
_PLANT_RIGHTS = AccessRights(
    publishes=(STATE, LAW_STATE, BOX, BOX_LAW, AUTHORITY, DIAGNOSTICS, CLOCK),
    subscribes=(*COMMAND_TOPICS, ANSWERED),
    answers=_ARMING_SERVICES,
)

_CONTROLLER_RIGHTS = AccessRights(
    publishes=(GAINS, LAW, REFERENCE, DIAGNOSTICS, ANSWERED),
    subscribes=(STATE, LAW_STATE, BOX, BOX_LAW, AUTHORITY, DIAGNOSTICS),
    answers=(OVERRIDE_SERVICE, FREEZE_SERVICE, END_SERVICE),
    calls=(CLAIM_SERVICE,),
)
_RIGHTS_BY_EXECUTABLE = {
    "bridge": _PLANT_RIGHTS,
    "sim": _PLANT_RIGHTS,
    "replayer": AccessRights(publishes=(STATE, LAW_STATE, BOX, BOX_LAW, DIAGNOSTICS), answers=_ARMING_SERVICES),
    "filter": AccessRights(
        publishes=(CORRECTION, DIAGNOSTICS, ANSWERED), subscribes=(STATE, LAW_STATE, BOX, AUTHORITY)
    ),
    "trainer": replace(_CONTROLLER_RIGHTS, publishes=(GAINS, LAW, REFERENCE, TRAINING, POLICY, DIAGNOSTICS, ANSWERED)),
    "evaluate": _CONTROLLER_RIGHTS,
    "commission": _CONTROLLER_RIGHTS,
    "collect": AccessRights(
        publishes=(GAINS, REFERENCE, ANSWERED),
        subscribes=(STATE, BOX, BOX_LAW, AUTHORITY, DIAGNOSTICS),
        answers=(OVERRIDE_SERVICE, END_SERVICE),
        calls=(CLAIM_SERVICE,),
    ),
    "recorder": AccessRights(publishes=(DIAGNOSTICS, ANSWERED)),
    "dashboard": AccessRights(
        subscribes=(BOX, AUTHORITY, TRAINING, DIAGNOSTICS),
        calls=(CLAIM_SERVICE, OVERRIDE_SERVICE, FREEZE_SERVICE, END_SERVICE),
    ),
    "arm": AccessRights(calls=(CLAIM_SERVICE,)),
    "override": AccessRights(calls=(OVERRIDE_SERVICE,)),
    "watch": AccessRights(subscribes=(*RECORDED_TOPICS, CLOCK)),
}  # fmt: skip
_NODE_NAMES = {"watch": "_ros2cli_*"}
"""Name of a node where it is not that of its executable."""

_FILTERED_PLANT_RIGHTS = replace(
    _PLANT_RIGHTS, subscribes=tuple(topic for topic in _PLANT_RIGHTS.subscribes if topic != CORRECTION)
)
_FILTERED_PLANT_NODES = {
    "bridge": _FILTERED_PLANT_RIGHTS,
    "sim": _FILTERED_PLANT_RIGHTS,
    "filter": AccessRights(publishes=(CORRECTION, DIAGNOSTICS), subscribes=(BOX,)),
}
"""Nodes of `filtered_plant`, one of the plants and the filter: messages between the two stay in the process."""

ACCESS_RIGHTS: Mapping[str, dict[str, AccessRights]] = {
    **{
        executable: {(name := _NODE_NAMES.get(executable, executable)): _with_rclpy(name, rights)}
        for executable, rights in _RIGHTS_BY_EXECUTABLE.items()
    },
    "filtered_plant": {name: _with_rclpy(name, rights) for name, rights in _FILTERED_PLANT_NODES.items()},
}
for _name, _topics in {
    "recorder": tuple(RECORDED_TOPICS),
    "dashboard": (STATE, LAW_STATE, CORRECTION),
    "trainer": (CORRECTION,),
    "evaluate": (CORRECTION,),
    "commission": (CORRECTION,),
    "collect": (),
}.items():
    ACCESS_RIGHTS[_name][mailbox_name(_name)] = AccessRights(publishes=(PARAMETER_EVENTS,), subscribes=_topics)
"""Rights by executable and node. `watch` is not one of our executables but a user's read-only `ros2 topic echo`."""
