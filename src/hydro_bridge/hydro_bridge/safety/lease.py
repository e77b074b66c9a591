# SPDX-License-Identifier: Apache-2.0
"""Who may move the valve: the lease on one plant's command, which the guard grants to one node at a time. No ROS.

::

    take     a node is granted the lease, and renews it by asking again or by its commands: after `SILENCE` without
             either it has lapsed, and the next to ask gets it, with a disarmed plant
    epoch    drawn again at each disarming, trip and change of holder: a command that carries another one is refused
    disarm   anybody may. What a person has disarmed the holder may not arm until a person has armed it
    give     the holder returns the lease; handed over, only the heir may take it for `HANDOVER_TIME`

All times are the plant's. The epoch of the next arming is issued in advance, so that the reference can be set before
the plant is armed. It tells current commands from old and foreign ones. It is no secret: any reader of the graph can
copy it, which is why a topic with a second publisher is refused as a whole (`hydro_bridge.nodes.plant_node`).
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from math import inf

SILENCE = 3.0
"""s of the holder's silence after which its lease has lapsed."""

HANDOVER_TIME = 10.0
"""s for which a plant that was handed over is reserved for its heir."""

BY_HAND = "a person disarmed the plant: arm it on the live page, or by `ros2 run hydro_bridge arm`"
"""Why a holder's request to arm is refused."""

_LATE = 0.5  # s in which commands of the previous epoch count as late, not as foreign


class Lease:
    """The right to command one plant. Times are seconds of any one monotonic clock.

    `draw`: returns non-zero numbers that do not repeat.
    """

    def __init__(self, draw: Callable[[], int] = lambda: secrets.randbelow(2**64 - 1) + 1) -> None:
        self._draw = draw
        self.holder = ""
        """Name of the node that may command; empty: none."""
        self.claim = 0
        """Number of the holder's claim; 0: none."""
        self.epoch = draw()
        """Epoch that commands must carry."""
        self.refused: Counter[str] = Counter()
        """Number of refused commands by topic."""
        self._renewed, self._before, self._ended = -inf, 0, -inf
        self._heir, self._kept_until = "", -inf
        self._barred = 0  # claim under which a person disarmed; 0: no person has

    def held_by(self, claim: int) -> bool:
        """Return whether the lease is held under this claim."""
        return bool(claim) and claim == self.claim

    def take(self, name: str, claim: int, now: float) -> str:
        """Grant the lease to `name`, or renew that of `claim`; returns the reason of a refusal, or nothing."""
        kept = self.held_by(claim)
        if self.holder and not kept and now - self._renewed <= SILENCE:
            return f"{self.holder} commands this plant: end it, or wait until it gives the lease back"
        if not self.holder and self._heir not in ("", name) and now < self._kept_until:
            return f"this plant is handed over to {self._heir}, which may take it within {HANDOVER_TIME:g} s"
        if not kept:
            self._heir = ""
            self.holder, self.claim = name, self._draw()
            self.end_session(now)
        self._renewed = now
        return ""

    def release(self, claim: int, now: float, heir: str = "") -> bool:
        """Release the lease of `claim`, and reserve it for `heir` if named; returns whether `claim` held it."""
        if not self.held_by(claim):
            return False
        self.holder, self.claim = "", 0
        self._heir, self._kept_until = heir, now + HANDOVER_TIME
        self.end_session(now)
        return True

    def expire(self, now: float) -> bool:
        """Release the lease of a holder silent for `SILENCE`; returns whether there was one. Not while armed."""
        return now - self._renewed > SILENCE and self.release(self.claim, now)

    def end_session(self, now: float) -> None:
        """End the session, as the plant was disarmed or has tripped: its commands are refused from now on."""
        self._before, self._ended = self.epoch, now
        self.epoch = self._draw()

    def admits(self, topic: str, epoch: int, now: float, *, renews: bool = True) -> bool:
        """Return whether a command is of this session; counts others, unless they are late.

        `renews`: whether it is the holder's, whose lease it renews. A filter goes on without the holder.
        """
        if epoch == self.epoch:
            if renews:
                self._renewed = now
            return True
        if not (epoch == self._before and now - self._ended <= _LATE):
            self.refused[topic] += 1
        return False

    def arm_refusal(self, claim: int, epoch: int, whom: str) -> str:
        """Return the reason to refuse a request to arm, or nothing.

        `claim`: 0 for a person, who arms for whoever holds the lease. `epoch`: of the session that was seen; 0: of any.
        `whom`: who must hold it; empty: whoever does.
        """
        holder = self.holder or "nobody"
        if whom and whom != self.holder:
            return f"{holder} commands this plant, not {whom}"
        if claim not in (0, self.claim):
            return f"{holder} commands this plant now"
        if epoch not in (0, self.epoch):
            return "the plant was disarmed, tripped or changed hands since: look, and ask again"
        return BY_HAND if claim and claim == self._barred else ""

    def note_armed(self) -> None:
        """Note that the plant was armed on purpose, which lifts the bar of a person's disarming."""
        self._barred = 0

    def note_disarmed(self, claim: int) -> None:
        """Note a disarming by `claim`; by a person (0) it bars the holder from arming until a person has armed.

        A claim that is over is a node's, often the holder's own from before its silence, and bars nobody.
        """
        if not claim:
            self._barred = self.claim
