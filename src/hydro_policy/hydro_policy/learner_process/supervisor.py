# SPDX-License-Identifier: Apache-2.0
"""Supervision of the learner process by the acting process: start, watch, restart, stop.

Calls block only in `stop`, and while the plant waits as well (`synchronous`).
"""

from __future__ import annotations

import select
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np

from hydro_core.errors import UserError
from hydro_core.signals import FloatArray
from hydro_policy.learner_process.learner import (
    END,
    SPAWN_CONTEXT,
    WAKE,
    LearnerFault,
    LearnerMemory,
    SaveRequest,
    new_agent,
    run_learner,
    write_run,
)
from hydro_policy.runs.run_directory import Checkpoint, RunDirectory, TrainingSettings
from hydro_policy.sac.agent import Losses

NICENESS = 10  # of a learner for which the plant does not wait
SETTLE_TIMEOUT = 60.0  # longest wait for a learner's due updates, s of wall clock
RESTARTS_MAX, RESTART_WINDOW = 5, 60.0  # more restarts than this within so many seconds are a systematic fault
STOP_TIMEOUT = 15.0  # s, for the last checkpoint
_POLL_PERIOD = 2e-4  # polling period of the learner's progress during a wait, s


class LearnerError(UserError):
    """Fatal failure of the learner: it dies repeatedly, cannot start, or cannot write a checkpoint."""


class LearnerSupervisor:
    """Supervisor of the learner: owns the shared memory and one learner process at a time.

    `settings`: settings of the run. `run`: folder of the checkpoints. `resumed`: checkpoint to resume, or None.
    `start`: initial agent, as returned by `Agent.dump`, or None: freshly initialised networks. `real_time`: whether the
    plant does not wait for the learner, which then has a lower priority than the acting processes.

    Raises ValueError: the agent of the checkpoint, or the initial one, is damaged or of another architecture.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        run: RunDirectory,
        resumed: Checkpoint | None = None,
        start: bytes | None = None,
        *,
        real_time: bool = True,
    ) -> None:
        self._settings, self._run = settings, run
        self._niceness = NICENESS if real_time else 0
        self._memory = LearnerMemory(settings)
        self.replay, self._latest, self._good, self._status = self._memory.open()
        for name in Losses._fields:
            self._status[name] = np.nan
        if resumed is not None:
            self.replay.restore(resumed.replay, resumed.produced)
            start = resumed.learner
        self._copy = new_agent(settings, start)  # as last read
        if start is not None:
            self._latest.publish(self._copy.state)
        self._deaths: list[float] = []  # times, s
        self.restarts = 0
        self.synchronous = False
        """Whether the plant waits for the learner: then reads and checkpoints include all updates that are due."""
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
        """Whether the present learner process has published weights."""
        return bool(self._status["ready"])

    @property
    def updates(self) -> int:
        """Number of gradient updates so far."""
        return int(self._status["updates"])

    @property
    def checkpoints(self) -> int:
        """Number of checkpoints written since the start."""
        return int(self._status["checkpoints"])

    @property
    def entropy_coefficient(self) -> float:
        """Entropy coefficient alpha."""
        return float(self._status["alpha"])

    @property
    def losses(self) -> Losses:
        """Losses of the last updates; NaN before the first."""
        return Losses(*(float(self._status[name]) for name in Losses._fields))

    def new_weights(self) -> FloatArray | None:
        """Return the actor's flat parameters if they are newer than at the last call, else None.

        Also None until a requested rollback is done: earlier weights must not act.
        """
        if not self._rolled_back or not self._latest.changed or not self._read():
            return None
        return self._copy.actor_parameters()

    @property
    def _rolled_back(self) -> bool:
        return bool(self._status["rollbacks"] >= self._status["rollbacks_asked"])

    def snapshot(self) -> bytes | None:
        """Return the learner's complete state, as `Agent.dump`; None before the first."""
        self.wait_for_updates()
        return self._copy.dump() if self._read() else None

    def _read(self) -> bool:
        state = self._latest.read()
        if state is not None:
            self._copy.state[:] = state
        return state is not None

    def wake(self) -> None:
        """Notify the learner of a stored transition."""
        self._ask(WAKE)

    def wait_for_updates(self) -> None:
        """If `synchronous`, wait until the learner has finished all updates and rollbacks that are due."""
        due = self._settings.updates_due(self.replay.total_appended)
        self._await(lambda: self._rolled_back and self.updates >= due)

    def _await(self, done: Callable[[], bool]) -> None:
        """If `synchronous`, wait for `done`, at most a minute, and not for a learner that is dead, starting, or failed.

        A learner that has failed has said so, which `restart_if_dead` reads.
        """
        give_up = time.monotonic() + SETTLE_TIMEOUT
        while self.synchronous and not done() and self._status["ready"] and time.monotonic() < give_up and self.alive:
            if self._requests.poll(_POLL_PERIOD):
                break

    def store_good_agent(self, good: bytes) -> None:
        """Store an agent, as returned by `Agent.dump`, as the last good state."""
        self._good.publish(new_agent(self._settings, good).state)

    def roll_back(self) -> None:
        """Request a rollback of the learner to the last good state."""
        self._status["rollbacks_asked"] += 1  # of this learner or its successor
        self.wake()

    def save(self, trainer: dict[str, Any], best: bool = False) -> bool:
        """Request a checkpoint, written on return if `synchronous`; returns False if the learner is not running."""
        self.wait_for_updates()
        wanted, asked = self.checkpoints + 1, self._ask(SaveRequest(trainer, best))
        if asked:
            self._await(lambda: self.checkpoints >= wanted)
        return asked

    def restart_if_dead(self) -> str | None:
        """Restart a dead learner from its last state; returns a message for the user, None if the learner runs.

        Raises LearnerError: it keeps dying, cannot start, or cannot write a checkpoint.
        """
        with suppress(OSError, EOFError):
            while self._requests.poll():
                fault: LearnerFault = self._requests.recv()
                if fault.disk:
                    raise self._unwritten(fault.sentence)
                self._said = fault.sentence
        if self.alive:
            return None
        if self._said and not self.ready:
            raise LearnerError(f"the learner cannot begin: {self._said}")
        code, now = self._process.exitcode, time.monotonic()
        how = f"killed by signal {-code}" if code is not None and code < 0 else self._said or f"exit code {code}"
        self._deaths = [*(death for death in self._deaths if now - death <= RESTART_WINDOW), now]
        if len(self._deaths) > RESTARTS_MAX:
            raise LearnerError(f"the learner died {len(self._deaths)} times within {RESTART_WINDOW:.0f} s ({how})")
        self.restarts += 1
        self._requests.close()
        self._start()
        return f"learner lost ({how}): it restarts from update {self.updates}"

    def stop(self, trainer: dict[str, Any]) -> None:
        """Write the last checkpoint and end the process; for a dead or hanging learner this process writes it.

        Raises LearnerError: the checkpoint cannot be written.
        """
        before = self.checkpoints
        asked = self._ask(SaveRequest(trainer, best=False), STOP_TIMEOUT) and self._ask(END, STOP_TIMEOUT)
        self._process.join(STOP_TIMEOUT if asked else 0.5)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self.checkpoints == before and self._read():
            try:
                write_run(self._run, self._settings, self._copy.dump(), self.replay, trainer)
            except OSError as error:
                raise self._unwritten(error.strerror or str(error)) from None

    def _ask(self, request: SaveRequest | str, patience: float = 0.0) -> bool:
        """Send a request; returns False if the learner is dead, or its pipe is full because it does not read.

        A writable pipe has room for any of the requests. `patience` in s.
        """
        room = select.poll()
        with suppress(OSError):
            room.register(self._requests, select.POLLOUT)
            if room.poll(round(1e3 * patience)):
                self._requests.send(request)
                return True
        return False

    def _unwritten(self, why: str) -> LearnerError:
        return LearnerError(f"no checkpoint can be written ({why}): make room and use --resume {self._run.path}")

    def _start(self) -> None:
        self._status["ready"] = 0.0
        self._said = ""  # by a learner that ends
        self._requests: Connection
        self._requests, theirs = SPAWN_CONTEXT.Pipe()
        # The arguments are small: more than the pipe to the child holds would wait for it.
        arguments = (self._memory, self._settings, self._run, theirs, self._niceness)
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
