# SPDX-License-Identifier: Apache-2.0
"""Budget of work of a diagnosis, counted rather than timed: the same on every machine."""

from __future__ import annotations

from dataclasses import dataclass, field

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE

CPU_COST = {
    PRESSURE: 7e-8, MOTION: 2.5e-8, LOAD: 1.7e-8, HYDRAULIC: 8e-9,  # per sample and block
    "column": 5e-8,  # per sample and column of a screen
    "evaluation": 8e-4,  # per evaluation in a fit, whatever the number of samples
    "segment": 2e-4,  # per segment and block, however short
}  # fmt: skip
"""CPU time [s] by block or kind of work on an AMD EPYC core; `benchmarks.real_recordings` compares measured times."""
SEARCH_SHARE = 0.6
"""Share of the budget for the search for named causes; the rest is for laws."""


@dataclass
class Budget:
    """Budget of work in nominal seconds of CPU, counted by kind of work (`CPU_COST`): the same on every machine."""

    seconds: float | None = None
    """Allowed work; None until the number of samples is known."""
    spent: float = 0.0
    evaluations: int = 0
    """Evaluations of all residuals: the measure of a search's effort."""
    untried: dict[str, None] = field(default_factory=dict)
    """What was left out since the budget was spent, in the order in which it was."""

    def allow(self, samples: int) -> None:
        """Set the budget for a number of samples, unless already set: 24 s of CPU per 60 s at 1 kHz, at least 24 s.

        For search and laws; the later stages take at most a quarter of it in addition.
        """
        if self.seconds is None:
            self.seconds = 24.0 * max(1.0, samples / 6e4)

    def exceeds(self, share: float) -> bool:
        """Return whether more than a share of the budget is spent."""
        return self.seconds is not None and self.spent > share * self.seconds

    @property
    def exhausted(self) -> bool:
        """Whether the whole budget is spent: no further search may start."""
        return self.exceeds(1.0)

    def leaves_out(self, what: str) -> bool:
        """Return whether the whole budget is spent, and note `what` as not tried if so."""
        if self.exhausted:
            self.untried[what] = None
        return self.exhausted
