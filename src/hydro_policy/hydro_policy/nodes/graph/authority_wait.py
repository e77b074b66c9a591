# SPDX-License-Identifier: Apache-2.0
"""Wait for the authority over a plant that another node commands, or that does not answer."""

from __future__ import annotations

import math
from collections.abc import Callable

from rclpy.node import Node

from hydro_bridge.ros.commander import Commander
from hydro_bridge.ros.diagnostics import publisher_conflicts
from hydro_bridge.ros.topics import STATE
from hydro_bridge.safety.readiness import NotReadyError

ALONE_WITHIN = 600.0
"""s that a new node waits for the present holder of the plant."""
ANSWER_WITHIN = 30.0
"""s, wait for the plant's answer."""
UNANSWERED = "the plant does not say who may command it (/hydro/claim)"


class AuthorityWait:
    """Reports why a node does not command the plant, each reason once, and gives up after a timeout.

    Parameters
    ----------
    node
        Waiting node.
    commander
        Requests the authority from the plant, and holds its answer.
    warn
        Called with each reason.
    """

    def __init__(self, node: Node, commander: Commander, warn: Callable[[str], None]) -> None:
        self._node, self._commander, self._warn = node, commander, warn
        self._since = math.inf
        self._two_plants, self._crowd, self._refusal = False, "", ""  # seen since the last check; already reported

    def note_two_plants(self) -> None:
        """Record that samples of two plants arrived, which are both ignored."""
        self._two_plants = True

    def look(self, now: float, sampled: bool) -> None:
        """Check who commands the plant, at every tick; `sampled`: whether any sample has arrived.

        Raises
        ------
        NotReadyError
            The wait exceeded its time-out.
        """
        crowd = publisher_conflicts(self._node, STATE) if self._two_plants else ""
        if crowd and not self._crowd:
            self._warn(f"{crowd}; until then no sample is believed")
        self._two_plants, self._crowd = False, crowd
        if self._commander.held or not sampled:
            self._since, self._refusal = math.inf, ""
            return
        self._since = min(self._since, now)
        refusal, within = self._commander.refusal or UNANSWERED, ALONE_WITHIN
        if not self._commander.refusal:
            within = ANSWER_WITHIN
        elif refusal != self._refusal:
            self._warn(f"{refusal}; {self._node.get_name()} waits, {within:g} s at most")
        self._refusal = refusal
        if now - self._since > within:
            raise NotReadyError(f"{refusal}, still after {within:g} s")
