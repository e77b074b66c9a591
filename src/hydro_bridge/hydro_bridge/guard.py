# SPDX-License-Identifier: Apache-2.0
"""What may go to the valve: every command of every plant node is put together here, finite, clamped and fresh.

The guard believes nobody. A value that is not finite is dropped, one out of range is clamped, an old one is replaced
by the safe one (base gains, no correction); each is counted, and each change is told once in a sentence
(`take_events`). Source: failure table of docs/architecture.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf, isfinite

from hydro_bridge.frames import BoxInfo
from hydro_bridge.signals import SAMPLE_PERIOD, Command, CorrectionStatus, ReferenceSignal, Waveform

DECIDED = frozenset(
    {CorrectionStatus.PASS, CorrectionStatus.MODIFIED, CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE}
)
"""Statuses with which the filter did decide. NAN and STALE say that it could not, BYPASSED that it was told not to."""


@dataclass(frozen=True, kw_only=True)
class GuardSettings:
    """Limits and ages. Defaults: the paper's Table training_agent and the failure table of docs/architecture.md."""

    delta_kp_min: float = 0.0
    """1/s, smallest change of the proportional gain, [-200, 0]."""
    delta_kp_max: float = 75.0
    """1/s, largest change of the proportional gain, [0, 500]."""
    delta_ki_min: float = 0.0
    """1/s^2, smallest change of the integral gain, [-50, 0]."""
    delta_ki_max: float = 10.0
    """1/s^2, largest change of the integral gain, [0, 100]."""
    delta_u_max: float = 0.1
    """A, largest magnitude of the correction, [0, 0.2]; twice the valve's current gets from end to end."""
    reference_force_max: float = 1000.0
    """N, largest |offset| + amplitude of the reference, [0, 5000]."""
    reference_frequency_max: float = 20.0
    """Hz, largest frequency of the reference, [0.1, 100]."""
    correction_age_max: float = 0.02
    """s, an older correction is stale, and so is one of an older sample, [0.001, 0.2]."""
    gains_age_max: float = 0.2
    """s, older gains are stale, [0.01, 2]."""
    relies_on: str = "nothing"
    """The filter that gains of this range need to be safe; nothing: the bench bears them all. Told at the start."""
    require_filter: bool = True
    """Without a fresh correction: base gains. False lets gains pass unfiltered: logged, flagged and on /diagnostics."""


@dataclass(kw_only=True)
class GuardCounts:
    """How often the guard had to step in, since it was made."""

    commands: int = 0
    not_finite: int = 0
    clamped: int = 0
    undecided: int = 0
    """Corrections with status NAN, STALE or BYPASSED."""
    outdated: int = 0
    """Corrections of a sample that was too old when they came, or of one that never was."""
    references_refused: int = 0
    stale_correction: int = 0
    """Commands for which the correction was stale."""
    stale_gains: int = 0
    """Commands for which the gains were stale."""


@dataclass(kw_only=True)
class CommandGuard:
    """Collects gains, correction, reference and arming; `command` gives what may be sent now.

    Times are seconds of any one monotonic clock. Nothing here is locked: use it from one thread or under one lock.
    """

    settings: GuardSettings = GuardSettings()
    counts: GuardCounts = field(default_factory=GuardCounts)
    _gains: tuple[float, float] = (0.0, 0.0)
    _gains_at: float = -inf
    _delta_u: float = 0.0
    _corrects: int = 0
    _correction_at: float = -inf
    _newest: int | None = None
    _reference: ReferenceSignal = field(default_factory=ReferenceSignal)
    _arm: bool = False
    _troubles: set[str] = field(default_factory=set)
    _events: list[str] = field(default_factory=list)

    @property
    def armed(self) -> bool:
        """What the last `set_arm` asked for."""
        return self._arm

    @property
    def reference(self) -> ReferenceSignal:
        """The reference that goes down."""
        return self._reference

    def set_arm(self, arm: bool) -> None:
        """Ask for arming or disarming; a lost connection calls this with False."""
        self._arm = bool(arm)

    def set_gains(self, delta_kp: float, delta_ki: float, now: float) -> None:
        """Take new gain changes [1/s], [1/s^2]; not finite: dropped, and the last ones age on."""
        good = isfinite(delta_kp) and isfinite(delta_ki)
        self._tell("gains", not good, "gains are not finite: dropped", "gains are finite again")
        if not good:
            self.counts.not_finite += 1
            return
        limits = self.settings
        self._gains = (
            self._clamp("delta_kp", delta_kp, limits.delta_kp_min, limits.delta_kp_max),
            self._clamp("delta_ki", delta_ki, limits.delta_ki_min, limits.delta_ki_max),
        )
        self._gains_at = now

    def set_correction(self, delta_u: float, status: int, sequence: int, now: float) -> None:
        """Take the filter's correction [A] for sample `sequence`; without a decision in it, the last one ages on."""
        if not isfinite(delta_u):
            self.counts.not_finite += 1
        elif status not in DECIDED:
            self.counts.undecided += 1
        elif self._newest is not None and (self._newest - sequence) & 0xFFFFFFFF > self._samples_back:
            self.counts.outdated += 1
        else:
            limit = self.settings.delta_u_max
            self._delta_u = self._clamp("delta_u", delta_u, -limit, limit)
            self._corrects = sequence & 0xFFFFFFFF
            self._correction_at = now

    def note_sample(self, sequence: int | None) -> None:
        """Say which sample is the newest; None for a new start. Without it corrections age by their arrival alone."""
        self._newest = sequence

    @property
    def _samples_back(self) -> int:
        return round(self.settings.correction_age_max / SAMPLE_PERIOD)

    def set_reference(self, signal: ReferenceSignal) -> bool:
        """Take a new reference; out of range or not finite: refused, the last one stays, and False comes back."""
        reason = _unfit(signal, self.settings)
        if reason:
            self.counts.references_refused += 1
            self._events.append(f"reference refused, the last one stays: {reason}")
            return False
        self._reference = signal
        return True

    def correction_fresh(self, now: float) -> bool:
        """Whether the filter decided within `correction_age_max`."""
        return now - self._correction_at <= self.settings.correction_age_max

    def gains_fresh(self, now: float) -> bool:
        """Whether gains came within `gains_age_max`."""
        return now - self._gains_at <= self.settings.gains_age_max

    def command(self, now: float) -> Command:
        """What may go down at time `now`."""
        filtered, gained = self.correction_fresh(now), self.gains_fresh(now)
        self.counts.commands += 1
        self.counts.stale_correction += not filtered
        self.counts.stale_gains += not gained
        if self._correction_at > -inf:  # before its first correction the filter is merely not up yet
            self._tell("stale correction", not filtered, self._stale_sentence(), "corrections are fresh again")
        if self._gains_at > -inf:
            self._tell("stale gains", not gained, "gains are stale: base gains", "gains are fresh again")
        delta_kp, delta_ki = self._gains if gained and (filtered or not self.settings.require_filter) else (0.0, 0.0)
        return Command(
            arm=self._arm,
            delta_kp=delta_kp,
            delta_ki=delta_ki,
            delta_u=self._delta_u if filtered else 0.0,
            reference=self._reference,
            corrects=self._corrects,
            filter_fresh=filtered,
        )

    def take_events(self) -> list[str]:
        """Sentences for the log since the last call, each once, in the order in which they first came up."""
        events, self._events = list(dict.fromkeys(self._events)), []
        return events

    def _clamp(self, name: str, value: float, low: float, high: float) -> float:
        outside = not low <= value <= high
        self.counts.clamped += outside
        self._tell(name, outside, f"{name} is outside [{low:g}, {high:g}]: clamped", f"{name} is in range again")
        return min(max(value, low), high)

    def _stale_sentence(self) -> str:
        outcome = (
            "base gains, no correction" if self.settings.require_filter else "UNFILTERED gains pass, no correction"
        )
        return f"no correction for {1e3 * self.settings.correction_age_max:g} ms: {outcome}"

    def _tell(self, trouble: str, present: bool, began: str, ended: str) -> None:
        if present != (trouble in self._troubles):
            (self._troubles.add if present else self._troubles.discard)(trouble)
            self._events.append(began if present else ended)


def _unfit(signal: ReferenceSignal, limits: GuardSettings) -> str:
    """Why a reference may not go down; empty if it may."""
    if signal.waveform not in tuple(Waveform):
        return f"unknown waveform {signal.waveform}"
    if not all(map(isfinite, (signal.amplitude, signal.offset, signal.frequency, signal.phase))):
        return "a number in it is not finite"
    if signal.amplitude < 0.0 or signal.amplitude + abs(signal.offset) > limits.reference_force_max:
        return f"amplitude {signal.amplitude:g} N, offset {signal.offset:g} N; limit {limits.reference_force_max:g} N"
    if not 0.0 < signal.frequency <= limits.reference_frequency_max and signal.waveform != Waveform.HOLD:
        return f"frequency {signal.frequency:g} Hz is outside (0, {limits.reference_frequency_max:g}]"
    return ""


def narrowed(wanted: GuardSettings, box: BoxInfo) -> GuardSettings:
    """Limits that neither the settings nor the box exceed."""
    return replace(
        wanted,
        delta_kp_min=max(wanted.delta_kp_min, box.delta_kp_min),
        delta_kp_max=min(wanted.delta_kp_max, box.delta_kp_max),
        delta_ki_min=max(wanted.delta_ki_min, box.delta_ki_min),
        delta_ki_max=min(wanted.delta_ki_max, box.delta_ki_max),
        delta_u_max=min(wanted.delta_u_max, box.delta_u_max),
    )
