# SPDX-License-Identifier: Apache-2.0
"""What the box's trace says of each fault, and what of it was unsafe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.soak.crew import Memory
from benchmarks.soak.wire import TYPE
from hydro_core.signals import Flag

_LASTING = 300  # samples at base gains that a policy does not choose: thirty steps
BASE_KP = 15.0  # 1/s, of the emulated box
K_P = (BASE_KP, 90.0)
"""1/s, of the policy."""
CURRENT_MAX = 0.05
"""A, the rated current of the shipped bench's valve."""
UNHEARD_MAX = 203
"""Samples: the box's watchdog of 200 ms, its period, and a command that comes between two samples."""
GROWTH = {"trainer": 40.0, "learner": 40.0}
"""MiB that a process may grow: these fill a replay buffer."""
_GROWTH = 12.0  # MiB, of all others
Records = NDArray[np.void]


def read(path: Path) -> Records:
    """All records that the wire has written so far, in place: an hour of them is no copy."""
    whole = path.stat().st_size // TYPE.itemsize
    return np.memmap(path, TYPE, "r", shape=(whole,)) if whole else np.zeros(0, TYPE)


def armed(records: Records) -> NDArray[np.bool_]:
    """Return where the box was armed."""
    return (records["flags"] & Flag.ARMED) != 0


def largest(values: NDArray[np.float32]) -> float:
    """Return the largest magnitude, 0 of none."""
    return float(np.abs(values).max(initial=0.0))


def acting(records: Records) -> bool:
    """Whether the plant is armed in all of them, and somebody chooses its gains."""
    chosen = np.abs(records["kp"] - BASE_KP) > 1e-3
    return len(records) > 0 and bool(armed(records).all() and chosen.any())


def safe(records: Records) -> NDArray[np.bool_]:
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


def longest_unheard(records: Records) -> int:
    """Samples [ms of the box's clock] after the last command taken at which the valve still had a current.

    It is the box's own time, so that a machine that stands still for a moment makes it no longer. Its numbers start
    again with each life of the box.
    """
    longest = 0
    for life in np.split(records, np.flatnonzero(np.diff(records["sequence"].astype(np.int64)) < 0) + 1):
        new = np.diff(life["command"], prepend=life["command"][:1]) != 0
        taken = np.maximum.accumulate(np.where(new, life["sequence"], 0))
        since = np.where(taken > 0, life["sequence"].astype(np.int64) - taken, 0)
        longest = max(longest, int(since[life["current"] != 0.0].max(initial=0)))
    return longest


@dataclass
class Outcome:
    """What came of one fault."""

    cause: str
    began: float
    """s of the monotonic clock."""
    safe_within: float | None
    stays_armed: bool = False
    """Whether the fault must not disarm the plant."""
    disarmed: int = 0
    """Samples that were not armed."""
    safe_after: float | None = None
    """s until disarmed with no current, or at base gains; None: it went on."""
    force: float = 0.0
    """N, largest until then, of either sign."""
    current: float = 0.0
    """A, largest until then, of either sign."""
    back_after: float | None = None
    """s from its beginning until a policy acted again; None: it did not."""

    def look(self, records: Records) -> None:
        """Judge the box's samples from the fault's beginning until it is over."""
        good, until = np.flatnonzero(safe(records)), records
        if len(good):
            until, self.safe_after = records[: good[0] + 1], max(float(records["time"][good[0]]) - self.began, 0.0)
        self.disarmed = int((~armed(records)).sum())
        self.force, self.current = largest(until["force"]), largest(until["current"])

    def violations(self) -> list[str]:
        """What was unsafe."""
        if self.stays_armed and self.disarmed:
            return [f"{self.cause}: disarmed for {self.disarmed} samples"]
        if self.safe_within is None:
            return []
        if self.safe_after is None:
            return [f"{self.cause}: never safe"]
        late = self.safe_after > self.safe_within
        return [f"{self.cause}: safe after {self.safe_after:.2f} s, not {self.safe_within} s"] if late else []


def invariants(records: Records) -> list[str]:
    """What must hold in every sample of the box, and does not."""
    unarmed = int(((records["current"] != 0.0) & ~armed(records)).sum())
    strange = int((np.abs(records["kp"] - np.clip(records["kp"], *K_P)) > 1e-3).sum())
    current, late = largest(records["current"]), longest_unheard(records)
    found = {
        f"a valve current of {current:.4f} A": current > CURRENT_MAX + 1e-6,
        f"{unarmed} disarmed samples with a valve current": unarmed > 0,
        f"{strange} samples with a K_p that nobody asks for": strange > 0,
        f"valve current {late} samples after the last command": late > UNHEARD_MAX,
    }
    return [sentence for sentence, broken in found.items() if broken]


def growth(memory: Mapping[str, Memory]) -> list[str]:
    """Which processes that lived a minute from their first figure on have grown."""
    return [
        f"{name}: {each.last - each.first:.1f} MiB more memory"
        for name, each in memory.items()
        if each.seconds > 60.0 and each.last - each.first > GROWTH.get(name.split()[0], _GROWTH)
    ]
