# SPDX-License-Identifier: Apache-2.0
"""What the box itself says of each sample, taken on its wire: it is there also when bridge and graph are not."""

from __future__ import annotations

from pathlib import Path
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from hydro_bridge.signals import Flag

RECORD = Struct("<dIIfff")
"""Monotonic time [s], sequence, flags, load force [N], valve current [A], K_p [1/s]."""
_TYPE = np.dtype(
    [("time", "<f8"), ("sequence", "<u4"), ("flags", "<u4"), ("force", "<f4"), ("current", "<f4"), ("kp", "<f4")]
)
BASE_KP = 15.0  # 1/s, of the emulated box


class Trace:
    """Reads what the wire writes, as it grows."""

    def __init__(self, path: Path) -> None:
        self._path, self._read = path, 0

    def news(self) -> NDArray[np.void]:
        """Records since the last call."""
        with self._path.open("rb") as file:
            file.seek(self._read)
            data = file.read()
        whole = len(data) - len(data) % RECORD.size
        self._read += whole
        return np.frombuffer(data[:whole], _TYPE)


def armed(records: NDArray[np.void]) -> NDArray[np.void]:
    """Which of them are armed."""
    return (records["flags"] & Flag.ARMED) != 0


def acting(records: NDArray[np.void]) -> bool:
    """Whether the plant is armed in all of them, and somebody chooses its gains."""
    chosen = np.abs(records["kp"] - BASE_KP) > 1e-3
    return len(records) > 0 and bool(armed(records).all() and chosen.any())


def lost(records: NDArray[np.void]) -> int:
    """Samples that are missing; none where the box has started anew."""
    steps = np.diff(records["sequence"].astype(np.int64))
    return int((steps[(steps > 1) & (steps < 600_000)] - 1).sum())
