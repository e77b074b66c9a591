# SPDX-License-Identifier: Apache-2.0
"""Arming and disarming a plant, with retries; without a person only where that is allowed."""

from __future__ import annotations

import math

from hydro_bridge.signals import ReferenceSignal
from hydro_policy.supervision.outputs import Outputs

SETTLE = 0.1  # s between disarming and arming, a hundred commands of the bridge
RETRY = 1.0  # s

HOW_TO_ARM = "press Enter here, or in another terminal: ros2 run hydro_bridge arm"


class Arming:
    """Arms the plant, and disarms it when it must not stay armed.

    Parameters
    ----------
    outputs
        Where to ask.
    rearm
        Whether it may arm without a person.
    """

    def __init__(self, outputs: Outputs, rearm: bool) -> None:
        self._outputs, self.alone = outputs, rearm
        self._arm_after = math.inf  # when to follow a disarm with an arm, s
        self._asked = self._lowered = -math.inf  # when arming was asked for; when disarming was, s
        self._prompted = ""  # the condition in which a person was asked to arm

    def arm(self, now: float) -> None:
        """Disarm, then arm: that ends a trip, clears the law's integral, and the reference fades in."""
        self._outputs.arm(False)
        self._arm_after, self._asked, self._prompted = now + SETTLE, now, ""

    def under_way(self, now: float) -> bool:
        """Whether arming was asked for from here, and may be what is seen now."""
        return now - self._asked <= RETRY

    def seek(self, ready: bool, now: float) -> None:
        """Call on each tick while the plant is not armed; `ready`: it may be."""
        self._lowered = -math.inf
        if not ready:
            if now - self._asked > RETRY:  # a person's word does not outlive the moment that it was given for
                self._arm_after = math.inf
        elif now >= self._arm_after:
            self._arm_after = math.inf
            self._outputs.arm(True)
        elif self.alone and now - self._asked > RETRY:
            self.arm(now)

    def rest(self) -> None:
        """Call on each tick while it is armed, or away: nothing is sought."""
        self._arm_after, self._asked, self._prompted = math.inf, -math.inf, ""

    def lower(self, now: float, why: str) -> None:
        """Disarm, reference 0 N, and say why; call on each tick as long as it stays armed."""
        if now - self._lowered <= RETRY:
            return
        if self._lowered == -math.inf:
            self._outputs.say(why, warning=True)
        self._lowered = now
        self._outputs.reference(ReferenceSignal())
        self._outputs.arm(False)

    def prompt(self, condition: str, ready: bool, now: float) -> str:
        """What a person must do now, once for each condition of a plant that is not armed; else nothing."""
        if self.alone or not ready or condition == self._prompted or self.under_way(now):
            return ""
        self._prompted = condition
        return HOW_TO_ARM

    def prompt_anew(self) -> None:
        """Ask the person again: what was said came to nothing."""
        self._prompted = ""
