# SPDX-License-Identifier: Apache-2.0
"""What the box itself says of each sample, taken on its wire: it is there also when bridge and graph are not."""

from __future__ import annotations

from pathlib import Path
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from hydro_bridge.signals import Flag

RECORD = Struct("<dIIIfff")
"""Monotonic time [s], sequence, flags, last command taken, load force [N], valve current [A], K_p [1/s]."""
TYPE = np.dtype(
    [
        ("time", "<f8"),
        ("sequence", "<u4"),
        ("flags", "<u4"),
        ("command", "<u4"),
        ("force", "<f4"),
        ("current", "<f4"),
        ("kp", "<f4"),
    ]
)
_LASTING = 300  # samples at base gains that a policy does not choose: thirty steps
BASE_KP = 15.0  # 1/s, of the emulated box


def read(path: Path) -> NDArray[np.void]:
    """All records that the wire has written so far, in place: an hour of them is no copy."""
    whole = path.stat().st_size // RECORD.size
    return np.memmap(path, TYPE, "r", shape=(whole,)) if whole else np.zeros(0, TYPE)


def armed(records: NDArray[np.void]) -> NDArray[np.void]:
    """Which of them are armed."""
    return (records["flags"] & Flag.ARMED) != 0


def acting(records: NDArray[np.void]) -> bool:
    """Whether the plant is armed in all of them, and somebody chooses its gains."""
    chosen = np.abs(records["kp"] - BASE_KP) > 1e-3
    return len(records) > 0 and bool(armed(records).all() and chosen.any())


def safe(records: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which of them are disarmed with no current, or at base gains that no policy has chosen.

    A policy may choose the box's base gains, for some steps. They count where box or guard flags them, or where they
    last.
    """
    still = ~armed(records) & (records["current"] == 0.0)
    base = still | (np.abs(records["kp"] - BASE_KP) < 1e-3)
    ends = np.flatnonzero(np.diff(base, prepend=False, append=False))
    lasting = np.zeros(len(records), bool)
    for begin, end in zip(ends[::2], ends[1::2], strict=True):
        lasting[begin:end] = end - begin >= _LASTING
    return still | (base & ((records["flags"] & (Flag.WATCHDOG | Flag.FILTER_STALE)) != 0)) | lasting


def boots(records: NDArray[np.void]) -> NDArray[np.int64]:
    """In which life of the box each of them was: its numbers start again with each."""
    return np.concatenate([[0], np.cumsum(np.diff(records["sequence"].astype(np.int64)) < 0)])[: len(records)]


def longest_unheard(records: NDArray[np.void]) -> int:
    """Samples [ms of the box's clock] after the last command taken at which the valve still had a current.

    It is the box's own time, so that a machine that stands still for a moment makes it no longer.
    """
    longest = 0
    for boot in np.split(records, np.flatnonzero(np.diff(boots(records))) + 1):
        if len(boot):
            taken = np.maximum.accumulate(
                np.where(np.diff(boot["command"], prepend=boot["command"][0]), boot["sequence"], 0)
            )
            since = boot["sequence"].astype(np.int64) - np.where(taken > 0, taken, boot["sequence"])
            longest = max(longest, int(since[boot["current"] != 0.0].max(initial=0)))
    return longest
