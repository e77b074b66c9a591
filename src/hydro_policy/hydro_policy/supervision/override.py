# SPDX-License-Identifier: Apache-2.0
"""Manual override: a person sets the gains in place of the controller, for a chosen time.

It is in force from the next policy step on, whether a policy learns, is examined, waits or pauses. It exists in the
node only: no checkpoint holds it, no run begins with it. The bench's behaviour under it is neither learnt nor scored.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from hydro_policy.task.mdp import BASE, GainRange


@dataclass
class GainOverride:
    """State of a manual override."""

    reach: GainRange = field(default_factory=GainRange)
    """Gain changes that may be requested: those that the plant's guard passes."""
    report: Callable[[str], None] = lambda _: None  # takes a sentence for each change
    base: tuple[float, float] = BASE
    """K_p [1/s], K_i [1/s^2] of the box, to which it adds changes (default: the paper's)."""
    _held: tuple[float, float] | None = None  # (delta_kp, delta_ki)
    _until: float = math.inf  # s

    def hold(self, proportional: float, integral: float, seconds: float, now: float) -> str:
        """Hold K_p [1/s] and K_i [1/s^2], base gains included, for `seconds` (0: until released); returns a report.

        Raises ValueError: the gains are not finite or out of range; nothing has changed.
        """
        base, reach = self.base, self.reach
        change = (proportional - base[0], integral - base[1])
        if not (math.isfinite(seconds) and seconds >= 0.0):
            raise ValueError(f"an override lasts 0 (until told otherwise) or more seconds, not {seconds:g}")
        ends = (reach.delta_kp_min, reach.delta_kp_max), (reach.delta_ki_min, reach.delta_ki_max)
        if not all(low <= one <= high for one, (low, high) in zip(change, ends, strict=True)):  # NaN is outside
            kp, ki = (f"within [{own + low:g}, {own + high:g}]" for own, (low, high) in zip(base, ends, strict=True))
            raise ValueError(f"({proportional:g}, {integral:g}) cannot be held here: K_p {kp}, K_i {ki}")
        self._held, self._until = change, now + seconds if seconds else math.inf
        how_long = f"for {seconds:g} s" if seconds else "until told otherwise"
        sentence = f"gains overridden by hand: ({proportional:g}, {integral:g}) {how_long}"
        self.report(sentence)
        return sentence

    def release(self) -> str:
        """Return the gains to the controller; returns a report."""
        if self._held is None:
            return "nothing was overridden"
        self._held = None
        sentence = "override ended: the gains are the policy's again"
        self.report(sentence)
        return sentence

    def gains(self, now: float) -> tuple[float, float] | None:
        """Return the (delta_kp, delta_ki) to publish instead of the controller's at time `now` [s], or None."""
        if self._held is not None and now >= self._until:
            self._held = None
            self.report("override is over: the gains are the policy's again")
        return self._held

    @property
    def active(self) -> bool:
        """Whether a person holds the gains."""
        return self._held is not None

    @property
    def description(self) -> str:
        """Text for /diagnostics: the gains held, or no."""
        held, base = self._held, self.base
        return "no" if held is None else f"K_p {base[0] + held[0]:g}, K_i {base[1] + held[1]:g}"
