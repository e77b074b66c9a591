# SPDX-License-Identifier: Apache-2.0
"""Completeness of a recording: gaps in the sequence numbers and jumps in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_bridge.signals import StateArray

_RESTART = 600_000  # a sequence that jumps further was started anew (as in stream.SequenceTracker)


@dataclass(frozen=True, kw_only=True)
class Continuity:
    """Counts over one recording; all but `samples` and `seconds` are zero if nothing is missing."""

    samples: int
    seconds: float
    """Last time minus first."""
    lost: int
    """Missing sequence numbers."""
    duplicates: int
    backward: int
    """Samples whose sequence number is lower than that of the sample before."""
    restarts: int
    time_jumps: int
    """Pairs of samples whose time difference deviates from their sequence numbers by more than the tolerance."""
    largest_jump: float
    """s, largest of these deviations."""

    @property
    def whole(self) -> bool:
        """Whether every sample is present exactly once, in order and on time."""
        return not (self.lost or self.duplicates or self.backward or self.restarts or self.time_jumps)


def continuity(states: StateArray, *, period: float = 1e-3, tolerance: float = 5e-3) -> Continuity:
    """Check sequence numbers and times of `STATE_DTYPE` records.

    Parameters
    ----------
    period
        s per sequence number.
    tolerance
        s by which the difference of two successive times may deviate from their sequence numbers.
    """
    if len(states) < 2:
        return Continuity(
            samples=len(states),
            seconds=0.0,
            lost=0,
            duplicates=0,
            backward=0,
            restarts=0,
            time_jumps=0,
            largest_jump=0.0,
        )
    step = np.diff(states["sequence"]).view(np.int32).astype(np.int64)  # unsigned difference: wraps at 2^32
    restart = np.abs(step) > _RESTART
    jump = np.where(restart, 0.0, np.abs(np.diff(states["time"]) - step * period))
    return Continuity(
        samples=len(states),
        seconds=float(states["time"][-1] - states["time"][0]),
        lost=int((step[(step > 1) & ~restart] - 1).sum()),
        duplicates=int((step == 0).sum()),
        backward=int(((step < 0) & ~restart).sum()),
        restarts=int(restart.sum()),
        time_jumps=int((jump > tolerance).sum()),
        largest_jump=float(jump.max() if jump.max() > tolerance else 0.0),
    )
