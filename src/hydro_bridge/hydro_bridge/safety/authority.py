# SPDX-License-Identifier: Apache-2.0
"""Authority over a plant: one named holder at a time, and the epoch that its commands must carry. No ROS.

::

    take    a holder claims the plant, and keeps it by asking again or by commands: after `LEASE` of silence another
            may have it
    epoch   drawn anew when the plant is disarmed or trips, and for each new holder: commands of before are refused
    give    the holder gives it back, or hands it over: then nobody but the heir may take it for `KEPT`

The epoch of the next arming is handed out before it, so that the reference can be there when the plant is armed. It
tells old and foreign commands from present ones. It is no secret: whoever can read the graph can copy it.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from math import inf

LEASE = 3.0
"""s without a word of the holder after which another may have the authority."""

KEPT = 10.0
"""s for which a plant that was handed over is kept for its heir."""

_LATE = 0.5  # s in which commands of the epoch before are on their way, and no stranger's


def _draw() -> int:
    return secrets.randbelow(2**64 - 1) + 1


class Authority:
    """The authority over one plant. Times are seconds of any one monotonic clock.

    Parameters
    ----------
    draw
        Gives numbers that are not 0 and do not come again.
    """

    def __init__(self, draw: Callable[[], int] = _draw) -> None:
        self._draw = draw
        self.holder = ""
        """Who may command; empty: nobody."""
        self.claim = 0
        """Number of the holder's claim; 0: nobody's."""
        self.epoch = draw()
        """What commands must carry."""
        self.refused: Counter[str] = Counter()
        """How many commands were refused, by topic."""
        self._heard, self._before, self._ended = -inf, 0, -inf
        self._heir, self._kept_until = "", -inf

    def take(self, name: str, claim: int, now: float) -> str:
        """Give it to `name`, or let the holder of `claim` keep it; why not, or nothing."""
        kept = bool(self.claim) and claim == self.claim
        if self.holder and not kept and now - self._heard <= LEASE:
            return f"{self.holder} commands this plant: end it, or wait until it gives the authority back"
        if not self.holder and self._heir not in ("", name) and now < self._kept_until:
            return f"this plant is handed over to {self._heir}, which may take it within {KEPT:g} s"
        if not kept:
            self._heir = ""
            self.holder, self.claim = name, self._draw()
            self.end(now)
        self._heard = now
        return ""

    def give(self, claim: int, now: float, heir: str = "") -> bool:
        """Take it back from the holder of `claim`, and keep it for `heir` if one is named; whether that one had it."""
        if not self.claim or claim != self.claim:
            return False
        self.holder, self.claim = "", 0
        self._heir, self._kept_until = heir, now + KEPT
        self.end(now)
        return True

    def lapse(self, now: float) -> bool:
        """Take it back from a holder that has been silent for `LEASE`; whether one was. Not while it is armed."""
        return now - self._heard > LEASE and self.give(self.claim, now)

    def hear(self, now: float) -> None:
        """The holder has commanded: it is not silent."""
        self._heard = now

    def end(self, now: float) -> None:
        """The session ends: what carries its epoch is refused from now on."""
        self._before, self._ended = self.epoch, now
        self.epoch = self._draw()

    def admits(self, topic: str, epoch: int, now: float) -> bool:
        """Whether a command is of this session; others are counted, unless they are late ones of the session before."""
        if epoch == self.epoch:
            return True
        if not (epoch == self._before and now - self._ended <= _LATE):
            self.refused[topic] += 1
        return False
