# SPDX-License-Identifier: Apache-2.0
"""Waiting for authority over a plant that another node commands, or that does not answer."""

from __future__ import annotations

import math
from collections.abc import Callable

from rclpy.node import Node

from hydro_bridge.ros import STATE, Commander, publisher_conflicts
from hydro_bridge.safety.readiness import NotReadyError

ALONE_WITHIN = 600.0
"""s that a newcomer waits for who commands the plant."""
ANSWER_WITHIN = 30.0
"""s, of the plant."""
UNANSWERED = "the plant does not say who may command it (/hydro/claim)"


class AuthorityWait:
    """Reports why a node does not command the plant, each reason once, and gives up after a timeout.

    Parameters
    ----------
    node
        Who waits.
    commander
        Asks the plant for the authority, and knows its answer.
    warn
        Called with each reason.
    """

    def __init__(self, node: Node, commander: Commander, warn: Callable[[str], None]) -> None:
        self._node, self._commander, self._warn = node, commander, warn
        self._since = math.inf
        self._two_plants, self._crowd, self._refusal = False, "", ""  # seen since the last look; what was told of it

    def note_two_plants(self) -> None:
        """Samples of two plants came, of which none is believed."""
        self._two_plants = True

    def look(self, now: float, sampled: bool) -> None:
        """See who commands the plant; `sampled`: whether a sample has ever come. For every tick.

        Raises
        ------
        NotReadyError
            It was waited for too long.
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
