# SPDX-License-Identifier: Apache-2.0
"""Command guard: assembles every command to a box, finite, clamped and fresh.

The guard trusts no sender. A non-finite value is dropped, one out of range is clamped, a stale one is replaced by the
safe value (base gains, no correction); each case is counted, and each change is reported once in a sentence
(`take_events`). If the filter reports that its model is not this bench's (MISMATCH), no correction passes, and only
gains within `UNFILTERED_LIMITS`. If gains cease to arrive the plant is given up: reference 0 N, disarmed. Source:
failure table of failures.md.

The compensated law has limits and a safe record of its own (`BoxLaw`): its gains pass without a filter, and the
corrections of a filter for this law pass as well. The law is changed only while the plant is disarmed.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from math import inf, isfinite

import numpy as np

from hydro_bridge.safety.guard_settings import UNFILTERED_LIMITS, GuardSettings, intersect_limits, reference_error
from hydro_bridge.safety.lease import Lease
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import SAMPLE_PERIOD, Command, CorrectionStatus, Law, LawCommand, ReferenceSignal, Waveform

__all__ = ["DECISION_STATUSES", "CommandGuard", "GuardCounts", "GuardSettings", "intersect_limits"]

DECISION_STATUSES = frozenset(
    {CorrectionStatus.PASS, CorrectionStatus.MODIFIED, CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE}
)
"""Statuses with a decision of the filter. NAN and STALE: it could not decide; BYPASSED: it is switched off or not made
for the running law; MISMATCH: its model or metric is not this bench's."""

_SAMPLES_KEPT = 256
"""Number of samples whose nominal current is kept: more than `correction_age_max` can span."""

LAW_NOT_OFFERED_MESSAGE = "the compensated law is refused: this box does not offer it (protocol.md)"


def safe_command(law: BoxLaw) -> LawCommand:
    """Return the safe command of a compensated law: neutral coefficients, and the law's safe C_1 and C_2."""
    c_1, c_2 = law.velocity_compensation, law.valve_gain_scale
    return LawCommand(law=Law.COMPENSATED, velocity_compensation=c_1, valve_gain_scale=c_2)


@dataclass(kw_only=True)
class GuardCounts:
    """Counts of the guard's interventions."""

    commands: int = 0
    not_finite: int = 0
    clamped: int = 0
    undecided: int = 0
    """Corrections with status NAN, STALE or BYPASSED."""
    outdated: int = 0
    """Corrections of a sample that was too old when they arrived, or that never existed."""
    repeated: int = 0
    """Corrections of a sample that was already answered, or of an earlier one."""
    mismatched: int = 0
    """Corrections with status MISMATCH: the filter's model is not this bench's."""
    narrowed: int = 0
    """Commands whose gains were narrowed because of a MISMATCH."""
    references_refused: int = 0
    stale_correction: int = 0
    """Commands for which the correction was stale."""
    stale_gains: int = 0
    """Commands for which the gains were stale."""
    laws_refused: int = 0
    """Commands of a force law that the box does not offer, or for another law while armed."""
    stale_law: int = 0
    """Commands for which gains, coefficients and scales of the compensated law were stale."""
    given_up: int = 0
    """Disarmings by the guard, see `CommandGuard.abort`."""


@dataclass(kw_only=True)
class CommandGuard:
    """Combines gains, correction, reference and arming into the command that may be sent now (`command`).

    Times are seconds of any one monotonic clock. Not thread-safe: use it from one thread or under one lock.
    """

    settings: GuardSettings = field(default_factory=GuardSettings)
    counts: GuardCounts = field(default_factory=GuardCounts)
    valve_current_max: float = inf
    """Valve current limit of the box [A]: no correction takes the nominal current beyond it, as certificates assume."""
    lease: Lease = field(default_factory=Lease)
    """Lease on the plant, whose node passes on the commands of the holder only."""
    box_law: BoxLaw | None = None
    """Compensated law of the box; None: it offers the paper's law only."""
    armed: bool = field(default=False, init=False)
    """Whether the last `set_arm` requested arming."""
    abort_reason: str = field(default="", init=False)
    """Reason why the guard last disarmed the plant; empty once it is armed again."""
    _law: LawCommand = field(default_factory=LawCommand)
    _law_at: float = -inf
    _gains: tuple[float, float] = (0.0, 0.0)
    _gains_at: float = -inf
    _delta_u: float = 0.0
    _corrected_sequence: int = 0
    _correction_at: float = -inf
    _mismatched: bool = False
    """Whether the filter's last status was MISMATCH; only a decision clears it."""
    _newest: int | None = None
    _answered_last: int | None = None
    """Sample that was corrected last, if samples are announced (`add_sample`)."""
    _nominal: dict[int, tuple[int, float]] = field(default_factory=dict)
    """The last samples and their nominal currents [A], by sequence modulo `_SAMPLES_KEPT`."""
    _reference: ReferenceSignal = field(default_factory=ReferenceSignal)
    _gained: bool = False
    """Whether gains arrived since the arming: from then on they are expected to continue."""
    _troubles: set[str] = field(default_factory=set)
    _events: dict[str, bool] = field(default_factory=dict)

    def set_arm(self, arm: bool) -> None:
        """Request arming or disarming; a lost connection calls this with False."""
        if arm and not self.armed:
            self._gained, self.abort_reason = False, ""
        self.armed = bool(arm)

    def abort(self, reason: str) -> None:
        """Disarm, with base gains and a reference of 0 N, until the next arming; `reason` is reported."""
        self.armed, self._gains, self._reference = False, (0.0, 0.0), ReferenceSignal()
        self.abort_reason = f"{reason}; reference 0 N, disarmed until it is armed again"
        self.counts.given_up += 1
        self._events[self.abort_reason] = True

    def set_gains(self, delta_kp: float, delta_ki: float, now: float) -> None:
        """Set gain changes [1/s], [1/s^2], clamped; non-finite ones are dropped, and the last ones keep ageing."""
        good = isfinite(delta_kp) and isfinite(delta_ki)
        self._tell("gains", not good, "gains are not finite: dropped, the ones before hold", "gains are finite again")
        if not good:
            self.counts.not_finite += 1
            return
        limits = self.box_law if self.compensated and self.box_law else self.settings
        self._gains = (
            self._clamp("delta_kp", delta_kp, limits.delta_kp_min, limits.delta_kp_max),
            self._clamp("delta_ki", delta_ki, limits.delta_ki_min, limits.delta_ki_max),
        )
        self._gains_at, self._gained = now, True

    @property
    def compensated(self) -> bool:
        """Whether the compensated law is in force."""
        return self._law.law is Law.COMPENSATED

    def set_law(self, wanted: LawCommand, now: float) -> None:
        """Set the force law, its coefficients and scales; non-finite ones are dropped, and the last ones keep ageing.

        A law that the box does not offer is refused, and another law than the present one while the plant is armed.
        """
        changes = wanted.law is not self._law.law
        missing = wanted.law is Law.COMPENSATED and self.box_law is None
        self._tell("law offered", missing, LAW_NOT_OFFERED_MESSAGE, "the force law is one that the box offers again")
        refused = "another force law is refused while the plant is armed: disarm it first"
        self._tell("law armed", changes and self.armed, refused, "the present force law is commanded again")
        if missing or (changes and self.armed):
            self.counts.laws_refused += 1
            return
        good = all(map(isfinite, wanted.shaping))
        self._tell("law", not good, "coefficients are not finite: dropped, the last hold", "coefficients are finite")
        if not good:
            self.counts.not_finite += 1
            return
        if changes:
            self._gains, self._gains_at = (0.0, 0.0), -inf  # they were added to another law's base gains
            unfiltered = "the compensated law: its gains pass within its own limits, whether or not the filter decides"
            self._events[unfiltered if wanted.law is Law.COMPENSATED else "the paper's law again"] = False
        if self.box_law is None or wanted.law is Law.PAPER:
            self._law = LawCommand()
        else:
            low, _, high, _ = self.box_law.shaping_limits
            names = ("a_0", "a_1", "a_2", "a_3", "a_4", "velocity_compensation", "valve_gain_scale")
            a_0, a_1, a_2, a_3, a_4, c_1, c_2 = map(self._clamp, names, wanted.shaping, low, high)
            self._law = LawCommand(
                law=wanted.law,
                coefficients=(a_0, a_1, a_2, a_3, a_4),
                velocity_compensation=c_1,
                valve_gain_scale=c_2,
            )
        self._law_at = now

    def set_box_law(self, law: BoxLaw | None) -> None:
        """Set the box's compensated law, None if it has none, and return to the paper's law.

        The law is accepted if all its values are finite, its limits ordered, and its safe values within them.
        """
        sound = True
        if law is not None:
            low, safe, high, _ = law.shaping_limits
            ordered = all(least <= number <= most for least, number, most in zip(low, safe, high, strict=True))
            gains = law.delta_kp_min <= 0.0 <= law.delta_kp_max and law.delta_ki_min <= 0.0 <= law.delta_ki_max
            sound = bool(np.isfinite(np.hstack(astuple(law))).all()) and ordered and gains
        unsound = "the box tells limits of its compensated law that are no limits: that law is not used"
        self._tell("law record", not sound, unsound, "the box's record of its compensated law is sound")
        self.box_law = law if sound else None
        self.release_law()

    def release_law(self) -> None:
        """Return to the paper's law, the initial law of every holder and every box; takes effect once disarmed."""
        self._law, self._law_at, self._gains, self._gains_at = LawCommand(), -inf, (0.0, 0.0), -inf

    def set_correction(self, delta_u: float, status: int, sequence: int, now: float) -> None:
        """Set the filter's correction [A] for sample `sequence`; without a decision, the last one keeps ageing."""
        if status == CorrectionStatus.MISMATCH:  # no correction; the answers only keep the narrowed gains in force
            self.counts.mismatched += 1
            self._mismatched, self._delta_u = True, 0.0
            if self._fits(sequence):
                self._corrected_sequence, self._correction_at = sequence & 0xFFFFFFFF, now
        elif not isfinite(delta_u):
            self.counts.not_finite += 1
        elif status not in DECISION_STATUSES:
            self.counts.undecided += 1
        elif self._fits(sequence):
            high = self.settings.delta_u_max
            low, valve = -high, self.valve_current_max
            known, nominal = self._nominal.get(sequence % _SAMPLES_KEPT, (None, 0.0))
            if known in (None, sequence) and abs(nominal) <= valve:  # if saturated, part only returns to the limit
                low, high = max(low, -valve - nominal), min(high, valve - nominal)
            self._delta_u = self._clamp("delta_u", delta_u, low, high)
            self._corrected_sequence = sequence & 0xFFFFFFFF
            self._correction_at, self._mismatched = now, False

    def _fits(self, sequence: int) -> bool:
        """Return whether a correction is of a recent sample that is not answered yet; counts others."""
        if self._newest is None:
            return True
        if (self._newest - sequence) & 0xFFFFFFFF > round(self.settings.correction_age_max / SAMPLE_PERIOD):
            self.counts.outdated += 1
            return False
        if self._answered_last is not None and not 0 < (sequence - self._answered_last) & 0xFFFFFFFF < 1 << 31:
            self.counts.repeated += 1
            return False
        self._answered_last = sequence & 0xFFFFFFFF
        return True

    def add_sample(self, sequence: int | None, nominal: float = 0.0) -> None:
        """Add the newest sample and its nominal current [A]; None: the box was restarted or the line was lost.

        Without these calls corrections age by their arrival time only.
        """
        self._newest = sequence
        if sequence is None:
            self._answered_last, self._correction_at = None, -inf
            self._nominal.clear()
        else:
            self._nominal[sequence % _SAMPLES_KEPT] = (sequence, nominal)

    def set_reference(self, signal: ReferenceSignal) -> bool:
        """Set a new reference; one out of range or not finite is refused: returns False, and the last one stays."""
        reason = reference_error(signal, self.settings)
        if reason:
            self.counts.references_refused += 1
            self._events[f"reference refused, the last one stays: {reason}"] = True
            return False
        # A HOLD has no frequency: use one that every box accepts.
        hold = signal.waveform == Waveform.HOLD
        self._reference = replace(signal, frequency=ReferenceSignal().frequency) if hold else signal
        return True

    def correction_fresh(self, now: float) -> bool:
        """Return whether the filter decided within `correction_age_max`, and its model is this bench's.

        Under the compensated law, which needs no filter: whether that law was commanded within `gains_age_max`. False
        is shown as FILTER_STALE.
        """
        if self.compensated:
            return now - self._law_at <= self.settings.gains_age_max
        return self._answered(now) and not self._mismatched

    def _answered(self, now: float) -> bool:
        return now - self._correction_at <= self.settings.correction_age_max

    def command(self, now: float) -> Command:
        """Return the command that may be sent at time `now`."""
        if self.armed and self._gained and now - self._gains_at > self.settings.gains_timeout:
            self.abort(f"no gains for {self.settings.gains_timeout:g} s, whoever chose them is gone")
        gained = now - self._gains_at <= self.settings.gains_age_max
        # A correction is decided for one sample; held for longer, it would act as an impulse.
        held = min(self.settings.correction_hold, self.settings.correction_age_max)
        behind = 0 if self._newest is None else (self._newest - self._corrected_sequence) & 0xFFFFFFFF
        acts = now - self._correction_at <= held and behind < round(held / SAMPLE_PERIOD)
        self.counts.commands += 1
        self.counts.stale_gains += not gained
        law, (delta_kp, delta_ki) = (
            self._compensated_law(now, gained) if self.compensated else self._paper_law(now, gained)
        )
        return Command(
            arm=self.armed,
            delta_kp=delta_kp,
            delta_ki=delta_ki,
            delta_u=self._delta_u if acts else 0.0,
            reference=self._reference,
            corrected_sequence=self._corrected_sequence,
            filter_fresh=self.correction_fresh(now),
            **vars(law),
        )

    def _paper_law(self, now: float, gained: bool) -> tuple[LawCommand, tuple[float, float]]:
        """Return the paper's law and the gains that pass: with a fresh correction, or where none is required."""
        answered = self._answered(now)
        self.counts.stale_correction += not answered
        if answered or (self.armed and self._correction_at > -inf):  # before its first one the filter does not run yet
            outcome = "base gains" if self.settings.require_filter else "UNFILTERED gains pass"
            stale = (
                f"no correction for {1e3 * self.settings.correction_age_max:g} ms: {outcome}, no correction; "
                "does the filter run, is the machine overloaded?"
            )
            self._tell("stale correction", not answered, stale, "corrections are fresh again")
        if self.armed and self._gained:
            missed = f"no gains for {1e3 * self.settings.gains_age_max:g} ms: base gains are in force"
            self._tell("stale gains", not gained, missed, "gains are fresh again")
        mismatch = "the filter says that its model is not this bench's: no correction, gains within the narrow range"
        self._tell("mismatch", self._mismatched, mismatch, "the filter's model fits again: gains as wide as before")
        passed = self._gains if gained and (answered or not self.settings.require_filter) else (0.0, 0.0)
        gains, narrow = passed, UNFILTERED_LIMITS
        if self._mismatched:
            gains = (
                min(max(passed[0], narrow.delta_kp_min), narrow.delta_kp_max),
                min(max(passed[1], narrow.delta_ki_min), narrow.delta_ki_max),
            )
        self.counts.narrowed += gains != passed
        return self._law, gains

    def _compensated_law(self, now: float, gained: bool) -> tuple[LawCommand, tuple[float, float]]:
        """Return the compensated law and its gains: with coefficients and scales they are fresh or safe together."""
        fresh = gained and self.correction_fresh(now)
        self.counts.stale_law += not fresh
        stale = self.armed and self._gained and not fresh
        unheard = "the compensated law is not commanded: its safe record, base gains and neutral coefficients"
        self._tell("stale law", stale, unheard, "the compensated law is commanded")
        mismatch = "the filter said that its model is not this bench's: base gains of the compensated law"
        self._tell("mismatch", self._mismatched, mismatch, "the filter's model fits again")
        gains = (0.0, 0.0) if self._mismatched else self._gains
        self.counts.narrowed += gains != self._gains
        return (self._law, gains) if fresh else (safe_command(self.box_law or BoxLaw()), (0.0, 0.0))

    def take_events(self) -> dict[str, bool]:
        """Return and clear the pending log messages, in order; True: a warning, False: its end, or a notice."""
        events, self._events = self._events, {}
        return events

    def _clamp(self, name: str, value: float, low: float, high: float) -> float:
        outside = not low <= value <= high
        self.counts.clamped += outside
        self._tell(name, outside, f"{name} is outside [{low:g}, {high:g}]: clamped", f"{name} is in range again")
        return min(max(value, low), high)

    def _tell(self, trouble: str, present: bool, began: str, ended: str) -> None:
        if present != (trouble in self._troubles):
            (self._troubles.add if present else self._troubles.discard)(trouble)
            self._events[began if present else ended] = present
