# SPDX-License-Identifier: Apache-2.0
"""Detection of companion processes that end by themselves, and the consequences for the session."""

from __future__ import annotations

import signal

from hydro_bridge.ros.companion import Companion

_REFUSED = 2  # exit status of all our commands for invalid input


class CompanionWatch:
    """Reports a companion that ended by itself, once."""

    def __init__(self, companions: list[Companion]) -> None:
        self._running = list(companions)
        self.refused = ""
        """Message of a companion that rejected its input: it will not return, so that waiting is pointless."""
        self.lost = ""
        """Message about an essential companion that ended, and its consequence."""

    def ended(self) -> list[str]:
        """Return sentences about those that ended since the last call."""
        gone = [companion for companion in self._running if not companion.running]
        self._running = [companion for companion in self._running if companion not in gone]
        for companion in gone:
            if companion.process.returncode == _REFUSED:
                said = companion.last_words.removeprefix("error: ").removeprefix(f"{companion.name}: ")
                self.refused = self.refused or f"{companion.name}: {said}"
            elif companion.name != "recorder":
                self.lost = self.lost or _sentence(companion)
        return [_sentence(companion) for companion in gone]


def _sentence(gone: Companion) -> str:
    return f"{gone.name} ended by itself ({_status(gone.process.returncode)}){_outcome(gone.name)}"


def _status(code: int) -> str:
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def _outcome(name: str) -> str:
    if name == "recorder":
        return ": what it had written stays readable, acting goes on unrecorded"
    if name == "filter":
        return ": the plant holds base gains from then on"
    return ": no samples come from then on, and the box disarms itself"
