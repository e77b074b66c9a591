# SPDX-License-Identifier: Apache-2.0
"""Lock-step: the next sample waits for the graph's answers to the last one.

::

    sample k ──> filter ──> correction for k ──┐
    10 samples ──> trainer ──> gains ──────────┴──> sample k + 1

A node that has not been heard yet is not waited for, nor is a trainer while the plant is disarmed. A node that falls
silent is named in the log, and the simulation continues without it until it returns.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from hydro_bridge.signals import SAMPLES_PER_STEP

RESEND = 0.25
"""Time [s] after which an unanswered sample is sent again: the state is published best effort."""


class LockStep:
    """Tracks which nodes have answered the last sample.

    Parameters
    ----------
    log
        Called with a sentence when a peer comes or falls silent.
    silence_max
        Longest wait [s] for a peer.
    correction_every
        Samples per correction, as the filter is set.
    """

    def __init__(self, log: Callable[[str], None], *, silence_max: float = 5.0, correction_every: int = 1) -> None:
        self._log, self._silence_max, self._correction_every = log, silence_max, correction_every
        self._news = threading.Condition()
        self._filter = self._trainer = self._released = False
        self._corrected = self._ungained = 0

    @property
    def engaged(self) -> bool:
        """Whether any node is waited for."""
        return self._filter or self._trainer

    def corrected(self, sequence: int) -> None:
        """Note that the filter has answered sample `sequence`."""
        with self._news:
            if not self._filter:
                self._log("in lock-step with the filter")
            self._filter, self._corrected = True, sequence
            self._news.notify_all()

    def gained(self) -> None:
        """Note that the trainer has sent gains."""
        with self._news:
            if not self._trainer:
                self._log("in lock-step with the trainer")
            self._trainer, self._ungained = True, 0
            self._news.notify_all()

    def release(self) -> None:
        """Let the present sample go without an answer: a caller in the answering thread waits for the next one."""
        with self._news:
            self._released = True
            self._news.notify_all()

    def wait(self, sequence: int, armed: bool, resend: Callable[[], None]) -> None:
        """Return when sample `sequence`, the last one published, has its answers."""
        give_up = time.monotonic() + self._silence_max
        self._ungained = self._ungained + 1 if armed else 0
        with self._news:
            while self.awaited(sequence) and not self._released:
                if self._news.wait(RESEND):
                    continue
                if time.monotonic() >= give_up:
                    self._go_on_without(sequence)
                else:
                    resend()
            self._released = False

    def awaited(self, sequence: int) -> list[str]:
        """Return the nodes that have yet to answer sample `sequence`."""
        behind = (sequence - self._corrected) & 0xFFFFFFFF
        uncorrected = self._filter and self._correction_every <= behind < 1 << 31
        return ["filter"] * uncorrected + ["trainer"] * (self._trainer and self._ungained >= SAMPLES_PER_STEP)

    def _go_on_without(self, sequence: int) -> None:
        silent = self.awaited(sequence)
        self._filter = self._filter and "filter" not in silent
        self._trainer = self._trainer and "trainer" not in silent
        sentence = f"no answer of the {' and '.join(silent)} to sample {sequence} for {self._silence_max:g} s"
        self._log(sentence + ": going on without until it is back")
