# SPDX-License-Identifier: Apache-2.0
"""The samples' time of what other clocks have stamped: a simulation off real time has a clock of its own.

/rosout and most nodes are stamped by the wall clock, as the recorder logs messages; such a stamp is moved to where the
samples were when it was logged. In real time both clocks are one, and stamps stay as they are.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray

APART = 2.0
"""s between a stamp and the log from which on they are of two clocks; a recorder that is held up stays below."""


class SampleClock:
    """Follows the samples of a recording as it is read, block by block."""

    def __init__(self) -> None:
        self._logged, self._time, self._rate = 0.0, 0.0, 0.0  # of the last sample; 0: none yet

    def see(self, logged: npt.NDArray[np.int64], times: FloatArray) -> None:
        """Take a block of samples: when each was logged [ns], and its stamp [s], both of shape (n,)."""
        if not len(logged):
            return
        span = 1e-9 * float(logged[-1] - logged[0])
        self._rate = float(times[-1] - times[0]) / span if span > 0.0 else self._rate
        self._logged, self._time = 1e-9 * float(logged[-1]), float(times[-1])

    def at(self, stamps: npt.ArrayLike, logged: npt.ArrayLike) -> FloatArray:
        """The samples' time [s] of messages by their stamps [s] and by when they were logged [s], of one shape."""
        stamps, logged = np.asarray(stamps, np.float64), np.asarray(logged, np.float64)
        if not self._rate or abs(self._time - self._logged) <= APART:  # no samples yet, or one clock
            return stamps
        by_wall_clock = np.abs(stamps - logged) <= APART
        return np.where(by_wall_clock, self._time + self._rate * (logged - self._logged), stamps)
