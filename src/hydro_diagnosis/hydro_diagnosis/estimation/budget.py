# SPDX-License-Identifier: Apache-2.0
"""Budget of work of a whole diagnosis, counted, not timed: on a slower machine the answer is the same, and later."""

from __future__ import annotations

from dataclasses import dataclass

SECOND = 5e7
"""Work that an AMD EPYC core did in a second, in samples of one equation; `benchmarks.real_recordings` has the CPU of
each rig beside its work.
"""
CALL = 13000
"""Work [samples] of an evaluation that does not grow with the recordings."""
LEAST = 60.0
"""Default budget [s], for up to 60 s at 1 kHz; beyond, in proportion to the samples."""


@dataclass
class Budget:
    """Work done and allowed, in seconds of CPU by `SECOND`."""

    seconds: float | None = None
    """Allowed; None until it is known how much is recorded."""
    spent: float = 0.0

    def allow(self, samples: int) -> None:
        """Set what is allowed by default for so many recorded samples, unless it was chosen."""
        if self.seconds is None:
            self.seconds = max(LEAST, 1e-3 * samples)

    def spend(self, samples: float, calls: int = 1) -> None:
        """Count `calls` evaluations of so many samples of an equation."""
        self.spent += calls * (CALL + samples) / SECOND

    @property
    def exhausted(self) -> bool:
        """Whether no further search may begin."""
        return self.seconds is not None and self.spent > self.seconds
