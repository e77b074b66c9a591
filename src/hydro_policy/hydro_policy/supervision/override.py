# SPDX-License-Identifier: Apache-2.0
"""Manual override: a person sets the gains in place of the controller, for a chosen time.

It takes effect at the next policy step, in training, examination, waiting and pause. It is part of the node's state
only, not of checkpoints: no run starts with it. Samples under it are neither learnt from nor scored.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from hydro_policy.task.mdp import BASE_GAINS, GainRange


@dataclass
class GainOverride:
    """Manual override of the gains, with the range that may be requested."""

    gain_range: GainRange = field(default_factory=GainRange)
    """Range of gain changes that may be requested: that of the plant's guard."""
    report: Callable[[str], None] = lambda _: None  # takes a sentence for each change
    base: tuple[float, float] = BASE_GAINS
    """Base gains K_p [1/s], K_i [1/s^2] of the box, to which gain changes are added (default: the paper's)."""
    _held: tuple[float, float] | None = None  # (delta_kp, delta_ki)
    _until: float = math.inf  # s

    def start(self, proportional: float, integral: float, seconds: float, now: float) -> str:
        """Override the gains by totals K_p [1/s], K_i [1/s^2] for `seconds` (0: until released); returns a report.

        Raises ValueError: gains or `seconds` are not finite or out of range; the state is unchanged.
        """
        base, gain_range = self.base, self.gain_range
        change = (proportional - base[0], integral - base[1])
        if not (math.isfinite(seconds) and seconds >= 0.0):
            raise ValueError(f"an override lasts 0 (until told otherwise) or more seconds, not {seconds:g}")
        ends = (gain_range.delta_kp_min, gain_range.delta_kp_max), (gain_range.delta_ki_min, gain_range.delta_ki_max)
        if not all(low <= one <= high for one, (low, high) in zip(change, ends, strict=True)):  # NaN is outside
            kp, ki = (f"within [{own + low:g}, {own + high:g}]" for own, (low, high) in zip(base, ends, strict=True))
            raise ValueError(f"({proportional:g}, {integral:g}) cannot be held here: K_p {kp}, K_i {ki}")
        self._held, self._until = change, now + seconds if seconds else math.inf
        how_long = f"for {seconds:g} s" if seconds else "until told otherwise"
        sentence = f"gains overridden by hand: ({proportional:g}, {integral:g}) {how_long}"
        self.report(sentence)
        return sentence

    def release(self) -> str:
        """End the override, so that the controller's gains act again; returns a report."""
        if self._held is None:
            return "nothing was overridden"
        self._held = None
        sentence = "override ended: the gains are the policy's again"
        self.report(sentence)
        return sentence

    def gains(self, now: float) -> tuple[float, float] | None:
        """Return the overriding gain changes (delta_kp, delta_ki) at time `now` [s]; None: no override in force."""
        if self._held is not None and now >= self._until:
            self._held = None
            self.report("override is over: the gains are the policy's again")
        return self._held

    @property
    def active(self) -> bool:
        """Whether an override is in force."""
        return self._held is not None

    @property
    def description(self) -> str:
        """Text for /diagnostics: the overriding total gains, or `no`."""
        held, base = self._held, self.base
        return "no" if held is None else f"K_p {base[0] + held[0]:g}, K_i {base[1] + held[1]:g}"
