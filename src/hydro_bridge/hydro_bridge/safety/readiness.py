# SPDX-License-Identifier: Apache-2.0
"""Requirements before arming: each is awaited, reported, and given up after a timeout. No ROS.

::

    requirements   the plant, the filter, the recorder, the learner ...   in the order in which one needs the other
    look           some twenty times a second: what is missing; for how long it has been waited for
    after 8 s      says what is waited for, why it may take its time, and how long it is given
    after `within` the wait ends: in `NotReadyError`, or without it, which is said

The time of a requirement runs while nothing before it is missing: a recorder without a plant has nothing to record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

HINT_AFTER = 8.0
"""s of waiting after which it is said."""


class NotReadyError(Exception):
    """A requirement for arming was not met in time; the message is one clear sentence."""


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """A requirement for arming."""

    name: str
    """As in "waiting for the learner"."""
    ready: Callable[[], bool]
    """Whether it is there. May raise `NotReadyError`: it never will be."""
    hint: str
    """Why it may take its time, or what to do about it."""
    within: float
    """s that it is waited for."""
    missing: str
    """What is said when it did not come within that time."""
    essential: bool = True
    """Whether nothing goes without it; else one goes on, and `missing` says how."""


class Readiness:
    """Tracks whether all requirements for arming are met.

    Parameters
    ----------
    requirements
        In order; names are unique.
    say
        Takes a sentence.
    """

    def __init__(self, requirements: Sequence[Requirement], say: Callable[[str], None]) -> None:
        self._requirements, self._say = tuple(requirements), say
        self._missing = self._requirements  # nobody has looked yet
        self._since: dict[str, float] = {}  # when the wait for it began, s
        self._told: set[str] = set()  # waits that were told
        self._forgone: set[str] = set()  # given up, until they come after all

    @property
    def complete(self) -> bool:
        """Whether nothing was missing at the last look."""
        return not self._missing

    @property
    def awaited(self) -> str:
        """For people: `the filter and the learner`; empty if nothing is missing."""
        names = [requirement.name for requirement in self._missing]
        return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)

    def look(self, now: float) -> None:
        """See what is there; `now` by any one clock [s].

        Raises
        ------
        NotReadyError
            Something essential did not come within its time, or never will.
        """
        missing = [requirement for requirement in self._requirements if not requirement.ready()]
        absent = {requirement.name for requirement in missing}
        for name in self._since.keys() - absent:
            del self._since[name]
        self._told &= absent
        self._forgone &= absent
        self._missing = tuple(requirement for requirement in missing if requirement.name not in self._forgone)
        if self._missing:
            self._wait(self._missing[0], now)

    def _wait(self, first: Requirement, now: float) -> None:
        waited = now - self._since.setdefault(first.name, now)
        if waited > first.within and first.essential:
            raise NotReadyError(first.missing)
        if waited > first.within:
            self._forgone.add(first.name)
            self._say(first.missing)
        elif waited > HINT_AFTER and first.name not in self._told:
            self._told.add(first.name)
            self._say(f"waiting for {self.awaited}, {first.within:g} s at most: {first.hint}")
