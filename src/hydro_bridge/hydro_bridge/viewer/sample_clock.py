# SPDX-License-Identifier: Apache-2.0
"""Conversion of other clocks' stamps to the samples' time, since a simulation off real time has its own clock.

/rosout and most nodes use the wall clock, as the recorder's log does; such a stamp is moved to the samples' time at
which it was logged. In real time both clocks are the same, and stamps stay unchanged.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray

APART = 2.0
"""s between stamp and log time beyond which they are of two clocks; a delayed recorder stays below."""


class SampleClock:
    """Tracks the samples of a recording as it is read, block by block."""

    def __init__(self) -> None:
        self._logged, self._time, self._rate = 0.0, 0.0, 0.0  # of the last sample; 0: none yet

    def see(self, logged: npt.NDArray[np.int64], times: FloatArray) -> None:
        """Add a block of samples: log times [ns] and stamps [s], both of shape (n,)."""
        if not len(logged):
            return
        span = 1e-9 * float(logged[-1] - logged[0])
        self._rate = float(times[-1] - times[0]) / span if span > 0.0 else self._rate
        self._logged, self._time = 1e-9 * float(logged[-1]), float(times[-1])

    def at(self, stamps: npt.ArrayLike, logged: npt.ArrayLike) -> FloatArray:
        """Return the samples' time [s] of messages from their stamps [s] and log times [s], of one shape."""
        stamps, logged = np.asarray(stamps, np.float64), np.asarray(logged, np.float64)
        if not self._rate or abs(self._time - self._logged) <= APART:  # no samples yet, or one clock
            return stamps
        by_wall_clock = np.abs(stamps - logged) <= APART
        return np.where(by_wall_clock, self._time + self._rate * (logged - self._logged), stamps)
