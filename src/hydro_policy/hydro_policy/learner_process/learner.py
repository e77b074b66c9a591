# SPDX-License-Identifier: Apache-2.0
"""The learner process: draws from the shared replay buffer, updates, publishes its state, writes checkpoints.

::

    acting process                                           learner process
    transition   -> replay buffer -------------------------->  batches, updates
    policy       <- `latest`: counters, networks, moments <--  after each chunk of updates; a successor starts there
    good policy  -> `good`: the same ----------------------->  continues from there on a rollback
    rollbacks    <> `status`: requested, done; updates, temperature, losses
    requests     -> pipe: wake, save, end ------------------>  checkpoints; faults come back

All but the pipe are shared memory, so that nothing is lost when the learner dies.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_core.files.atomic import write_atomic
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings, save_checkpoint
from hydro_policy.sac.agent import Agent, Losses, ReplayBuffer, actor_parameters
from hydro_policy.sac.policy import Policy
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from hydro_sim.files.pairing import with_provenance

CHUNK_UPDATES = 8  # updates between two publications and polls of the pipe, some 1 to 2 ms

SPAWN_CONTEXT = multiprocessing.get_context("spawn")  # fork would corrupt the middleware's threads


class LatestValue:
    """Double buffer in shared memory for the newest int64 array, with one writer and any number of readers.

        [ version, to the end of its cache line | sum, value of the even versions | sum, value of the odd ones ]

    A writer killed halfway leaves the other value intact; the checksum detects a value read while it was written.

    `memory`: writable buffer of `nbytes` bytes, initially zero.
    """

    def __init__(self, memory: object) -> None:
        words = np.frombuffer(memory, np.int64)  # type: ignore[call-overload]
        self._version, self._slots = words[:8], words[8:].reshape(2, -1)
        self._seen = 0

    @staticmethod
    def nbytes(length: int) -> int:
        """Return the bytes needed for arrays of this length."""
        return 8 * (8 + 2 * (1 + length))

    def publish(self, value: NDArray[np.int64]) -> None:
        """Publish `value` as the newest array."""
        version = int(self._version[0]) + 1
        self._slots[version % 2, 1:], self._slots[version % 2, 0] = value, value.sum()
        self._version[0] = version

    def read(self) -> NDArray[np.int64] | None:
        """Return the newest intact array; None if there is none."""
        version = int(self._version[0])
        for each in range(version, max(version - 2, 0), -1):
            slot: NDArray[np.int64] = self._slots[each % 2].copy()
            if slot[1:].sum() == slot[0]:
                self._seen = version
                return slot[1:]
        return None

    @property
    def changed(self) -> bool:
        """Whether a newer array has been published since the last `read` of this object."""
        return bool(self._version[0] > self._seen)


_STATUS_FIELDS = ("updates", "alpha", "ready", "checkpoints", "rollbacks", "rollbacks_asked", *Losses._fields)
STATUS_DTYPE = np.dtype([(name, np.float64) for name in _STATUS_FIELDS])
"""Record of a learner's status: updates, alpha, 1 once weights are published, checkpoints written, rollbacks done and
requested (the latter written by the acting process), losses."""


class LearnerMemory:
    """Shared memory of acting and learner process; created by the acting process and passed to each learner."""

    def __init__(self, settings: TrainingSettings) -> None:
        self.capacity, length = settings.replay_capacity, len(new_agent(settings).state)
        self._replay = self._block(ReplayBuffer.nbytes(OBSERVATION_SIZE, ACTION_SIZE, self.capacity))
        self._latest, self._good = self._block(LatestValue.nbytes(length)), self._block(LatestValue.nbytes(length))
        self._status = self._block(STATUS_DTYPE.itemsize)

    def _block(self, size: int) -> Any:
        return SPAWN_CONTEXT.RawArray(ctypes.c_uint8, size)

    def open(self) -> tuple[ReplayBuffer, LatestValue, LatestValue, Any]:
        """Return replay buffer, latest and good `Sac.state`, and status (`STATUS_DTYPE`) for use in one process."""
        replay = ReplayBuffer(OBSERVATION_SIZE, ACTION_SIZE, self.capacity, self._replay)
        return replay, LatestValue(self._latest), LatestValue(self._good), np.frombuffer(self._status, STATUS_DTYPE)[0]


def new_agent(settings: TrainingSettings, blob: bytes | None = None) -> Agent:
    """Return a fresh agent, or the one of a file's content. Raises ValueError: as `Agent.restore`."""
    agent = Agent(OBSERVATION_SIZE, ACTION_SIZE, settings.sac)
    if blob is not None:
        agent.restore(blob)
    return agent


WAKE, END = "wake", "end"
"""Requests to the learner. WAKE: a transition was stored; without it an idle learner polls at intervals."""


@dataclass(frozen=True)
class SaveRequest:
    """Request to write a checkpoint; with `best`, the last good state is also saved as the best so far."""

    trainer: dict[str, Any]
    best: bool


@dataclass(frozen=True)
class LearnerFault:
    """Error reported by the learner: the reason why it ends, or why a checkpoint cannot be written."""

    sentence: str
    disk: bool = False


class Learner:
    """Learning loop: updates, publication, rollback, checkpoints; independent of the process."""

    def __init__(self, memory: LearnerMemory, settings: TrainingSettings, run: RunDirectory | None = None) -> None:
        from hydro_policy.sac.sac import Sac  # the acting process does without torch

        self.settings, self._run, self.sac = settings, run, Sac(OBSERVATION_SIZE, ACTION_SIZE, settings.sac)
        self.replay, self._latest, self._good, self._status = memory.open()
        start = self._latest.read()  # of a predecessor, or of a checkpoint
        if start is not None:
            self.sac.state[:] = start
        self.publish()

    @property
    def pending_updates(self) -> int:
        """Number of updates that are due for the transitions so far, and not done yet."""
        return self.settings.updates_due(self.replay.total_appended) - self.sac.updates

    def work(self) -> int:
        """Roll back if requested, perform up to `CHUNK_UPDATES` pending updates and publish; returns their number."""
        self._obey()
        count = min(self.pending_updates, CHUNK_UPDATES)
        if count > 0:
            self.sac.learn(self.replay, count)
            self.publish()
        return max(count, 0)

    def publish(self) -> None:
        """Publish the state, then the status, so that a reader of the update count finds its weights.

        Raises FloatingPointError: the networks hold NaN or infinity: nothing is published, the supervisor restarts from
        the last state.
        """
        sac, status = self.sac, self._status
        if not np.isfinite(sac.vectors["actor.parameters"].sum() + sac.vectors["critics.parameters"].sum()):
            raise FloatingPointError(f"the networks diverged at update {sac.updates}")
        self._latest.publish(sac.state)
        for name, loss in sac.losses._asdict().items():
            status[name] = loss
        status["alpha"], status["updates"], status["ready"] = sac.entropy_coefficient, sac.updates, 1.0

    def _obey(self) -> None:
        if self._status["rollbacks"] < self._status["rollbacks_asked"]:
            self.roll_back()

    def roll_back(self) -> None:
        """Restore the last good state; the update count is retained, or its updates would be due again.

        Transitions of the failed policy remain in the replay buffer, since they show its failure.
        """
        asked, good = self._status["rollbacks_asked"], self._good.read()
        if good is not None:
            updates = self.sac.updates
            self.sac.state[:] = good
            self.sac.updates = updates
        self.publish()
        self._status["rollbacks"] = asked  # last: a reader of the count finds the weights

    def save(self, request: SaveRequest) -> None:
        """Write the checkpoint and, if it has changed, the policy's file. Raises OSError: as `write_run`."""
        assert self._run is not None
        self._obey()
        best, good = None, self._good.read()
        if request.best and good is not None:
            kept = new_agent(self.settings)
            kept.state[:] = good
            best = kept.dump()
        write_run(self._run, self.settings, self.sac.dump(), self.replay, request.trainer, best)
        self._status["checkpoints"] += 1


def write_run(
    run: RunDirectory,
    settings: TrainingSettings,
    learner: bytes,
    replay: ReplayBuffer,
    trainer: dict[str, Any],
    best: bytes | None = None,
) -> None:
    """Write a checkpoint; policy.safetensors is the best policy so far or, before there is one, the latest.

    A deleted run folder is created again; its best policy is lost until a better one is found.

    Raises OSError: writing fails; the previous checkpoint is unchanged.
    """
    save_checkpoint(run.latest, with_provenance(learner, settings.made), replay, trainer)
    if trainer and not run.config.exists():
        run.save_settings(settings)
    if best is not None:
        run.best.mkdir(parents=True, exist_ok=True)
        write_atomic(run.best / "learner.safetensors", with_provenance(best, settings.made))
    if best is None and (run.best / "learner.safetensors").exists():
        return
    policy = Policy(settings.sac, settings.task.size)
    policy.load_flat(actor_parameters(best or learner))
    notes = {key: trainer.get(key) for key in ("episode", "total_steps", "last_rmse")}
    policy.save(run.policy, settings.task.gains, notes, settings.made)


def run_learner(
    memory: LearnerMemory, settings: TrainingSettings, run: RunDirectory, requests: Connection, niceness: int
) -> None:
    """Run the learner process; it ends on `END` from the pipe, or after the acting process has died."""
    for number in (signal.SIGINT, signal.SIGHUP):  # sent to the whole terminal; the acting process ends this one
        signal.signal(number, signal.SIG_IGN)
    os.nice(niceness)
    last: SaveRequest | None = None

    def save(request: SaveRequest) -> None:
        try:
            learner.save(request)
        except OSError as error:
            with suppress(OSError):
                requests.send(LearnerFault(error.strerror or str(error), disk=True))

    try:
        from hydro_policy.sac.sac import compile_update

        if sentence := compile_update(OBSERVATION_SIZE, ACTION_SIZE, settings.sac.hidden_size):
            print(sentence, file=sys.stderr)
        learner = Learner(memory, settings, run)  # ready from here on
        while True:
            worked = learner.work()
            while requests.poll(0.0 if worked else 0.05):
                request = requests.recv()
                if request == END:
                    return
                if request == WAKE:
                    break
                last = request
                save(request)
    except EOFError:  # the acting process died: save the agent
        if last is not None:
            save(last)
    except Exception as error:
        with suppress(OSError):
            requests.send(LearnerFault(str(error) or type(error).__name__))
        if isinstance(error, (FloatingPointError, ValueError)):  # the sentence is sufficient
            raise SystemExit(1) from None
        raise
