# SPDX-License-Identifier: Apache-2.0
"""Utilities of all nodes: topics, message conversion, parameters, diagnostics, spinning, companion processes."""

from __future__ import annotations

from hydro_bridge.process.realtime import drop_realtime
from hydro_bridge.ros.box_info import listen_to_box
from hydro_bridge.ros.commander import Commander
from hydro_bridge.ros.companion import Companion, CompanionError, executable_path
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, Status
from hydro_bridge.ros.journal import CALLS, Journal
from hydro_bridge.ros.live_page import add_page_option, page_wanted, start_page
from hydro_bridge.ros.messages import (
    StateMessage,
    box_from_message,
    box_to_message,
    reference_from_message,
    reference_to_message,
    seconds,
    state_from_message,
)
from hydro_bridge.ros.namesakes import warn_of_duplicate_nodes
from hydro_bridge.ros.parameters import declare_parameters, refuse_unknown_parameters
from hydro_bridge.ros.publisher_conflict import publisher_conflicts, with_publisher_conflicts
from hydro_bridge.ros.recorder_watch import RecorderWatch
from hydro_bridge.ros.scheduling import request_realtime
from hydro_bridge.ros.spinning import ros_arguments, run_node, spin, start_ros
from hydro_bridge.ros.topics import (
    ARM_SERVICE,
    AUTHORITY,
    AUTHORITY_QOS,
    BOX,
    BOX_QOS,
    CLAIM_SERVICE,
    CLOCK,
    COMMANDS,
    CORRECTION,
    CORRECTION_QOS,
    DIAGNOSTICS,
    DIAGNOSTICS_QOS,
    END_SERVICE,
    GAINS,
    GAINS_QOS,
    GRAPH,
    LOG,
    LOG_QOS,
    OVERRIDE_SERVICE,
    POLICY,
    POLICY_QOS,
    REFERENCE,
    REFERENCE_QOS,
    STATE,
    STATE_QOS,
    TRAINING,
    TRAINING_QOS,
)

__all__ = [
    "ARM_SERVICE",
    "AUTHORITY",
    "AUTHORITY_QOS",
    "BOX",
    "BOX_QOS",
    "CLOCK",
    "CLAIM_SERVICE",
    "COMMANDS",
    "CORRECTION",
    "CORRECTION_QOS",
    "DIAGNOSTICS",
    "DIAGNOSTICS_QOS",
    "END_SERVICE",
    "GAINS",
    "GAINS_QOS",
    "GRAPH",
    "LOG",
    "LOG_QOS",
    "CALLS",
    "Journal",
    "OVERRIDE_SERVICE",
    "POLICY",
    "POLICY_QOS",
    "REFERENCE",
    "REFERENCE_QOS",
    "STATE",
    "STATE_QOS",
    "TRAINING",
    "TRAINING_QOS",
    "Commander",
    "Companion",
    "CompanionError",
    "DiagnosticsPublisher",
    "Level",
    "RecorderWatch",
    "StateMessage",
    "Status",
    "drop_realtime",
    "request_realtime",
    "add_page_option",
    "box_from_message",
    "box_to_message",
    "declare_parameters",
    "executable_path",
    "listen_to_box",
    "reference_from_message",
    "reference_to_message",
    "refuse_unknown_parameters",
    "page_wanted",
    "publisher_conflicts",
    "ros_arguments",
    "run_node",
    "seconds",
    "spin",
    "start_page",
    "start_ros",
    "state_from_message",
    "with_publisher_conflicts",
    "warn_of_duplicate_nodes",
]
