# SPDX-License-Identifier: Apache-2.0
"""Supervision of a recorder: whether it receives samples, from its status on /diagnostics."""

from __future__ import annotations

import time
from math import inf
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from hydro_bridge.ros.companion import Companion
from hydro_bridge.ros.topics import DIAGNOSTICS, DIAGNOSTICS_QOS, STATE
from hydro_bridge.safety.readiness import NotReadyError, Requirement

WITHIN = 60.0
"""s, wait for a recorder once samples arrive: on a busy machine discovery takes some time."""


class RecorderWatch:
    """Watches one recorder.

    Parameters
    ----------
    node
        Node that subscribes to /diagnostics.
    folder
        Folder of the recording, as passed to the recorder.
    recorder
        Its process.
    """

    def __init__(self, node: Node, folder: Path, recorder: Companion) -> None:
        self.since = inf
        """Time of its first report of samples, s of the monotonic clock."""
        self._folder, self._recorder = str(folder), recorder
        node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, DIAGNOSTICS_QOS)

    @property
    def requirement(self) -> Requirement:
        """Requirement that it records before anything moves. A later end is reported, and does not stop the run."""
        return Requirement(
            name="the recorder",
            ready=self._ready,
            hint="it says once a second how many samples it has",
            within=WITHIN,
            missing=f"the recorder had no sample after {WITHIN:g} s: nothing is armed unrecorded",
        )

    def _ready(self) -> bool:
        if self.since == inf and not self._recorder.running:
            raise NotReadyError("the recorder ended before it had a sample: nothing is armed unrecorded")
        return self.since < inf

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {entry.key: entry.value for entry in status.values}
            if values.get("folder") == self._folder and values.get(STATE, "0") != "0":
                self.since = min(self.since, time.monotonic())
