# SPDX-License-Identifier: Apache-2.0
"""Rollback: a failing policy is replaced by the last one that passed an examination.

learner's state ──propose──> candidate ──accept──> last good ──(best score)──> best, on disk
                                 └────── stopped: roll_back to the last good one; after too many in a row: the end
"""

from __future__ import annotations

from hydro_bridge.signals import FloatArray
from hydro_policy.sac.snapshot import actor_parameters
from hydro_policy.supervision.learner_requests import RollingLearner


class PolicyKeeper:
    """Keeps the last good state of the learner, and counts rollbacks.

    Parameters
    ----------
    learner
        Running learner.
    rollbacks_max
        Maximum number of rollbacks in a row.
    best
        The best state of the resumed run, or None.
    """

    def __init__(self, learner: RollingLearner, rollbacks_max: int, best: bytes | None = None) -> None:
        self._learner, self._max = learner, rollbacks_max
        self._good, self._best = best, best
        self._candidate: bytes | None = None
        if best is not None:
            learner.keep(best)
        self.in_a_row = 0
        """Rollbacks since a policy was last accepted."""

    @property
    def exhausted(self) -> bool:
        """Whether there were too many."""
        return self.in_a_row > self._max

    def start(self) -> None:
        """Accept the initial state as good until a better one is known; call when the learner is ready."""
        if self._good is None:
            self.propose()
            self.accept()

    def propose(self) -> FloatArray | None:
        """Take the learner's state as candidate; returns its actor's parameters, None if there is no state yet."""
        self._candidate = self._learner.snapshot()
        return None if self._candidate is None else actor_parameters(self._candidate)

    def accept(self, best: bool = False) -> None:
        """Accept the candidate; `best`: it is better than any before."""
        if self._candidate is not None:
            self._good = self._candidate
            self._best = self._good if best else self._best
            self._learner.keep(self._good)
            self.in_a_row = 0

    @property
    def good(self) -> FloatArray | None:
        """Parameters of the last good actor; None before there is one."""
        return None if self._good is None else actor_parameters(self._good)

    @property
    def best(self) -> FloatArray | None:
        """Parameters of the best actor so far; before there is one, of the last good one."""
        return self.good if self._best is None else actor_parameters(self._best)

    def roll_back(self) -> FloatArray | None:
        """Roll back; returns the parameters of the actor that acts from now on, None if there never was a state."""
        self.in_a_row += 1
        if self._good is not None:
            self._learner.roll_back()
        return self.good
