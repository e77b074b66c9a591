# SPDX-License-Identifier: Apache-2.0
"""Playback of a schedule into a plant: position in the schedule, and trips so far."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from hydro_bridge.signals import SAMPLE_PERIOD, Flag
from hydro_sim.excitation.schedules import Segment


class Playback:
    """Plays segments by the plant's armed samples: while it is disarmed the schedule pauses."""

    def __init__(self, schedule: Sequence[Segment]) -> None:
        self._schedule = list(schedule)
        self._ends = list(accumulate(segment.seconds for segment in schedule))
        self._index, self._samples = -1, 0
        self._clean = False
        self.flags = Flag(0)
        """Flags of the last sample."""
        self.trips = 0
        self.trips_in_a_row = 0
        """Trips since the last segment that was played from its beginning to its end without one."""

    @property
    def seconds(self) -> float:
        """Length of the schedule [s]."""
        return self._ends[-1]

    @property
    def elapsed(self) -> float:
        """Time played [s]."""
        return self._samples * SAMPLE_PERIOD

    @property
    def finished(self) -> bool:
        """Whether the last segment has ended."""
        return self._index == len(self._schedule)

    def on_sample(self, flags: int) -> None:
        """Process a sample's flags. Nothing before the first segment is counted."""
        before, self.flags = self.flags, Flag(flags)
        if self._index < 0:
            return
        self._samples += bool(self.flags & Flag.ARMED)
        if self.flags & ~before & Flag.TRIPPED:
            self.trips, self.trips_in_a_row, self._clean = self.trips + 1, self.trips_in_a_row + 1, False

    def next(self) -> Segment | None:
        """Return the segment that begins now, if one does."""
        index = max(self._index, 0)
        while index < len(self._ends) and self.elapsed >= self._ends[index]:
            index += 1
        if index == self._index:
            return None
        self.trips_in_a_row = 0 if self._clean else self.trips_in_a_row
        self._index, self._clean = index, True
        return None if self.finished else self._schedule[index]
