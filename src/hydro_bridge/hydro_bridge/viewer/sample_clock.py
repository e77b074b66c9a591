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

    def at(self, stamp: float, logged: float) -> float:
        """The samples' time [s] of a message by its stamp [s] and by when it was logged [s]."""
        if not self._rate or abs(stamp - logged) > APART:  # no samples yet, or stamped by the samples' clock
            return stamp
        time = self._time + self._rate * (logged - self._logged)
        return time if abs(time - logged) > APART else stamp
