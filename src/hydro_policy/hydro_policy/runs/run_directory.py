# SPDX-License-Identifier: Apache-2.0
"""A training run on disk: settings as YAML, record of events, checkpoints.

runs/NAME/
    config.yaml            settings, and which plant; `--resume` reads them back
    policy.safetensors     the best policy so far (`policy` module); before an examination: the latest
    checkpoints/latest/    learner.safetensors   networks, optimizers, temperature (`Agent.dump`)
                           replay.npy            stored transitions, oldest first
                           trainer.json          count of all ever stored; episode, steps, random states, best episode
    checkpoints/best/      learner.safetensors of the best policy so far: the complete agent, to start others from
    run.json               {"events": [{"time": ISO 8601, "kind": KIND, "sentence": ..., further values by name}, ...]},
                           KIND is start, episode, exam, stop, override, grid, trial (of a comparison, as
                           evaluation.json), end or digest; a resumed run appends
    bag/                   the recording
    evaluation.json, tracking.png, log.txt

A checkpoint is written into a temporary folder and renamed, so that an interrupted writer leaves the previous one.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hydro_core.files.atomic import encode_json, fsync_folder, write_atomic
from hydro_core.files.tensors import check_finite
from hydro_core.settings import SettingsError, check, from_mapping, quantity, read_yaml
from hydro_policy.sac.settings import SacSettings
from hydro_policy.supervision.monitor import MonitorSettings
from hydro_policy.task.cases import ExamSettings
from hydro_policy.task.mdp import BASE_GAINS, TaskSettings
from hydro_sim.files.pairing import Provenance

if TYPE_CHECKING:
    from hydro_policy.sac.agent import ReplayBuffer


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """Settings of a training run: length, updates per step, buffer size and more."""

    episodes: Annotated[int, quantity("-", 1, 1e6, "Episodes of the run (paper: 160)")] = 160
    updates_per_step: Annotated[float, quantity("-", 0.0, 100.0, "Gradient updates owed per policy step")] = 1.0
    learning_starts: Annotated[
        int, quantity("-", 1, 1e6, "Policy steps by the initial, broad policy before learning starts, an episode")
    ] = 1800
    replay_capacity: Annotated[int, quantity("-", 65, 1e8, "Transitions stored (the paper's whole training)")] = 288_000
    seed: Annotated[int, quantity("-", 0, 9e15, "Seed of references and of exploration in the actor")] = 0
    sac: SacSettings = field(default_factory=SacSettings)
    task: TaskSettings = field(default_factory=TaskSettings)
    exam: ExamSettings = field(default_factory=ExamSettings)
    monitor: MonitorSettings = field(default_factory=MonitorSettings)
    made: Provenance | None = None
    """Which box its policies are for: what `--resume` is held to, and what goes into every file; None: not known."""

    def updates_due(self, transitions: int) -> int:
        """Return the number of updates that are due after a number of transitions."""
        return int(self.updates_per_step * max(transitions - self.learning_starts, 0))

    @property
    def base_gains(self) -> tuple[float, float]:
        """Base gains K_p [1/s] and K_i [1/s^2] of the box, to which the policy's gain changes are added."""
        made = self.made
        if made is None or made.base_kp is None or made.base_ki is None:
            return BASE_GAINS
        return made.base_kp, made.base_ki

    def __post_init__(self) -> None:
        for part in (self, self.sac, self.task, self.task.gains, self.exam, self.monitor):
            check(part)


@dataclass(frozen=True)
class RunDirectory:
    """Paths of a run's files."""

    path: Path

    config = property(lambda self: self.path / "config.yaml")
    policy = property(lambda self: self.path / "policy.safetensors")
    latest = property(lambda self: self.path / "checkpoints" / "latest")
    best = property(lambda self: self.path / "checkpoints" / "best")
    record = property(lambda self: self.path / "run.json")
    bag = property(lambda self: self.path / "bag")
    evaluation = property(lambda self: self.path / "evaluation.json")
    tracking_plot = property(lambda self: self.path / "tracking.png")
    learning_curve = property(lambda self: self.path / "learning.png")
    page = property(lambda self: self.path / "report.html")
    log = property(lambda self: self.path / "log.txt")

    @property
    def recordings(self) -> list[Path]:
        """Folders of the run's recordings, those of resumptions last."""
        later = sorted(self.path.glob(f"{self.bag.name}-*"), key=lambda folder: int(folder.name.rpartition("-")[2]))
        return [folder for folder in (self.bag, *later) if folder.exists()]

    @property
    def next_recording(self) -> Path:
        """Folder of the next recording: a resumed run gets a separate one."""
        made = self.recordings
        last = int(made[-1].name.partition("-")[2] or 1) if made else 0
        return self.bag.with_name(f"{self.bag.name}-{last + 1}") if last else self.bag

    def create(self) -> RunDirectory:
        """Create the folders. Raises FileExistsError: the folder already holds a run."""
        self.refuse_existing()
        for folder in (self.latest, self.best):
            folder.mkdir(parents=True, exist_ok=True)
        return self

    def refuse_existing(self) -> None:
        """Raise FileExistsError if the folder already holds a run."""
        if self.config.exists():
            raise FileExistsError(f"{self.path} holds a run already: name another, or --resume {self.path}")

    def save_settings(self, settings: TrainingSettings, plant: Mapping[str, Any] | None = None) -> None:
        """Write config.yaml; `plant`: the run's original plant options, if known."""
        values = asdict(settings) | ({"plant": dict(plant)} if plant else {})
        write_atomic(self.config, yaml.safe_dump(values, sort_keys=False).encode())

    def load_settings(self) -> TrainingSettings:
        """Read config.yaml back. Raises ValueError: the file is missing, or does not hold the settings of a run."""
        try:
            values = read_yaml(self.config)
            values.pop("plant", None)
            if not values:
                raise SettingsError("it is empty")
            return from_mapping(TrainingSettings, values, self.config.name)
        except ValueError as error:
            raise ValueError(f"{self.path} holds no run to resume: {error}") from error


@dataclass
class Scalars:
    """Scalar results of a run as TensorBoard event files; `tensorboard --logdir runs` compares runs."""

    folder: Path
    """Folder of the run; the files are in its subfolder `tensorboard`. A resumed run adds another file."""
    _writer: Any = None

    def add(self, kind: str, numbers: Mapping[str, Any]) -> None:
        """Write each finite number as scalar `kind/name` at step `episode`, a list as `kind/name_0` and so on."""
        unused = "torch" not in sys.modules
        if unused:
            sys.modules["torch"] = None  # type: ignore[assignment]  # tensorboardX would import it, for seconds
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto.event_pb2 import Event
        from tensorboardX.summary import scalar

        if unused:
            del sys.modules["torch"]
        if self._writer is None:  # its own SummaryWriter loses what waits in its queue at the end of the process
            (self.folder / "tensorboard").mkdir(parents=True, exist_ok=True)
            self._writer = EventsWriter(str(self.folder / "tensorboard" / "events"))
        tagged: dict[str, Any] = {}
        for name, value in numbers.items():
            several = isinstance(value, (list, tuple))
            tagged |= {f"{name}_{n}": one for n, one in enumerate(value)} if several else {name: value}
        step = tagged.pop("episode")
        for tag, value in tagged.items():
            if isinstance(value, (int, float)) and math.isfinite(value):
                summary = scalar(f"{kind}/{tag}", float(value))
                self._writer.write_event(Event(wall_time=time.time(), step=step, summary=summary))
        self._writer.flush()


class RunRecord:
    """Record of a run's events, saved after each to run.json.

    `path`: path of run.json; None: in memory only.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._scalars = None if path is None else Scalars(path.parent)
        self._writer = ThreadPoolExecutor(max_workers=1)  # a busy disk must not delay gains
        self._written: Future[None] = Future()
        self._written.set_result(None)
        self.events: list[dict[str, Any]] = []
        if path is not None and path.exists():
            self.events = list(json.loads(path.read_text(encoding="utf-8"))["events"])

    def add(self, kind: str, sentence: str = "", **numbers: Any) -> None:
        """Add an event at the present time; non-finite values become null."""
        event = {"time": datetime.now().astimezone().isoformat(timespec="milliseconds"), "kind": kind}
        if sentence:
            event["sentence"] = sentence
        self.events.append(event | json.loads(encode_json(numbers)))
        if self._path is not None:
            if self._written.done():
                self._written.result()  # raises a write error
            if self._scalars is not None and "episode" in numbers:
                self._writer.submit(self._scalars.add, kind, numbers)
            self._written = self._writer.submit(self._write, self._path, tuple(self.events))

    @staticmethod
    def _write(path: Path, events: Sequence[Mapping[str, Any]]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)  # the folder may have been deleted
        write_atomic(path, encode_json({"events": events}))

    def events_of(self, kind: str) -> list[dict[str, Any]]:
        """Return all events of a kind."""
        return [event for event in self.events if event["kind"] == kind]

    def events_of_interrupted(self, kind: str) -> list[dict[str, Any]]:
        """Return the events of a kind of an interrupted comparison: those since the last training or complete end."""
        events, trained = self.events, ("episode", "exam", "stop")
        over = (n + 1 for n, one in enumerate(events) if one["kind"] in trained or one.get("complete"))
        return [event for event in events[max(over, default=0) :] if event["kind"] == kind]

    def flush(self) -> None:
        """Wait until all events are on disk; the end of the process waits as well.

        Raises OSError: the file cannot be written.
        """
        self._written.result()


@dataclass(frozen=True)
class Checkpoint:
    """Checkpoint: agent (`Agent.dump`), stored transitions [n, width], count of all ever stored, acting state."""

    learner: bytes
    replay: NDArray[np.float32]
    produced: int
    trainer: dict[str, Any]


def save_checkpoint(folder: Path, learner: bytes, replay: ReplayBuffer, trainer: dict[str, Any]) -> None:
    """Write a checkpoint to `folder`, replacing the one there only once it is complete on disk.

    Raises OSError: the checkpoint cannot be written; the previous one is unchanged.
    """
    partial, previous = folder.with_name(folder.name + ".partial"), folder.with_name(folder.name + ".previous")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        rows, produced = replay.snapshot()
        with (partial / "replay.npy").open("wb") as file:
            np.save(file, rows)
            file.flush()
            os.fsync(file.fileno())
        write_atomic(partial / "learner.safetensors", learner)
        state = {"produced": produced, "trainer": trainer}
        write_atomic(partial / "trainer.json", json.dumps(state, indent=1).encode())
    except OSError:  # full disk: the partial checkpoint takes space that others need
        shutil.rmtree(partial, ignore_errors=True)
        raise
    shutil.rmtree(previous, ignore_errors=True)
    if folder.exists():
        folder.rename(previous)
    partial.rename(folder)
    fsync_folder(folder.parent)
    shutil.rmtree(previous, ignore_errors=True)


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read a checkpoint, or the previous one if the writer died between the two renames.

    Raises ValueError: there is no checkpoint, or it is damaged.
    """
    previous = folder.with_name(folder.name + ".previous")
    source = previous if not (folder / "trainer.json").exists() and previous.exists() else folder
    try:
        state = json.loads((source / "trainer.json").read_text())
        rows = np.load(source / "replay.npy", allow_pickle=False)
        check_finite({"replay.npy": rows})
        return Checkpoint((source / "learner.safetensors").read_bytes(), rows, int(state["produced"]), state["trainer"])
    except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder} holds no readable checkpoint: {error}") from error
