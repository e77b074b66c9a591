# SPDX-License-Identifier: Apache-2.0
"""Arming of a plant for a run: alone where that is allowed, else at a person's request. No ROS."""

from __future__ import annotations

import math
from typing import Protocol

from hydro_core.signals import ReferenceSignal

SETTLE = 0.1  # s between disarming and arming, a hundred commands of the bridge
RETRY = 1.0  # s
REMINDER = 30.0  # s between requests to arm a plant that a person disarmed

HOW_TO_ARM = "press Enter here, or in another terminal: ros2 run hydro_bridge arm"
TOO_EARLY = "the plant was armed before all was ready here: it is disarmed, so that nothing waits armed"


class ArmingOutputs(Protocol):
    """Outputs of `Arming`. No call blocks."""

    def reference(self, signal: ReferenceSignal) -> None:
        """Publish the force to track."""

    def arm(self, arm: bool) -> None:
        """Request the plant to arm or disarm."""

    def say(self, sentence: str, warning: bool = False) -> None:
        """Report a sentence to the user."""


class Arming:
    """Arms the plant, and disarms it when it must not stay armed.

    `outputs`: outputs of the requests. `rearm`: whether arming without a person is allowed.
    """

    def __init__(self, outputs: ArmingOutputs, rearm: bool) -> None:
        self._outputs, self.alone = outputs, rearm
        self._arm_after = math.inf  # time to arm after a disarm, s
        self._asked = self._lowered = -math.inf  # times of the last requests to arm and to disarm, s
        self._not_before = -math.inf  # time of the next request while a person keeps the plant disarmed, s
        self._prompted = ""  # condition in which a person was asked to arm

    def arm(self, now: float) -> None:
        """Disarm, then arm: this ends a trip, clears the law's integral, and fades the reference in."""
        self._outputs.arm(False)
        self._arm_after, self._asked, self._prompted = now + SETTLE, now, ""

    def leave_to_person(self, now: float) -> None:
        """Ask again in `REMINDER` only, since a person disarmed the plant; call when a request was refused for that."""
        if self.alone:
            self._arm_after, self._not_before = math.inf, now + REMINDER

    def under_way(self, now: float) -> bool:
        """Whether this object requested arming, which may explain an armed plant."""
        return now - self._asked <= RETRY

    def seek(self, ready: bool, now: float) -> None:
        """Call on each tick while the plant is not armed; `ready`: it may be."""
        self._lowered = -math.inf
        if not ready:
            if now - self._asked > RETRY:  # a person's request is valid only in the condition it was made in
                self._arm_after = math.inf
        elif now >= self._arm_after:
            self._arm_after = math.inf
            self._outputs.arm(True)
        elif self.alone and now - self._asked > RETRY and now >= self._not_before:
            self.arm(now)

    def rest(self) -> None:
        """Request nothing; call on each tick while the plant is armed or absent."""
        self._arm_after, self._asked, self._not_before, self._prompted = math.inf, -math.inf, -math.inf, ""

    def lower(self, now: float, why: str) -> None:
        """Disarm with reference 0 N and report why; call on each tick as long as it stays armed."""
        if now - self._lowered <= RETRY:
            return
        if self._lowered == -math.inf:
            self._outputs.say(why, warning=True)
        self._lowered = now
        self._outputs.reference(ReferenceSignal())
        self._outputs.arm(False)

    def prompt(self, condition: str, ready: bool, now: float) -> str:
        """Return what a person must do now, once for each condition of a plant that is not armed; else nothing."""
        if self.alone or not ready or condition == self._prompted or self.under_way(now):
            return ""
        self._prompted = condition
        return HOW_TO_ARM

    def prompt_anew(self) -> None:
        """Ask the person again, since the last answer had no effect."""
        self._prompted = ""
