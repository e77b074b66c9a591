# SPDX-License-Identifier: Apache-2.0
"""The learner process: takes transitions, updates, sends its status, keeps the agents, writes checkpoints.

::

    acting process                       pipe                learner process
    transition            ---------------------------------> replay buffer, then the updates that are due
    policy                <--------------------------------- `LearnerStatus` after each chunk of updates
    propose, accept, roll back, save, end  ----------------> candidate, good and best agent; checkpoints
    error, which ends the run  <---------------------------- `LearnerFault`

It begins with the run's latest checkpoint. When it dies the run ends, and can be resumed from there.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections import deque
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_core.files.atomic import write_atomic
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings, load_checkpoint, save_checkpoint
from hydro_policy.sac.agent import Agent, Losses, ReplayBuffer, actor_parameters
from hydro_policy.sac.policy import Policy
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE
from hydro_sim.files.pairing import with_provenance

CHUNK_UPDATES = 8  # updates between two statuses, some 5 ms
RECENT_STATES = 64  # states, one a chunk, of which an earlier one can still be proposed

SPAWN_CONTEXT = multiprocessing.get_context("spawn")  # fork would corrupt the middleware's threads


@dataclass(frozen=True)
class LearnerStatus:
    """Status of the learner after a chunk of updates; float32 `actor` as in `Policy.load_flat`."""

    updates: int = 0
    alpha: float = float("nan")
    losses: Losses = field(default_factory=Losses)
    actor: NDArray[np.float32] | None = None
    rollbacks: int = 0  # done so far
    checkpoints: int = 0  # written since the start


@dataclass(frozen=True)
class LearnerFault:
    """Error that ends the run: why the learner ends, or why a checkpoint cannot be written (`disk`)."""

    sentence: str
    disk: bool = False


class Learner:
    """Learning loop of bench and simulation: updates, candidate, rollback, checkpoints; in any process.

    `start`: agent to begin with, as returned by `Agent.dump`; None: the checkpoint in `run`.
    """

    def __init__(self, settings: TrainingSettings, run: RunDirectory, start: bytes | None = None) -> None:
        from hydro_policy.sac.sac import Sac  # the acting process does without torch

        self.settings, self._run, self.sac = settings, run, Sac(OBSERVATION_SIZE, ACTION_SIZE, settings.sac)
        self.replay = ReplayBuffer(OBSERVATION_SIZE, ACTION_SIZE, settings.replay_capacity)
        self.acting_state: dict[str, Any] = {}
        """What the checkpoint holds of who acts; empty at the start."""
        if start is None:
            found = load_checkpoint(run.latest)
            self.replay.restore(found.replay, found.produced)
            start, self.acting_state = found.learner, found.trainer
        self.sac.restore(start)
        self._recent = deque([(self.sac.updates, self.sac.state.copy())], RECENT_STATES)
        self._candidate = self._good = self._recent[0][1]
        if (best := run.best / "learner.safetensors").is_file():
            self._good = _agent(settings, blob=best.read_bytes()).state
        self._new_best = False
        self._rollbacks = self._checkpoints = 0

    @property
    def pending_updates(self) -> int:
        """Number of updates that are due for the transitions so far, and not done yet."""
        return self.settings.updates_due(self.replay.total_appended) - self.sac.updates

    def work(self, most: int = CHUNK_UPDATES) -> bool:
        """Perform up to `most` pending updates; returns whether there were any.

        Raises FloatingPointError: the networks hold NaN or infinity.
        """
        count = min(self.pending_updates, most)
        if count <= 0:
            return False
        self.sac.learn(self.replay, count)
        if not np.isfinite(self.sac.vectors["actor.parameters"].sum() + self.sac.vectors["critics.parameters"].sum()):
            raise FloatingPointError(f"the networks diverged at update {self.sac.updates}")
        self._recent.append((self.sac.updates, self.sac.state.copy()))
        return True

    @property
    def status(self) -> LearnerStatus:
        """Present status."""
        return LearnerStatus(
            self.sac.updates, self.sac.entropy_coefficient, self.sac.losses,
            self.sac.vectors["actor.parameters"].copy(), self._rollbacks, self._checkpoints,
        )  # fmt: skip

    def handle(self, request: str, argument: Any = None) -> bool:
        """Carry out a request; returns whether the status changed.

        Requests are `append` (a row of the replay buffer), `propose` (the state after this number of updates becomes
        the candidate), `accept` (the candidate becomes the last good agent; whether it is the best so far, too),
        `roll back` (to the last good agent), and `save` (a checkpoint with this state of the acting process).

        Raises OSError: a checkpoint cannot be written.
        """
        match request:
            case "append":
                self.replay.extend(argument[np.newaxis])
            case "propose":
                found = (state for updates, state in reversed(self._recent) if updates == argument)
                self._candidate = next(found, self._recent[-1][1])
            case "accept":
                self._good, self._new_best = self._candidate, self._new_best or argument
            case "save":
                best = _agent(self.settings, state=self._good).dump() if self._new_best else None
                write_run(self._run, self.settings, self.sac.dump(), self.replay, argument, best)
                self._new_best, self._checkpoints = False, self._checkpoints + 1
            case (
                "roll back"
            ):  # the updates stay counted, or they would be due again; failed transitions show the failure
                updates, self.sac.state[:] = self.sac.updates, self._good
                self.sac.updates = updates
                self._recent.append((updates, self.sac.state.copy()))
                self._rollbacks += 1
        return request in ("save", "roll back")


def _agent(settings: TrainingSettings, blob: bytes | None = None, state: NDArray[np.int64] | None = None) -> Agent:
    agent = Agent(OBSERVATION_SIZE, ACTION_SIZE, settings.sac)
    if blob is not None:
        agent.restore(blob)
    if state is not None:
        agent.state[:] = state
    return agent


def write_run(
    run: RunDirectory,
    settings: TrainingSettings,
    learner: bytes,
    replay: ReplayBuffer,
    trainer: dict[str, Any],
    best: bytes | None = None,
) -> None:
    """Write a checkpoint; policy.safetensors is the best policy so far or, before there is one, the latest.

    `trainer`: state of who acts, as JSON types; its `notes` go into the policy's file.
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
    notes = {"task": asdict(settings.task), **trainer.get("notes", {})}
    policy.save(run.policy, settings.task.gains, notes, settings.made)


def run_learner(settings: TrainingSettings, run: RunDirectory, pipe: Connection, niceness: int) -> None:
    """Run the learner process; it ends on `END`, after an error, or after the acting process has died."""
    for number in (signal.SIGINT, signal.SIGHUP):  # sent to the whole terminal; the acting process ends this one
        signal.signal(number, signal.SIG_IGN)
    os.nice(niceness)
    last: Any = None  # state of the acting process in the last checkpoint
    try:
        from hydro_policy.sac.sac import compile_update

        if sentence := compile_update(OBSERVATION_SIZE, ACTION_SIZE, settings.sac.hidden_size):
            print(sentence, file=sys.stderr)
        learner = Learner(settings, run)
        pipe.send(learner.status)  # ready from here on
        while True:
            if learner.work():
                pipe.send(learner.status)
            while pipe.poll(0.0 if learner.pending_updates > 0 else None):
                request, argument = pipe.recv()
                if request == "end":
                    return
                last = argument if request == "save" else last
                if learner.handle(request, argument):
                    pipe.send(learner.status)
    except (EOFError, BrokenPipeError, ConnectionResetError):  # the acting process died: save the agent
        if last is not None:
            with suppress(OSError):
                learner.handle("save", last)
    except Exception as error:
        reason = (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
        with suppress(OSError):
            pipe.send(LearnerFault(reason, isinstance(error, OSError)))
        if isinstance(error, FloatingPointError | ValueError | OSError):  # the sentence is sufficient
            raise SystemExit(1) from None
        raise
