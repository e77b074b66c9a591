# SPDX-License-Identifier: Apache-2.0
"""Authority over a plant: one named holder at a time, and the epoch that its commands must carry. No ROS.

::

    take    a holder claims the plant, and keeps it by repeated claims or commands: after `LEASE` of silence another
            node may take it
    epoch   redrawn when the plant is disarmed or trips, and for each new holder: earlier commands are refused
    give    the holder returns it, or hands it over: then only the heir may take it for `KEPT`

The epoch of the next arming is issued in advance, so that the reference can be set before the plant is armed. It
distinguishes current commands from old and foreign ones. It is not a secret: any reader of the graph can copy it.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from math import inf

LEASE = 3.0
"""s of the holder's silence after which another node may take the authority."""

KEPT = 10.0
"""s for which a plant that was handed over is reserved for its heir."""

BY_HAND = "a person disarmed the plant: arm it on the live page, or by `ros2 run hydro_bridge arm`"
"""Why a holder's request to arm is refused."""

_LATE = 0.5  # s in which commands of the previous epoch count as late, not as foreign


def _draw() -> int:
    return secrets.randbelow(2**64 - 1) + 1


class Authority:
    """The authority over one plant. Times are seconds of any one monotonic clock.

    `draw`: returns non-zero numbers that do not repeat.
    """

    def __init__(self, draw: Callable[[], int] = _draw) -> None:
        self._draw = draw
        self.holder = ""
        """Name of the node that may command; empty: none."""
        self.claim = 0
        """Number of the holder's claim; 0: none."""
        self.epoch = draw()
        """Epoch that commands must carry."""
        self.refused: Counter[str] = Counter()
        """Number of refused commands by topic."""
        self._heard, self._before, self._ended = -inf, 0, -inf
        self._heir, self._kept_until = "", -inf

    def take(self, name: str, claim: int, now: float) -> str:
        """Give it to `name`, or renew it for the holder of `claim`; returns the reason of a refusal, or nothing."""
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
        """Take it back from the holder of `claim`, reserve it for `heir` if named; return whether `claim` held it."""
        if not self.claim or claim != self.claim:
            return False
        self.holder, self.claim = "", 0
        self._heir, self._kept_until = heir, now + KEPT
        self.end(now)
        return True

    def lapse(self, now: float) -> bool:
        """Take it back from a holder silent for `LEASE`, and return whether one was. Not while the plant is armed."""
        return now - self._heard > LEASE and self.give(self.claim, now)

    def renew(self, now: float) -> None:
        """Record a command of the holder, which ends its silence."""
        self._heard = now

    def end(self, now: float) -> None:
        """End the session: commands with its epoch are refused from now on."""
        self._before, self._ended = self.epoch, now
        self.epoch = self._draw()

    def admits(self, topic: str, epoch: int, now: float) -> bool:
        """Return whether a command is of this session; counts others, except late ones of the previous session."""
        if epoch == self.epoch:
            return True
        if not (epoch == self._before and now - self._ended <= _LATE):
            self.refused[topic] += 1
        return False
