# SPDX-License-Identifier: Apache-2.0
"""Selection of the weight changes to mark, since a learner changes a policy's weights some fifty times a second.

Marked are the first weights, and changes after a second or more without one: where learning begins, and where it
continues after an examination, a stop or a pause. Each mark gives the number of changes since the previous mark.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

STILL = 1.0
"""s without a change, after which a change is marked."""


def digest_of(weights: int) -> str:
    """Return `PolicyStep.weights` as in the trainer's diagnostics: 12 hex digits."""
    return f"{weights:012x}"


class WeightChanges:
    """Tracks the acting weights while a recording is read in order."""

    def __init__(self) -> None:
        self._weights: int | None = None
        self._changed, self._count = 0.0, 0

    def add(self, steps: npt.NDArray[np.void]) -> list[tuple[float, str]]:
        """Add PolicyStep records, with `time` [s] and `weights`; returns the marks by time [s] and sentence."""
        if not len(steps):
            return []
        times, weights = steps["time"], steps["weights"]
        marks = []
        if self._weights is None:
            self._changed, self._weights = float(times[0]), int(weights[0])
            marks.append((self._changed, f"weights {digest_of(self._weights)}, the first to act"))
        before = np.concatenate((np.array([self._weights], weights.dtype), weights[:-1]))
        for n in np.flatnonzero(weights != before):
            time, self._count = float(times[n]), self._count + 1
            if time - self._changed >= STILL:
                often = f"{self._count} change{'s' if self._count > 1 else ''} since the mark before"
                marks.append((time, f"weights {digest_of(int(weights[n]))}, {often}"))
                self._count = 0
            self._changed = time
        self._weights = int(weights[-1])
        return marks
