# SPDX-License-Identifier: Apache-2.0
"""Requirements before arming: each is awaited, reported, and given up after a time-out. No ROS.

::

    requirements    the plant, the filter, the recorder, the learner ...   in order of their dependence
    check           some twenty times a second: what is missing, and for how long
    after 8 s       reports what is awaited, why it may take long, and the time allowed
    after `timeout` the wait ends: in `NotReadyError`, or with a report that the run continues without it

A requirement's time runs while no earlier one is missing: a recorder without a plant has nothing to record. The
requirements themselves: `hydro_policy.supervision.plant_supervisor` (plant, filter, learner), `box_info` (box),
`hydro_bridge.ros.companion` (recorder).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


class NotReadyError(Exception):
    """A requirement for arming was not met in time; the message is one clear sentence."""


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """Requirement for arming, with its time limit and its messages."""

    name: str
    """Name in messages, as in "waiting for the learner"."""
    ready: Callable[[], bool]
    """Returns whether the requirement is met; raises `NotReadyError` if it never will be."""
    hint: str
    """Reason for a long wait, or its remedy."""
    timeout: float
    """Time limit [s]."""
    timeout_message: str
    """Message if the requirement is not met within the time limit."""
    essential: bool = True
    """Whether the run cannot continue without it; otherwise it continues as `timeout_message` describes."""
    by_wall_clock: bool = False
    """Whether it is met in wall-clock time, so that a plant that runs by its own clock waits for it."""


class Readiness:
    """Tracks whether all requirements for arming are met.

    `requirements`: requirements in order; names are unique. `report`: logs a sentence.
    """

    def __init__(self, requirements: Sequence[Requirement], report: Callable[[str], None]) -> None:
        self.requirements, self._report = tuple(requirements), report
        self._missing = self.requirements  # not checked yet
        self._since: dict[str, float] = {}  # when the wait for it began, s
        self._told: set[str] = set()  # waits already reported
        self._forgone: set[str] = set()  # given up, unless met later

    @property
    def complete(self) -> bool:
        """Whether each requirement was met or forgone at the last check."""
        return not self._missing

    @property
    def missing_names(self) -> str:
        """Names of the missing requirements as text, for instance `the filter and the learner`; empty if none."""
        names = [requirement.name for requirement in self._missing]
        return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)

    def check(self, now: float) -> None:
        """Check all requirements; `now` by any one clock [s].

        Raises NotReadyError: an essential requirement was not met within its time, or never will be.
        """
        missing = [requirement for requirement in self.requirements if not requirement.ready()]
        absent = {requirement.name for requirement in missing}
        for name in self._since.keys() - absent:
            del self._since[name]
        self._told &= absent
        self._forgone &= absent
        self._missing = tuple(requirement for requirement in missing if requirement.name not in self._forgone)
        if not self._missing:
            return
        first = self._missing[0]
        waited = now - self._since.setdefault(first.name, now)
        if waited > first.timeout and first.essential:
            raise NotReadyError(first.timeout_message)
        if waited > first.timeout:
            self._forgone.add(first.name)
            self._report(first.timeout_message)
        elif waited > 8.0 and first.name not in self._told:
            self._told.add(first.name)
            self._report(f"waiting for {self.missing_names}, {first.timeout:g} s at most: {first.hint}")
