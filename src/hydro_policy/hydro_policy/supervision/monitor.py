# SPDX-License-Identifier: Apache-2.0
"""Safety monitor: watches the bench under a policy and requests a stop before the box trips.

peak error    |e|, averaged over a policy step, so that a single bad sample does not count
chatter       RMS of u' in the median step of a window: it wears valve and hoses, and is the first sign of a limit
              cycle. A single jump of the gains where the reference changes is no chatter, however large (decision 0072)
violations    share of a window's samples whose certificate fails under the filter's correction
NaN           a sample holds a value that is not finite

Only policies are assessed: overridden steps are not passed to the monitor, and steps under other gains than the
policy's (`Step.hold_flags`: late commands, no fresh correction, MISMATCH) are excluded.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hydro_core.settings import quantity
from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, CorrectionStatus
from hydro_policy.task.mdp import Step
from hydro_sim.model.bench import NOMINAL

_EVALUATED_STATUSES = frozenset(
    set(CorrectionStatus) - {CorrectionStatus.NAN, CorrectionStatus.STALE, CorrectionStatus.MISMATCH}
)
_VIOLATION_TOLERANCE = 1e-6  # 1/s, of M_c
_RECOVERY_STEPS = 20
"""Steps after one under base gains whose u' is not due to the policy: the force recovers from the larger error."""
_STEP_PERIOD = SAMPLES_PER_STEP * SAMPLE_PERIOD  # s


@dataclass(frozen=True, kw_only=True)
class MonitorSettings:
    """Limits of the safety monitor; the defaults lie between the values of good and of bad runs (training.md)."""

    peak_error: Annotated[float, quantity("N", 1e-3, 1e7, "|e| in the mean over a policy step")] = NOMINAL.force
    chatter: Annotated[
        float, quantity("A/s", 1e-3, 1e3, "RMS of u' in the window's median step: 14 times the valve's limit a second")
    ] = NOMINAL.current * 1.4 * 10.0
    chatter_window: Annotated[float, quantity("s", 0.02, 10.0, "Length of the window that chatter is taken over")] = 0.1
    violations: Annotated[
        float, quantity("-", 0.0, 1.0, "Share of samples with M_c > 0 in spite of correction; 1 never stops")
    ] = 0.5
    violations_window: Annotated[float, quantity("s", 0.02, 10.0, "Window that violations are counted in")] = 0.5
    rollbacks_max: Annotated[int, quantity("-", 0, 1000, "Rollbacks without an accepted policy before the end")] = 3


class SafetyMonitor:
    """Safety monitor of a policy: error, chatter and certificate violations over sliding windows of policy steps."""

    def __init__(self, settings: MonitorSettings | None = None) -> None:
        self.settings = settings or MonitorSettings()
        lengths = (self.settings.chatter_window, self.settings.violations_window)
        squares, violated = (max(round(length / _STEP_PERIOD), 1) for length in lengths)
        self._squares: deque[float | None] = deque(maxlen=squares)  # mean of u'^2 [A^2/s^2] per step; None: no rate
        self._violated: deque[tuple[int, int]] = deque(maxlen=violated)
        self._failed = self._answered = self._recovering = 0
        self.peak = 0.0
        """Largest |e| of a step since the reset [N]."""

    def reset(self) -> None:
        """Reset for another policy or another reference."""
        self._squares.clear()
        self._violated.clear()
        self._failed = self._answered = 0
        self.peak = 0.0

    @property
    def chatter(self) -> float:
        """RMS of u' in the median step of the window so far [A/s]; 0 for an empty window."""
        known = [square for square in self._squares if square is not None]
        return math.sqrt(statistics.median(known)) if known else 0.0

    @property
    def violations(self) -> float:
        """Share of the window's corrections whose certificate failed; 0 without corrections."""
        count = sum(n for _, n in self._violated)
        return sum(v for v, _ in self._violated) / count if count else 0.0

    def on_correction(self, after: float, status: int) -> None:
        """Add the filter's result for a sample: M_c [1/s] under its correction, and the correction's status."""
        if status in _EVALUATED_STATUSES:
            self._answered += 1
            self._failed += after > _VIOLATION_TOLERANCE

    def add(self, step: Step) -> str | None:
        """Add a policy step; returns the reason to stop the policy, or None."""
        if not np.isfinite(step.sample).all():
            return "a measurement is not finite"
        if step.hold_flags:
            self.reset()
            self._recovering = _RECOVERY_STEPS
            return None
        error, slope = abs(float(step.error.mean())), np.diff(step.current) / SAMPLE_PERIOD
        if self._recovering:
            self._recovering -= 1
        else:
            self._squares.append(float(slope @ slope) / len(slope) if len(slope) else None)
            self._violated.append((self._failed, self._answered))
            self.peak = max(self.peak, error)
        self._failed = self._answered = 0
        limits = self.settings
        if not error <= limits.peak_error:
            return f"error of {error:.0f} N, limit {limits.peak_error:g} N"
        if len(self._squares) == self._squares.maxlen and not self.chatter <= limits.chatter:
            return f"chattering, RMS of u' {self.chatter:.2f} A/s, limit {limits.chatter:g} A/s"
        if len(self._violated) == self._violated.maxlen and not self.violations <= limits.violations:
            share = f"{self.violations:.0%} of {limits.violations_window:g} s"
            return f"the certificate fails in {share}, limit {limits.violations:.0%}"
        return None
