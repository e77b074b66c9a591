# SPDX-License-Identifier: Apache-2.0
"""How wide the gains may be: as the guard was opened, or the narrow range where the filter's model does not fit.

A filter that says MISMATCH (its model is not this bench's) vouches for no gain. Until it decides again the limits are
those that every bench of this kind bears by itself, however wide the guard was opened: the defaults of
`guard_limits.GuardSettings`, the paper's range. Gains inside it are left alone. Between the two the limits slide,
within `authority_ramp`: the law's current holds K_p e, and a step of K_p is one of the valve.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from hydro_bridge.guard_limits import GuardSettings

NARROW = GuardSettings()
"""Its ranges of delta_kp and delta_ki: K_p 15 to 90, K_i 5 to 15 on base gains of 15 and 5."""


@dataclass(kw_only=True)
class Authority:
    """Where the limits of the gains stand between narrow and wide."""

    share: float = 1.0
    """Of the way from narrow to wide, [0, 1]."""
    _moved_at: float = inf

    def move(self, *, wide: bool, now: float, ramp: float) -> None:
        """Slide towards one of the two; `now` [s] of a monotonic clock, `ramp` [s] for all of the way."""
        step = max(now - self._moved_at, 0.0) / ramp
        self._moved_at = now
        self.share = min(self.share + step, 1.0) if wide else max(self.share - step, 0.0)

    def admitted(self, gains: tuple[float, float], wide: GuardSettings) -> tuple[float, float]:
        """Changes of K_p [1/s] and K_i [1/s^2] that may pass of those that `wide` lets pass."""
        return (
            self._within(gains[0], wide.delta_kp_min, wide.delta_kp_max, NARROW.delta_kp_min, NARROW.delta_kp_max),
            self._within(gains[1], wide.delta_ki_min, wide.delta_ki_max, NARROW.delta_ki_min, NARROW.delta_ki_max),
        )

    def _within(self, value: float, low: float, high: float, narrow_low: float, narrow_high: float) -> float:
        narrow_low, narrow_high = max(low, narrow_low), min(high, narrow_high)
        low, high = narrow_low + self.share * (low - narrow_low), narrow_high + self.share * (high - narrow_high)
        return min(max(value, low), high)
