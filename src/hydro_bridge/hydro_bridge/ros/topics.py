# SPDX-License-Identifier: Apache-2.0
"""Names, types and quality of service of the graph's topics, shared by publishers and subscribers."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

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


STATE_QOS = _qos(200, reliable=False)
"""Best effort, since an old sample has no value; the queue holds 200 ms of samples for a delayed reader."""
CORRECTION_QOS = _qos(50, reliable=False)
GAINS_QOS = _qos(10, reliable=True)
LAW_QOS = GAINS_QOS
LAW_STATE_QOS = STATE_QOS
BOX_QOS = _qos(1, reliable=True, latched=True)
BOX_LAW_QOS = BOX_QOS
AUTHORITY_QOS = _qos(1, reliable=True, latched=True)
REFERENCE_QOS = _qos(1, reliable=True, latched=True)
TRAINING_QOS = _qos(10, reliable=True)
POLICY_QOS = _qos(100, reliable=True)
DIAGNOSTICS_QOS = _qos(10, reliable=True)
LOG_QOS = _qos(1000, reliable=True, latched=True)
"""Quality of service of ROS's own log."""

GRAPH: dict[str, tuple[type[Any], QoSProfile]] = {
    STATE: (BenchState, STATE_QOS),
    BOX: (BoxInfo, BOX_QOS),
    BOX_LAW: (BoxLaw, BOX_LAW_QOS),
    LAW_STATE: (LawState, LAW_STATE_QOS),
    AUTHORITY: (Authority, AUTHORITY_QOS),
    CORRECTION: (Correction, CORRECTION_QOS),
    GAINS: (Gains, GAINS_QOS),
    LAW: (LawCommand, LAW_QOS),
    REFERENCE: (ReferenceSignal, REFERENCE_QOS),
    TRAINING: (TrainingStatus, TRAINING_QOS),
    POLICY: (PolicyStep, POLICY_QOS),
    DIAGNOSTICS: (DiagnosticArray, DIAGNOSTICS_QOS),
    LOG: (Log, LOG_QOS),
}
"""Type and quality of service of every topic."""

COMMANDS = (GAINS, REFERENCE, CORRECTION, LAW)
"""Topics that command a plant: one publisher each, or nothing is armed."""
