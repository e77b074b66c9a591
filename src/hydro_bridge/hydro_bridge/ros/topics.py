# SPDX-License-Identifier: Apache-2.0
"""Names, types and quality of service of the graph's topics: publishers and subscribers both take them from here."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from hydro_msgs.msg import (
    Authority,
    BenchState,
    BoxInfo,
    Correction,
    Gains,
    PolicyStep,
    ReferenceSignal,
    TrainingStatus,
)

STATE = "/hydro/state"
GAINS = "/hydro/gains"
BOX = "/hydro/box"
AUTHORITY = "/hydro/authority"
CORRECTION = "/hydro/correction"
REFERENCE = "/hydro/reference"
TRAINING = "/hydro/training"
POLICY = "/hydro/policy"
DIAGNOSTICS = "/diagnostics"
LOG = "/rosout"
"""ROS's own: what every node logs, and what was asked of it (`hydro_bridge.ros.journal`)."""
CLOCK = "/clock"
"""ROS's own, of a simulation off real time; not in GRAPH, for nobody records it."""
ARM_SERVICE = "/hydro/arm"
CLAIM_SERVICE = "/hydro/claim"
OVERRIDE_SERVICE = "/hydro/override"
END_SERVICE = "/hydro/end"


def _qos(depth: int, *, reliable: bool, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


STATE_QOS = _qos(200, reliable=False)
"""An old sample is worth nothing: never resent. 200 ms of samples wait for a reader that was held up."""
CORRECTION_QOS = _qos(50, reliable=False)
GAINS_QOS = _qos(10, reliable=True)
BOX_QOS = _qos(1, reliable=True, latched=True)
AUTHORITY_QOS = _qos(1, reliable=True, latched=True)
REFERENCE_QOS = _qos(1, reliable=True, latched=True)
TRAINING_QOS = _qos(10, reliable=True)
POLICY_QOS = _qos(100, reliable=True)
DIAGNOSTICS_QOS = _qos(10, reliable=True)
LOG_QOS = _qos(1000, reliable=True, latched=True)
"""As ROS offers its log."""

GRAPH: dict[str, tuple[type[Any], QoSProfile]] = {
    STATE: (BenchState, STATE_QOS),
    BOX: (BoxInfo, BOX_QOS),
    AUTHORITY: (Authority, AUTHORITY_QOS),
    CORRECTION: (Correction, CORRECTION_QOS),
    GAINS: (Gains, GAINS_QOS),
    REFERENCE: (ReferenceSignal, REFERENCE_QOS),
    TRAINING: (TrainingStatus, TRAINING_QOS),
    POLICY: (PolicyStep, POLICY_QOS),
    DIAGNOSTICS: (DiagnosticArray, DIAGNOSTICS_QOS),
    LOG: (Log, LOG_QOS),
}
"""Type and quality of service of every topic."""

COMMANDS = (GAINS, REFERENCE, CORRECTION)
"""Topics by which a plant is commanded: one publisher each, or nothing is armed."""
