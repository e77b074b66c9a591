# SPDX-License-Identifier: Apache-2.0
"""Learner process: draws from the shared replay buffer, updates, publishes weights, writes checkpoints.

It shares five memory blocks and a pipe for requests with the acting process:

    replay     transitions              the actor appends, the learner draws
    weights    the actor's parameters   the learner publishes at some 50 Hz, the actor reads before each step
    snapshot   all of `Sac` (bytes)     the learner publishes twice a second; a successor starts from it
    good       the same bytes           stored by the actor; the learner returns to it on a rollback request
    status     a few float64            updates, temperature, ...
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import time
import zlib
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hydro_core.files.atomic import write_whole
from hydro_core.signals import FloatArray
from hydro_policy.runs.run import RunDirectory, TrainingSettings, save_checkpoint
from hydro_policy.sac.algorithm import Sac
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.replay import ReplayBuffer
from hydro_policy.sac.settings import SacSettings
from hydro_policy.sac.snapshot import actor_parameters, dump, restore
from hydro_policy.task.mdp import ACTIONS, OBSERVATIONS
from hydro_sim.files.pairing import with_provenance

_HEADER = 64
_SLOT_HEADER = 16


class SharedBlob:
    """Latest-value exchange of at most `capacity` bytes over a shared buffer (one writer, any number of readers).

    `memory`: writable buffer of `nbytes(capacity)` bytes, zero at first, mapped by all sides.
    """

    def __init__(self, memory: object) -> None:
        self._bytes = np.frombuffer(memory, np.uint8)  # type: ignore[call-overload]
        self._version = self._bytes[:8].view(np.int64)
        self.capacity = (len(self._bytes) - _HEADER) // 2 - _SLOT_HEADER
        self._seen = 0

    @staticmethod
    def nbytes(capacity: int) -> int:
        """Return the bytes needed for blobs of up to `capacity` bytes (rounded up to a multiple of eight)."""
        return _HEADER + 2 * (_SLOT_HEADER + (capacity + 7) // 8 * 8)

    def publish(self, blob: bytes) -> None:
        """Make `blob` the latest value. Raises ValueError: `blob` is longer than the capacity."""
        if len(blob) > self.capacity:
            raise ValueError(f"{len(blob)} bytes do not fit the {self.capacity} shared ones")
        version = int(self._version[0]) + 1
        slot = self._slot(version)
        slot[:_SLOT_HEADER].view(np.int64)[:] = len(blob), zlib.crc32(blob)
        slot[_SLOT_HEADER : _SLOT_HEADER + len(blob)] = np.frombuffer(blob, np.uint8)
        self._version[0] = version

    def read(self) -> bytes | None:
        """Return the latest value if it is newer than the last one read here, else None."""
        version = int(self._version[0])
        if version == self._seen:
            return None
        blob = self._copy(version)
        if blob is not None:
            self._seen = version
        return blob

    def latest(self) -> bytes | None:
        """Return the latest complete value, read before or not; None if there never was one."""
        version = int(self._version[0])
        for candidate in range(version, max(version - 2, 0), -1):  # a writer killed halfway leaves the other slot whole
            blob = self._copy(candidate)
            if blob is not None:
                return blob
        return None

    def _slot(self, version: int) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
        size = _SLOT_HEADER + self.capacity
        start = _HEADER + (version % 2) * size
        return self._bytes[start : start + size]

    def _copy(self, version: int) -> bytes | None:
        slot = self._slot(version)
        length, checksum = (int(v) for v in slot[:_SLOT_HEADER].view(np.int64))
        blob = slot[_SLOT_HEADER : _SLOT_HEADER + min(max(length, 0), self.capacity)].tobytes()
        return blob if length > 0 and zlib.crc32(blob) == checksum else None


SNAPSHOT_PERIOD = 0.5  # s
_CONTEXT = multiprocessing.get_context("spawn")
WAKE = "work"
"""Sent once a transition is stored: an idle learner looks for work only now and then."""
_IDLE = 0.05  # s
CHUNK = 8  # updates between two checks of the pipe and publications, some 1 to 2 ms


class LearnerMemory:
    """Shared memory of both processes; created by the acting process and passed to each learner."""

    def __init__(self, settings: TrainingSettings) -> None:
        self.capacity = settings.replay_capacity
        hidden = settings.sac.hidden_size
        parameters = 4 * (2 * (OBSERVATIONS + 8) * hidden + 2 * hidden * hidden + 64)  # bytes per network, upper bound

        self._replay = self._block(ReplayBuffer.nbytes(OBSERVATIONS, ACTIONS, self.capacity))
        self._weights = self._block(SharedBlob.nbytes(parameters))
        self._snapshot = self._block(SharedBlob.nbytes(16 * parameters + 16384))
        self._good = self._block(SharedBlob.nbytes(16 * parameters + 16384))
        self._status = self._block(72)

    def _block(self, size: int) -> Any:
        return _CONTEXT.RawArray(ctypes.c_uint8, size)

    def open(self) -> tuple[ReplayBuffer, SharedBlob, SharedBlob, SharedBlob, FloatArray]:
        """Return the blocks for use in one process: replay, weights, snapshot, good, status.

        weights: the actor's flat parameters, float32; snapshot, good: as returned by `snapshot.dump`; status: [updates,
        entropy coefficient, checkpoints written, 1 when ready, rollbacks done, snapshots on request, the three losses].
        """
        replay = ReplayBuffer(OBSERVATIONS, ACTIONS, self.capacity, self._replay)
        weights, snapshot, good = map(SharedBlob, (self._weights, self._snapshot, self._good))
        return replay, weights, snapshot, good, np.frombuffer(self._status, np.float64)


UPDATES, ENTROPY, CHECKPOINTS, READY, ROLLBACKS, SNAPSHOTS = range(6)  # places in status
LOSSES = slice(6, 9)  # as `hydro_policy.sac.algorithm.Losses`


@dataclass(frozen=True)
class RollbackRequest:
    """Request to restore the last good state."""


@dataclass(frozen=True)
class SnapshotRequest:
    """Request to publish a snapshot of the present state."""


@dataclass(frozen=True)
class LearnerFault:
    """Error reported by the learner: the reason why it ends, or why a checkpoint cannot be written."""

    sentence: str
    disk: bool = False


@dataclass(frozen=True)
class SaveRequest:
    """Request to write a checkpoint; with `best`, the last good state is also saved as the best so far."""

    run: Path
    trainer: dict[str, Any]
    best: bool


def updates_due(settings: TrainingSettings, transitions: int) -> int:
    """Return the updates that are due after so many transitions."""
    return int(settings.updates_per_step * max(transitions - settings.warmup_steps, 0))


class Learner:
    """State of the learning loop, independent of the process."""

    def __init__(self, memory: LearnerMemory, settings: TrainingSettings) -> None:
        self.settings = settings
        self.sac = Sac(OBSERVATIONS, ACTIONS, settings.sac)
        self.replay, self._weights, self._snapshot, self._good, self._status = memory.open()
        start = self._snapshot.latest()  # of a predecessor, or of a checkpoint
        if start is not None:
            restore(self.sac, start)
        self._published = 0.0
        self.publish(time.monotonic())

    @property
    def pending_updates(self) -> int:
        """Updates that are due for the transitions so far and not done yet."""
        return updates_due(self.settings, self.replay.produced) - self.sac.updates

    def work(self) -> int:
        """Perform up to `CHUNK` of the pending updates; returns how many were done."""
        count = min(self.pending_updates, CHUNK)
        if count > 0:
            self.sac.learn(self.replay, count)
        return max(count, 0)

    def publish(self, now: float) -> None:
        """Publish the actor's weights and, twice a second, the snapshot for a successor.

        Raises FloatingPointError: the networks hold NaN or infinity: nothing is published, the supervisor restarts from
        the last snapshot.
        """
        if not torch.isfinite(self.sac.actor_network.parameters.sum() + self.sac.critics.parameters.sum()):
            raise FloatingPointError(f"the networks diverged at update {self.sac.updates}")
        self._weights.publish(self.sac.actor_network.parameters.numpy().tobytes())
        self._status[LOSSES] = self.sac.losses
        self._status[UPDATES], self._status[ENTROPY] = self.sac.updates, self.sac.entropy_coefficient
        if now - self._published >= SNAPSHOT_PERIOD:
            self._snapshot.publish(dump(self.sac))
            self._published = now
        self._status[READY] = 1.0

    def publish_snapshot(self) -> None:
        """Publish the snapshot of the present state."""
        self._snapshot.publish(dump(self.sac))
        self._published = time.monotonic()
        self._status[SNAPSHOTS] += 1

    def roll_back(self) -> None:
        """Continue from the last good state; the updates done stay counted, or they would be due again.

        Transitions of the failed policy stay in the replay buffer: they are what there is to learn from.
        """
        good = self._good.latest()
        if good is not None:
            updates = self.sac.updates
            restore(self.sac, good)
            self.sac.updates = updates
        self._published = 0.0  # a successor must start from here as well
        self.publish(time.monotonic())
        self._status[ROLLBACKS] += 1  # last: a reader that sees the count finds the weights

    def save(self, request: SaveRequest) -> None:
        """Write the checkpoint and, if it has changed, the policy's file."""
        write_run(request, dump(self.sac), self._good.latest(), self.replay, self.settings)
        self._status[CHECKPOINTS] += 1


def write_run(
    request: SaveRequest, learner: bytes, good: bytes | None, replay: ReplayBuffer, settings: TrainingSettings
) -> None:
    """Write a checkpoint; policy.safetensors is the best policy so far or, before there is one, the latest.

    A deleted run folder is created again; its best policy is lost until a better one is found.

    Raises OSError: writing fails; the previous checkpoint is unchanged.
    """
    run = RunDirectory(request.run)
    save_checkpoint(run.latest, with_provenance(learner, settings.made), replay, request.trainer)
    if request.trainer and not run.config.exists():
        run.save_settings(settings)
    best = good if request.best else None
    if best is not None:
        run.best.mkdir(parents=True, exist_ok=True)
        write_whole(run.best / "learner.safetensors", with_provenance(best, settings.made))
    if best is None and (run.best / "learner.safetensors").exists():
        return
    policy = Policy(settings.sac, settings.task.size)
    policy.load_flat(actor_parameters(best or learner))
    notes = {key: request.trainer.get(key) for key in ("episode", "total_steps", "last_rmse")}
    policy.save(run.policy, settings.task.gains, notes, settings.made)


def compile_updates(settings: SacSettings) -> None:
    """Compile the updates through one update of a temporary learner, so that learning starts with the first episode."""
    replay = ReplayBuffer(OBSERVATIONS, ACTIONS, 2 * settings.batch_size + 128)
    replay.extend(np.zeros((settings.batch_size, replay.rows.shape[1]), np.float32))
    Sac(OBSERVATIONS, ACTIONS, settings).learn(replay, 1)


def run_learner(memory: LearnerMemory, settings: TrainingSettings, requests: Connection, niceness: int) -> None:
    """Run the learner process; it ends on None from the pipe, or when the acting process is gone."""
    for number in (signal.SIGINT, signal.SIGHUP):  # sent to the whole terminal; the acting process ends this one
        signal.signal(number, signal.SIG_IGN)
    os.nice(niceness)
    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    try:
        compile_updates(settings.sac)
        learner = Learner(memory, settings)  # ready from here on
        _attend(learner, requests)
    except Exception as error:
        with suppress(OSError):
            requests.send(LearnerFault(str(error) or type(error).__name__))
        if isinstance(error, (FloatingPointError, ValueError)):  # the sentence is sufficient
            raise SystemExit(1) from None
        raise


def _attend(learner: Learner, requests: Connection) -> None:
    """Learn and serve requests until the end."""
    last: SaveRequest | None = None
    while True:
        worked = learner.work()
        if worked:
            learner.publish(time.monotonic())
        try:
            while requests.poll(0.0 if worked else _IDLE):
                request = requests.recv()
                if request is None:
                    return
                if request == WAKE:
                    break
                if isinstance(request, RollbackRequest):
                    learner.roll_back()
                elif isinstance(request, SnapshotRequest):
                    learner.publish_snapshot()
                else:
                    last = request
                    _save(learner, request, requests)
        except EOFError:  # the acting process died: save what was learnt
            if last is not None:
                _save(learner, last, requests)
            return


def _save(learner: Learner, request: SaveRequest, requests: Connection) -> None:
    try:
        learner.save(request)
    except OSError as error:
        with suppress(OSError):
            requests.send(LearnerFault(error.strerror or str(error), disk=True))
