# SPDX-License-Identifier: Apache-2.0
"""Supervision of the plant in all sessions: presence, requirements, arming, recovery; and the sessions' outputs.

no state for 100 ms      lost: disarming is requested, so that a reconnected plant is not armed
requirement missing      the plant is not armed (`hydro_bridge.safety.readiness`); if found armed: disarmed
disarmed or tripped      if allowed: disarm, then arm, once a second until the box reports ARMED; else a person is asked
tripped at once          more than `TRIPS_MAX` times in a row within `RECOVERY_TIME` of arming: the bench is unstable
                         under base gains, and is not armed again
armed and idle           no controller has acted for `IDLE_TIME_MAX`: disarmed, and armed again as above. Base gains
                         wind up the law's integral against dry friction, and the next gains would make the current jump
MISMATCH                 the filter's model is not this bench's: nothing is armed or started until the filter decides
                         again, and a run in progress continues under `FALLBACK_GAIN_CHANGES`
stopped                  a second of recovery, armed, base gains, no reference, before the next run, whose score would
                         otherwise include the stopped run's transient. If that needs no person, the plant is then also
                         disarmed and armed again
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

from hydro_bridge.safety.guard_settings import UNFILTERED_LIMITS
from hydro_bridge.safety.readiness import NotReadyError, Readiness, Requirement
from hydro_core.files.site import RECOMMISSION_HINT
from hydro_core.signals import FAULT_FLAGS, CorrectionStatus, Flag, LawCommand, ReferenceSignal
from hydro_policy.supervision.override import GainOverride


def plant_requirement(ready: Callable[[], bool]) -> Requirement:
    """Return the requirement that samples arrive."""
    return Requirement(
        name="the plant", ready=ready, hint="start a plant, or use --plant sim, emulator or bench", timeout=600.0,
        timeout_message="no samples on /hydro/state for 600 s: start a plant",
    )  # fmt: skip


def corrections_requirement(ready: Callable[[], bool]) -> Requirement:
    """Return the requirement that the filter's corrections reach the plant, which else continues at base gains."""
    return Requirement(
        name="the filter", ready=ready, hint="it loads, or start `ros2 run hydro_filter filter`", timeout=90.0,
        timeout_message="the filter does not answer, and base gains are in force: start `ros2 run hydro_filter filter`",
        essential=False,
    )  # fmt: skip


def learner_requirement(ready: Callable[[], bool]) -> Requirement:
    """Return the requirement that the learner is compiled and has published weights."""
    return Requirement(
        name="the learner", ready=ready, hint="it loads", timeout=300.0, by_wall_clock=True,
        timeout_message="the learner is not ready after 300 s: end other work, and begin again",
    )  # fmt: skip


FALLBACK_GAIN_CHANGES = (UNFILTERED_LIMITS.delta_kp_max, UNFILTERED_LIMITS.delta_ki_max)
"""Gain changes (K_p, K_i) while the filter reports MISMATCH: the upper end of the range that the guard then passes, the
paper's fixed (90, 15). A policy clamped to that range requests less and tracks worse."""

RECOVERY_TIME = 1.0  # s, armed, between a stop and the next run

TRIPS_MAX = 3
"""Trips in a row within `RECOVERY_TIME` of arming that end the trials under a force law; more end the session."""
BASE_GAINS_UNSTABLE_MESSAGE = f"the box's base gains do not hold this bench: it tripped {TRIPS_MAX} times when armed"
IDLE_TIME_MAX = 2.0  # longest time armed without a controller before one starts, s (measurements in decision 0056)
RETRY_INTERVAL = 1.0  # s between arming or disarming requests
REMINDER_INTERVAL = 30.0  # s between requests to arm a plant that a person disarmed
ARM_HINT = "press Enter here, or in another terminal: ros2 run hydro_bridge arm"
EARLY_ARMING_MESSAGE = "the plant was armed before all was ready here: it is disarmed"


class Outputs(Protocol):
    """Outputs of a session to the graph; gains in [1/s] and [1/s^2]. No call blocks."""

    def publish_reference(self, signal: ReferenceSignal) -> None:
        """Publish the reference force."""

    def arm(self, arm: bool) -> None:
        """Request the plant to arm or disarm."""

    def report(self, sentence: str, warning: bool = False) -> None:
        """Report a sentence to the user."""

    def publish_gains(self, delta_kp: float, delta_ki: float, step: int) -> None:
        """Publish the gain changes of policy step number `step`."""

    def publish_law(self, command: LawCommand, step: int) -> None:
        """Publish the force law to run; without such a message a plant runs the paper's law."""

    def publish_step(self, step: int, mean: tuple[float, float], reward: float, weights: int) -> None:
        """Publish a policy step (`PolicyStep.msg`) after its gains. `step`: its number, as given to `publish_gains`.

        `mean`: gain changes of the mean action, [1/s] and [1/s^2]. `reward`: of the previous step; NaN: none.
        `weights`: digest of the policy's weights.
        """


class PlantSupervisor:
    """Supervisor of the plant: tracks the box's flags, checks requirements, requests arming and disarming.

    `outputs`: outputs to the graph. `rearm`: whether a disarmed or tripped box may be armed without a person
    (simulation: yes; bench: only on request). `requirements`: requirements before arming, besides plant and filter.
    `override`: manual override, under which a plant is not idle. `filtered`: whether a responding filter with a
    matching model is required, too.
    """

    def __init__(
        self,
        outputs: Outputs,
        rearm: bool,
        requirements: Sequence[Requirement] = (),
        override: GainOverride | None = None,
        *,
        filtered: bool = True,
    ) -> None:
        self.outputs, self.override = outputs, override or GainOverride()
        self._alone = rearm
        samples = plant_requirement(lambda: not self.lost)
        # corrections of a bypassed filter all count as stale
        answers = corrections_requirement(
            lambda: self.mismatched or not self._flags & Flag.FILTER_STALE
            or (self._status == CorrectionStatus.BYPASSED and self._silent < 1.0)
        )  # fmt: skip
        unfit = f"its model is not this bench's: {RECOMMISSION_HINT}"
        fitting = Requirement(
            name="a filter that fits", ready=lambda: not self.mismatched, hint=unfit, timeout=300.0,
            timeout_message=f"the filter says MISMATCH for 300 s: {unfit}",
        )  # fmt: skip
        needed = (samples, *requirements, *((answers, fitting) if filtered else ()))  # answers: after longer waits
        self.readiness = Readiness(needed, lambda sentence: outputs.report(sentence, warning=True))
        self.trips = 0  # trips in a row within `RECOVERY_TIME` of arming, except those without commands
        self._flags = int(Flag.FILTER_STALE)
        self._seen = -math.inf  # time of the last sample, s; -inf: lost
        self._armed_at = -math.inf
        self._last_action = -math.inf  # time of the last action of a controller, or of arming
        self._block_reason = EARLY_ARMING_MESSAGE  # initially: it has been armed for an unknown time
        self._recovery_until: float | None = None  # math.inf: requested, but not armed yet
        self._arm_after = math.inf  # time to arm after a disarm
        self._asked = self._lowered = -math.inf  # times of the last requests to arm and to disarm
        self._not_before = -math.inf  # time of the next request while a person keeps the plant disarmed
        self._prompted = ""  # condition in which a person was asked to arm
        self._told: str | None = None  # condition last reported
        self._status: int = CorrectionStatus.PASS  # the filter's last one
        self._heard = False  # a correction since the last tick
        self._silent = self._ticked = math.inf  # s without one at the last tick, and its time

    @property
    def lost(self) -> bool:
        """Whether no samples arrive."""
        return self._seen == -math.inf

    @property
    def mismatched(self) -> bool:
        """Whether the filter's last status was MISMATCH: its model does not fit this bench."""
        return self._status == CorrectionStatus.MISMATCH

    @property
    def armed(self) -> bool:
        """Whether samples arrive and the last one was armed."""
        return not self.lost and bool(self._flags & Flag.ARMED)

    @property
    def condition(self) -> str:
        """Condition of the plant as text."""
        if self.lost or self.armed:
            return "no plant" if self.lost else "armed"
        faults = [f"{flag.name}".lower() for flag in (Flag.FORCE_LIMIT, Flag.SENSOR_FAULT) if self._flags & flag]
        state = "tripped" if self._flags & Flag.TRIPPED else "disarmed"
        return f"{state} ({', '.join(faults)})" if faults else state

    @property
    def summary(self) -> str:
        """Condition and missing requirements as text."""
        return self.condition + ("" if self.readiness.complete else f", waiting for {self.readiness.missing_names}")

    def on_sample(self, flags: int, now: float) -> None:
        """Process a sample's flags, received at time `now` [s]."""
        if flags & Flag.ARMED and not (self.armed or self.lost):
            wanted = self.readiness.complete or now - self._asked <= RETRY_INTERVAL
            self._last_action, self._block_reason = now, "" if wanted else EARLY_ARMING_MESSAGE
            self._armed_at = now
        if self.armed and flags & Flag.ARMED and now - self._armed_at >= RECOVERY_TIME:
            self.trips = 0
        if self.armed and flags & Flag.TRIPPED and flags & FAULT_FLAGS and not self.override.active:
            self.trips += 1
        self._seen, self._flags = now, flags
        if self._recovery_until is not None:
            self._recovery_until = min(self._recovery_until, now + RECOVERY_TIME) if flags & Flag.ARMED else math.inf
            if now >= self._recovery_until:
                self._recovery_until = None
                if self._alone:
                    self._block_reason = "calm again: it is disarmed and armed again"

    def on_correction(self, status: int) -> None:
        """Process the status of the filter's correction; reports a change of MISMATCH."""
        before, self._status, self._heard = self._status, status, True
        if self.mismatched != (before == CorrectionStatus.MISMATCH):
            told = "the filter's model fits again: going on"
            if self.mismatched:
                told = f"the filter's model is not this bench's, and nothing begins: {RECOMMISSION_HINT}"
            elif status == CorrectionStatus.BYPASSED:
                told = "the filter is bypassed, and whether its model fits is not known: going on"
            self.outputs.report(told, warning=self.mismatched)

    def may_start(self, now: float) -> bool:
        """Return whether a trial may start: armed, all requirements met, no recovery, no blocking reason."""
        return self.armed and self.readiness.complete and not self.recovering and not self.blocking_reason(now)

    def note_action(self, now: float) -> None:
        """Note that a controller has chosen gains at time `now` [s]."""
        self._last_action = now

    def blocking_reason(self, now: float) -> str:
        """Return the reason why no controller may act on the armed plant; empty if one may."""
        if not self._block_reason and now - self._last_action > IDLE_TIME_MAX:
            return f"armed for {now - self._last_action:.1f} s while no controller acted: it is disarmed"
        return self._block_reason

    def block_runs(self, why: str) -> None:
        """Block runs until the plant has been disarmed and armed again; `why` is reported."""
        self._block_reason = self._block_reason or why

    @property
    def recovering(self) -> bool:
        """Whether the recovery after a stop is in progress, under base gains."""
        return self._recovery_until is not None

    def start_recovery(self) -> None:
        """Start the recovery after a stop: `RECOVERY_TIME` s armed without a reference before the next run."""
        self._recovery_until = math.inf
        self.outputs.publish_reference(ReferenceSignal())

    def continue_from(self, before: PlantSupervisor) -> None:
        """Continue from a previous session's supervisor of this plant: idle time, blocking reason and recovery."""
        self._last_action, self._block_reason = before._last_action, before._block_reason
        if before.recovering:
            self.start_recovery()

    def on_tick(self, now: float) -> None:
        """Detect a loss of the plant and request arming; call some twenty times a second.

        Raises NotReadyError: a requirement for arming was not met in time, or the bench is unstable under base gains.
        """
        if self.trips > TRIPS_MAX:
            raise NotReadyError(BASE_GAINS_UNSTABLE_MESSAGE)
        self._silent = 0.0 if self._heard else self._silent + max(now - self._ticked, 0.0)
        self._heard, self._ticked = False, now
        if not self.lost and now - self._seen > 0.1:
            self._seen, self._block_reason = -math.inf, "no samples came while it was armed: it is disarmed"
            self._flags = int(Flag.FILTER_STALE)
            self.outputs.arm(False)
        self.readiness.check(now)
        if self.armed or self.lost:
            self._arm_after, self._asked, self._not_before, self._prompted = math.inf, -math.inf, -math.inf, ""
            why = self.blocking_reason(now) if self.armed and not (self.recovering or self.override.active) else ""
            if why and now - self._lowered > RETRY_INTERVAL:
                if self._lowered == -math.inf:
                    self.outputs.report(why, warning=True)
                self._lowered = now
                self.outputs.publish_reference(ReferenceSignal())
                self.outputs.arm(False)
        else:
            self._lowered = -math.inf
            if not self.readiness.complete:
                # a person's request is valid only in the condition it was made in
                if now - self._asked > RETRY_INTERVAL:
                    self._arm_after = math.inf
            elif now >= self._arm_after:
                self._arm_after = math.inf
                self.outputs.arm(True)
            elif self._alone and now - self._asked > RETRY_INTERVAL and now >= self._not_before:
                self._arm_anew(now)
        condition, hint = self.condition, ""
        may_ask = self.readiness.complete and now - self._asked > RETRY_INTERVAL
        waits = not (self.armed or self.lost or self._alone) and may_ask
        if waits and condition != self._prompted:  # once in each condition
            self._prompted, hint = condition, f": {ARM_HINT}"
        if hint or self._told not in (None, condition):
            self.outputs.report(f"plant: {condition}{hint}", warning=not self.armed)
        self._told = condition

    def _arm_anew(self, now: float) -> None:
        """Disarm, then arm: this resets a trip, clears the law's integral, and fades the reference in."""
        self.outputs.arm(False)
        self._arm_after, self._asked, self._prompted = now + 0.1, now, ""  # a hundred commands of the bridge later

    def defer_to_person(self, now: float) -> None:
        """Postpone the next arming request by `REMINDER_INTERVAL`: the plant refused it, since a person disarmed it."""
        if self._alone:
            self._arm_after, self._not_before = math.inf, now + REMINDER_INTERVAL

    def arm_now(self, now: float) -> None:
        """Arm at a person's request if all is ready; otherwise report what is missing."""
        if self.armed and not self.blocking_reason(now):
            self.outputs.report("the plant is already armed", warning=True)
        elif self.readiness.complete:
            self._arm_anew(now)
        else:
            self._prompted = ""
            self.outputs.report(f"not armed, still waiting for {self.readiness.missing_names}", warning=True)
