# SPDX-License-Identifier: Apache-2.0
"""White noise in a signal, by sixth differences: they cancel everything below a tenth of the sampling rate."""

from __future__ import annotations

from math import comb

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray

_ORDER = 6
_GAIN = sum(comb(_ORDER, k) ** 2 for k in range(_ORDER + 1)) ** 0.5


def white_noise(signal: FloatArray, recorded: npt.NDArray[np.bool_] | None = None) -> float:
    """Standard deviation of the white noise in a signal, robust against rare jumps; None: every sample is recorded."""
    differences = np.diff(signal, _ORDER) / _GAIN
    if recorded is not None:
        differences = differences[np.lib.stride_tricks.sliding_window_view(recorded, _ORDER + 1).all(axis=1)]
        if not len(differences):
            return white_noise(signal)
    middle = float(np.median(np.abs(differences)))
    limit = 6.0 * middle if middle > 0.0 else np.inf  # a slow encoder repeats itself most of the time
    kept = differences[np.abs(differences) <= limit]
    return float(np.sqrt(np.mean(np.square(kept)))) if len(kept) else 0.0
