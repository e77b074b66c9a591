# SPDX-License-Identifier: Apache-2.0
"""Files of one training run, and its settings as YAML.

runs/NAME/
    config.yaml            settings, and which plant; `--resume` reads them back
    policy.safetensors     the best policy so far (`policy` module); before an examination: the latest
    checkpoints/latest/    learner.safetensors, replay.npy, trainer.json (`checkpoint` module)
    checkpoints/best/      learner.safetensors of the best policy so far: the complete agent, to start others from
    run.json               events: episodes, examinations, rollbacks, overrides (`record` module)
    bag/                   the recording
    evaluation.json, tracking.png, log.txt
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import yaml

from hydro_bridge.files.atomic import write_whole
from hydro_bridge.files.settings_file import from_mapping, read_yaml
from hydro_bridge.settings import SettingsError, check, quantity
from hydro_policy.sac.settings import SacSettings
from hydro_policy.supervision.monitor import MonitorSettings
from hydro_policy.task.cases import ExamSettings
from hydro_policy.task.mdp import BASE, TaskSettings
from hydro_sim.files.pairing import MadeFor


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """Settings of a training run: length, updates per step, buffer size and more."""

    episodes: Annotated[int, quantity("-", 1, 1e6)] = 160
    """Episodes of the run (paper: 160)."""
    updates_per_step: Annotated[float, quantity("-", 0.0, 100.0)] = 1.0
    """Gradient updates owed per policy step; the learner catches up in pauses."""
    warmup_steps: Annotated[int, quantity("-", 1, 1e6)] = 500
    """Policy steps before learning starts; they act with the initial, broad policy."""
    replay_capacity: Annotated[int, quantity("-", 65, 1e8)] = 288_000
    """Transitions remembered (the paper's whole training)."""
    seed: Annotated[int, quantity("-", 0, 9e15)] = 0
    """Seed of references and of exploration in the actor."""
    sac: SacSettings = field(default_factory=SacSettings)
    task: TaskSettings = field(default_factory=TaskSettings)
    exam: ExamSettings = field(default_factory=ExamSettings)
    monitor: MonitorSettings = field(default_factory=MonitorSettings)
    made: MadeFor | None = None
    """Which box its policies are for: what `--resume` is held to, and what goes into every file; None: not known."""

    @property
    def base_gains(self) -> tuple[float, float]:
        """K_p [1/s] and K_i [1/s^2] of the box, to which actions are added."""
        made = self.made
        if made is None or made.base_kp is None or made.base_ki is None:
            return BASE
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

    def create(self) -> RunDirectory:
        """Create the folders.

        Raises
        ------
        FileExistsError
            The folder already holds a run.
        """
        self.refuse_existing()
        for folder in (self.latest, self.best):
            folder.mkdir(parents=True, exist_ok=True)
        return self

    def refuse_existing(self) -> None:
        """Raise FileExistsError if the folder already holds a run."""
        if self.config.exists():
            raise FileExistsError(
                f"{self.path} holds a run already: continue it with --resume {self.path}, or name another"
            )

    def save_settings(self, settings: TrainingSettings, plant: Mapping[str, Any] | None = None) -> None:
        """Write config.yaml; `plant`: the run's original plant options, if known."""
        values = asdict(settings) | ({"plant": dict(plant)} if plant else {})
        write_whole(self.config, yaml.safe_dump(values, sort_keys=False).encode())

    def load_plant(self) -> dict[str, Any]:
        """Return the run's original plant options; empty if they were not saved."""
        try:
            values = yaml.safe_load(self.config.read_text())
        except (OSError, yaml.YAMLError):
            return {}
        plant = values.get("plant") if isinstance(values, dict) else None
        return plant if isinstance(plant, dict) else {}

    def load_settings(self) -> TrainingSettings:
        """Read config.yaml back.

        Raises
        ------
        ValueError
            The file is missing, or does not hold the settings of a run.
        """
        try:
            values = read_yaml(self.config)
            values.pop("plant", None)
            if not values:
                raise SettingsError("it is empty")
            return from_mapping(TrainingSettings, values, self.config.name)
        except ValueError as error:
            raise ValueError(f"{self.path} holds no run to resume: {error}") from error


def new_run(parent: Path, name: str | None) -> RunDirectory:
    """Return runs/NAME, by default named after date and time."""
    return RunDirectory(parent / (name or datetime.now().strftime("%Y%m%d-%H%M%S")))
