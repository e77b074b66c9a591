# SPDX-License-Identifier: Apache-2.0
"""Lease on one plant: the exclusive right to command it, granted to one node at a time. No ROS.

::

    take     a node is granted the lease, and renews it by further requests or by its commands: after `LEASE_TIMEOUT`
             without either it has lapsed, and the next node to request it gets it, with a disarmed plant
    epoch    drawn anew at each disarming, trip and change of holder: a command that carries another one is refused
    disarm   open to anybody. After a person's disarming the holder may not arm until a person has armed the plant
    give     the holder releases the lease, with a disarmed plant

All times are the plant's. The epoch of the next arming is issued in advance, so that the reference can be set before
the plant is armed. The epoch separates current commands from old and foreign ones, but is no secret: any reader of the
graph can copy it, which is why a topic with a second publisher is refused (`hydro_bridge.nodes.plant_node`).
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable
from math import inf

LEASE_TIMEOUT = 3.0
"""Silence of the holder [s] after which its lease has lapsed."""

DISARMED_BY_PERSON = "a person disarmed the plant: arm it on the live page, or by `ros2 run hydro_bridge arm`"
"""Refusal of a holder's request to arm a plant that a person has disarmed."""


class Lease:
    """Exclusive right to command one plant. Times are seconds of any one monotonic clock.

    `draw`: source of non-zero numbers that do not repeat.
    """

    def __init__(self, draw: Callable[[], int] = lambda: secrets.randbelow(2**64 - 1) + 1) -> None:
        self._draw = draw
        self.holder = ""
        """Name of the node that holds the lease; empty: none."""
        self.claim = 0
        """Number that identifies the holder's claim in its requests; 0: none."""
        self.epoch = draw()
        """Epoch that commands must carry."""
        self.refused: Counter[str] = Counter()
        """Number of refused commands by topic."""
        self._renewed, self._before, self._ended = -inf, 0, -inf
        self._barred = 0  # claim under which a person disarmed; 0: no person has

    def held_by(self, claim: int) -> bool:
        """Return whether `claim` is that of the present holder."""
        return bool(claim) and claim == self.claim

    def grant(self, name: str, claim: int, now: float) -> str:
        """Grant the lease to `name`, or renew that of `claim`; return the reason of a refusal, else empty."""
        self._follow(now)
        kept = self.held_by(claim)
        if self.holder and not kept and now - self._renewed <= LEASE_TIMEOUT:
            return f"{self.holder} commands this plant: end it, or wait until it gives the lease back"
        if not kept:
            self.holder, self.claim = name, self._draw()
            self.end_session(now)
        self._renewed = now
        return ""

    def release(self, claim: int, now: float) -> bool:
        """Release the lease of `claim`; returns whether `claim` held it."""
        if not self.held_by(claim):
            return False
        self.holder, self.claim = "", 0
        self.end_session(now)
        return True

    def expire(self, now: float) -> bool:
        """Release the lease of a holder silent for `LEASE_TIMEOUT`; return whether there was one. Not while armed."""
        self._follow(now)
        return now - self._renewed > LEASE_TIMEOUT and self.release(self.claim, now)

    def _follow(self, now: float) -> None:
        """Follow a clock that went back: before its box is connected a plant counts by the host's, then by the box's.

        A lease granted before would else never lapse, and a holder that missed its grant would wait for itself.
        """
        self._renewed, self._ended = min(self._renewed, now), min(self._ended, now)

    def end_session(self, now: float) -> None:
        """End the session, after a disarming, a trip or a change of holder: its commands are refused from now on."""
        self._before, self._ended = self.epoch, now
        self.epoch = self._draw()

    def accepts(self, topic: str, epoch: int, now: float, *, renews: bool = True) -> bool:
        """Return whether a command carries the session's epoch; refused ones are counted, unless they are late.

        `renews`: whether the command renews the holder's lease; a filter's correction does not.
        """
        if epoch == self.epoch:
            if renews:
                self._renewed = now
            return True
        if not (epoch == self._before and now - self._ended <= 0.5):  # else they are foreign
            self.refused[topic] += 1
        return False

    def arm_refusal(self, claim: int, epoch: int, whom: str) -> str:
        """Return the reason to refuse a request to arm, else empty.

        `claim`: that of the requester; 0: a person, who arms for the present holder. `epoch`: session that the
        requester saw; 0: any. `whom`: required holder; empty: any.
        """
        holder = self.holder or "nobody"
        if whom and whom != self.holder:
            return f"{holder} commands this plant, not {whom}"
        if claim not in (0, self.claim):
            return f"{holder} commands this plant now"
        if epoch not in (0, self.epoch):
            return "the plant was disarmed, tripped or changed hands since: look, and ask again"
        return DISARMED_BY_PERSON if claim and claim == self._barred else ""

    def on_armed(self) -> None:
        """Note an arming, which lifts the bar of a person's disarming."""
        self._barred = 0

    def on_disarmed(self, claim: int) -> None:
        """Note a disarming by `claim`; by a person (0) it bars the holder from arming until a person has armed.

        An expired claim, often the holder's own from before its silence, is a node's, and bars nobody.
        """
        if not claim:
            self._barred = self.claim
