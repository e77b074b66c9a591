# SPDX-License-Identifier: Apache-2.0
"""Whether the plant is there and armed, and the asking for both: shared by training and evaluation.

no state for 100 ms      lost: disarm is asked for, so that the cable's return finds nothing armed
disarmed or tripped      if allowed: disarm, then arm, once a second until the box says ARMED; else the user is told how
no corrections           armed only when they come: base gains would wind up an integral against standing friction
MISMATCH                 the filter's model is not this bench's: nothing begins until the filter decides again, and
                         what has begun goes on under `FALLBACK`
stopped                  a second of calm, armed, base gains, no reference, before anything begins: the force is still
                         where what was stopped has left it, and would be held against whatever comes next
"""

from __future__ import annotations

import math

from hydro_bridge.guard_limits import NARROW
from hydro_bridge.signals import CorrectionStatus, Flag, ReferenceSignal
from hydro_policy.outputs import Outputs

FALLBACK = (NARROW.delta_kp_max, NARROW.delta_ki_max)
"""Changes of K_p, K_i that are held while the filter says MISMATCH: the upper end of what the guard then lets pass, the
paper's fixed (90, 15). A policy clamped to that range asks for less and tracks worse."""

CALM = 1.0
"""s, armed, between a stop and what follows it."""

LOST_AFTER = 0.1  # s without a sample
_SETTLE = 0.1  # s between disarming and arming, a hundred commands of the bridge
_RETRY = 1.0  # s

HINT_AFTER = 8.0
"""s without a sample, to say how to get a plant."""
_FILTER_HINT, _FILTER_WITHIN = 8.0, 90.0  # s without corrections: to say so; to go on (its first start compiles)

HOW_TO_GET_A_PLANT = "no samples on /hydro/state yet: start a plant, or use --plant sim, emulator or bench"
AWAITING_FILTER = "waiting for the filter to answer: where it starts for the first time it compiles, up to a minute"
NO_FILTER = "the filter does not answer: base gains are in force unless the plant's guard does not require it"
MISMATCH = (
    "the filter says that its model is not this bench's (its log names what does not fit): fixed gains of the narrow "
    "range, nothing is learned or begun; start it with model and metric of this bench, or with --metric constant"
)
FITS = "the filter's model fits again: going on"
HOW_TO_ARM = "press Enter here, or in another terminal: ros2 run hydro_bridge arm"


class PlantWatch:
    """Follows the box's flags and asks for arming.

    Parameters
    ----------
    outputs
        Where to ask.
    rearm
        Whether a disarmed or tripped box may be armed without the user (simulation: yes; bench: on purpose only).
    """

    def __init__(self, outputs: Outputs, rearm: bool) -> None:
        self._outputs, self._rearm = outputs, rearm
        self._seen = -math.inf
        self._flags = 0
        self._arm_after = math.inf  # when to follow a disarm with an arm
        self._asked = -math.inf
        self._told: str | None = None
        self._hint_at = math.inf  # when to say that nobody publishes
        self._stale_since = math.inf  # since when no corrections reach the box
        self._calm_until: float | None = None  # math.inf: asked for, but not armed yet
        self._hints: set[str] = set()  # given already, each once
        self.mismatched = False
        """Whether the filter's last word was that its model is not this bench's."""

    @property
    def lost(self) -> bool:
        """Whether no samples come."""
        return self._seen == -math.inf

    @property
    def armed(self) -> bool:
        """Whether samples come and the last one was armed."""
        return not self.lost and bool(self._flags & Flag.ARMED)

    @property
    def condition(self) -> str:
        """For people."""
        if self.lost:
            return "no plant"
        if self._flags & Flag.ARMED:
            return "armed"
        faults = [flag.name or "" for flag in (Flag.FORCE_LIMIT, Flag.SENSOR_FAULT) if self._flags & flag]
        return ("tripped" if self._flags & Flag.TRIPPED else "disarmed") + (
            f" ({', '.join(faults).lower()})" if faults else ""
        )

    def on_sample(self, flags: int, now: float) -> None:
        """Take a sample's flags."""
        self._seen, self._flags = now, flags
        self._stale_since = min(self._stale_since, now) if flags & Flag.FILTER_STALE else math.inf
        if self._calm_until is not None:
            self._calm_until = min(self._calm_until, now + CALM) if flags & Flag.ARMED else math.inf
            if now >= self._calm_until:
                self._calm_until = None

    def on_correction(self, status: int) -> None:
        """Take the status of a correction."""
        if (status == CorrectionStatus.MISMATCH) != self.mismatched:
            self.mismatched = not self.mismatched
            self._outputs.say(MISMATCH if self.mismatched else FITS, warning=self.mismatched)

    def may_begin(self, now: float) -> bool:
        """Whether an episode or a run may begin: armed and calm, and the filter answers or has been waited for."""
        return self.armed and not self.calming and not self._awaits_filter(now)

    @property
    def calming(self) -> bool:
        """Whether something was stopped and its force is still being brought back: base gains, please."""
        return self._calm_until is not None

    def calm(self) -> None:
        """Something was stopped: `CALM` seconds, armed, before anything begins. No reference from now on."""
        self._calm_until = math.inf
        self._outputs.reference(ReferenceSignal())

    def on_tick(self, now: float) -> None:
        """Call some twenty times a second: notices a loss, asks for arming."""
        if not self.lost and now - self._seen > LOST_AFTER:
            self._seen = -math.inf
            self._outputs.arm(False)
        if not self.lost and not self.armed:
            self._seek_arming(now)
        if self.armed:
            self._arm_after, self._asked = math.inf, -math.inf
        self._tell(now)

    def arm_now(self, now: float) -> None:
        """The user wants it armed."""
        self._outputs.arm(False)
        self._arm_after, self._asked = now + _SETTLE, now

    def _seek_arming(self, now: float) -> None:
        if self._awaits_filter(now):
            return
        if now >= self._arm_after:
            self._arm_after = math.inf
            self._outputs.arm(True)
        elif self._rearm and now - self._asked > _RETRY:
            self.arm_now(now)

    def _awaits_filter(self, now: float) -> bool:
        if self.mismatched:
            return True
        waited = now - self._stale_since if self._flags & Flag.FILTER_STALE else -math.inf
        for after, sentence in ((_FILTER_HINT, AWAITING_FILTER), (_FILTER_WITHIN, NO_FILTER)):
            if waited > after and sentence not in self._hints:
                self._hints.add(sentence)
                self._outputs.say(sentence, warning=True)
        return 0 <= waited <= _FILTER_WITHIN

    def _tell(self, now: float) -> None:
        if self._hint_at == math.inf and self._told is None:
            self._hint_at = now + HINT_AFTER
        if self.lost and now > self._hint_at:
            self._hint_at = math.inf
            self._outputs.say(HOW_TO_GET_A_PLANT, warning=True)
        condition = self.condition
        if condition != self._told:
            hint = f": {HOW_TO_ARM}" if not self._rearm and not self.armed and not self.lost else ""
            if self._told is not None or hint:
                self._outputs.say(f"plant: {condition}{hint}", warning=not self.armed)
            self._told = condition
