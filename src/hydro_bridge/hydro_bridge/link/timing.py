# SPDX-License-Identifier: Apache-2.0
"""Latencies on the serial line, from the sequence numbers of states and commands."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from hydro_bridge.process.latency import Latency

_RECENT = 256  # number of samples and commands kept
_WRAP = 0xFFFFFFFF


@dataclass
class LinkTimes:
    """Two latencies, measured at every sample. Times are seconds of one monotonic clock."""

    turnaround: Latency = field(default_factory=Latency)
    """From receiving a state frame to sending the command frame that corrects it: publishing, the filter, and back."""
    round_trip: Latency = field(default_factory=Latency)
    """From sending a command frame to the first state frame that confirms it; up to one sample of it is the box's."""
    _arrived: dict[int, float] = field(default_factory=dict)
    _sent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=_RECENT))

    def state_arrived(self, sequence: int, last_command: int, now: float) -> None:
        """Record a sample, and the newest command that the box had received by then."""
        self._arrived[sequence] = now
        self._arrived.pop((sequence - _RECENT) & _WRAP, None)
        while self._sent and (last_command - self._sent[0][0]) & _WRAP < _RECENT:
            command, at = self._sent.popleft()
            if command == last_command:
                self.round_trip.add(now - at)

    def command_sent(self, sequence: int, corrects: int | None, now: float) -> None:
        """Record a command, and the sample whose correction triggered it."""
        self._sent.append((sequence, now))
        arrived = self._arrived.get(corrects) if corrects is not None else None
        if arrived is not None:
            self.turnaround.add(now - arrived)

    def forget(self) -> None:
        """Discard pending measurements: sequence numbers restart."""
        self._arrived.clear()
        self._sent.clear()
