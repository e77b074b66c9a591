# SPDX-License-Identifier: Apache-2.0
"""Supervision of the learner process by the acting process: start, requests, status, stop.

Calls block only in `stop`, and while the plant waits as well (`synchronous`).
"""

from __future__ import annotations

import select
import signal
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_core.errors import UserError
from hydro_core.signals import FloatArray
from hydro_policy.learner_process.learner import SPAWN_CONTEXT, LearnerFault, LearnerStatus, run_learner
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings

NICENESS = 10  # of a learner for which the plant does not wait
SETTLE_TIMEOUT = 60.0  # longest wait for a learner's due updates, s of wall clock
HANG_TIMEOUT = 60.0  # s without room for a request, after which a learner counts as hanging
STOP_TIMEOUT = 15.0  # s, for the last checkpoint


class LearnerError(UserError):
    """Fatal failure of the learner: it has died, hangs, cannot start, or cannot write a checkpoint."""


class LearnerSupervisor:
    """Supervisor of the learner process, which begins with the latest checkpoint of the run.

    `settings`: settings of the run. `run`: its folder. `appended`: number of transitions in that checkpoint.
    `real_time`: whether the plant does not wait for the learner, which then has a lower priority than the acting
    processes.
    """

    def __init__(
        self, settings: TrainingSettings, run: RunDirectory, appended: int = 0, *, real_time: bool = True
    ) -> None:
        self._settings, self._run, self.appended = settings, run, appended
        self.status = LearnerStatus()
        """Last status that has arrived."""
        self._niceness = NICENESS if real_time else 0
        self._rollbacks, self._seen = 0, (-1, 0)  # requested; updates and rollbacks of the weights returned last
        self._fault: LearnerFault | None = None
        self._outbox: deque[tuple[str, Any]] = deque()
        self._read_at = time.monotonic()  # when the learner last had room for a request, s
        self.synchronous = False
        """Whether the plant waits for the learner: then weights and checkpoints include all updates that are due."""
        self._start()

    @property
    def alive(self) -> bool:
        """Whether the learner process runs."""
        return self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """Process id of the learner."""
        return self._process.pid

    @property
    def ready(self) -> bool:
        """Whether the learner has sent weights."""
        self._receive()
        return self.status.actor is not None

    def append(self, row: NDArray[np.float32]) -> None:
        """Send a transition, a row of the replay buffer."""
        self.appended += 1
        self._send("append", row)

    def new_weights(self) -> FloatArray | None:
        """Return the actor's flat parameters if they are newer than at the last call, else None.

        Also None until a requested rollback is done: earlier weights must not act.
        """
        self._receive()
        status, news = self.status, (self.status.updates, self.status.rollbacks)
        if status.actor is None or not self._rolled_back or news == self._seen:
            return None
        self._seen = news
        return status.actor.astype(np.float64)

    @property
    def _rolled_back(self) -> bool:
        return self.status.rollbacks >= self._rollbacks

    def wait_for_updates(self) -> None:
        """If `synchronous`, wait until the learner has finished all updates and rollbacks that are due."""
        due = self._settings.updates_due(self.appended)
        self._await(lambda: self._rolled_back and self.status.updates >= due)

    def propose(self) -> FloatArray | None:
        """Make the learner's state the candidate; returns its actor's parameters, or None before the first weights."""
        self.wait_for_updates()
        self._receive()
        if self.status.actor is None:
            return None
        self._send("propose", self.status.updates)
        return self.status.actor.astype(np.float64)

    def accept(self, best: bool) -> None:
        """Make the candidate the last good agent, and if `best` the best so far."""
        self._send("accept", best)

    def roll_back(self) -> None:
        """Request a rollback of the learner to the last good agent."""
        self._rollbacks += 1
        self._send("roll back")

    def save(self, trainer: dict[str, Any]) -> None:
        """Request a checkpoint, written on return if `synchronous`."""
        self.wait_for_updates()
        wanted = self.status.checkpoints + 1
        self._send("save", trainer)
        self._await(lambda: self.status.checkpoints >= wanted)

    def check(self) -> None:
        """Raise LearnerError if the learner has ended, or cannot write a checkpoint."""
        self._receive()
        if self._fault is not None and self._fault.disk:
            raise self._unwritten()
        if self.alive:
            return
        code = self._process.exitcode
        how = self._fault.sentence if self._fault else f"killed by signal {-code}" if code and code < 0 else f"{code}"
        if self.status.actor is None:
            raise LearnerError(f"the learner cannot begin: {how}")
        raise LearnerError(
            f"the learner has ended ({how}): go on from its last checkpoint by --resume {self._run.path}"
        )

    def stop(self, trainer: dict[str, Any]) -> None:
        """Let the learner write the last checkpoint, and end it; one that hangs is killed.

        Raises LearnerError: the checkpoint cannot be written.
        """
        give_up = time.monotonic() + STOP_TIMEOUT
        with suppress(LearnerError):
            self._send("save", trainer)
            self._send("end")
            while self.alive and time.monotonic() < give_up:
                self._receive(0.05)
            self._receive()
        self._process.kill()
        self._process.join()
        if self._fault is not None and self._fault.disk:
            raise self._unwritten()

    def _receive(self, seconds: float = 0.0) -> None:
        """Receive what has arrived, and send what waits; waits `seconds` s for the first message."""
        self._flush()
        with suppress(OSError, EOFError):
            while self._pipe.poll(seconds):
                message = self._pipe.recv()
                if isinstance(message, LearnerFault):
                    self._fault = message
                else:
                    self.status = message
                seconds = 0.0

    def _await(self, done: Callable[[], bool]) -> None:
        """If `synchronous`, wait for `done`, at most a minute, and not for a learner that is starting or has ended."""
        give_up = time.monotonic() + SETTLE_TIMEOUT
        while self.synchronous and not done() and self.status.actor is not None and self._fault is None and self.alive:
            self._receive(0.05)
            if time.monotonic() > give_up:
                break

    def _send(self, request: str, argument: Any = None) -> None:
        self._outbox.append((request, argument))
        self._flush()

    def _flush(self) -> None:
        """Send what the pipe has room for; the rest waits, since a learner that writes a checkpoint does not read.

        Raises LearnerError: it has read nothing for `HANG_TIMEOUT`. One that has ended is the business of `check`.
        """
        room = select.poll()
        with suppress(OSError):
            room.register(self._pipe, select.POLLOUT)
            while self._outbox and room.poll(0):
                self._pipe.send(self._outbox.popleft())
                self._read_at = time.monotonic()
        if not self._outbox:
            self._read_at = time.monotonic()
        elif self.alive and time.monotonic() - self._read_at > HANG_TIMEOUT:
            raise LearnerError(f"the learner hangs: go on from its last checkpoint by --resume {self._run.path}")

    def _unwritten(self) -> LearnerError:
        why = self._fault.sentence if self._fault else ""
        return LearnerError(f"no checkpoint can be written ({why}): make room and use --resume {self._run.path}")

    def _start(self) -> None:
        self._pipe: Connection
        self._pipe, theirs = SPAWN_CONTEXT.Pipe()
        arguments = (self._settings, self._run, theirs, self._niceness)
        self._process: BaseProcess = SPAWN_CONTEXT.Process(
            target=run_learner, args=arguments, name="learner", daemon=True
        )
        # Ctrl-C and a hangup go to the whole terminal, and would meet the child importing, long before it can say that
        # it ignores them. A blocked signal is inherited; ours, if one comes now, waits. Where the resource tracker of
        # multiprocessing is first started it lets SIGINT through again: so that comes before.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
