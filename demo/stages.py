# SPDX-License-Identifier: Apache-2.0
"""The stages of the story, each an executable: what is finished already is not done again."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from hydro_core.cli.console import UserError
from hydro_diagnosis import jobs
from hydro_sim.model.bench import Bench

DRIVES: tuple[Mapping[str, Any], ...] = (
    {"seconds": 20, "waveform": "multisine", "amplitude": 260, "frequency": 0.7, "kp": 60, "ki": 10},
    {"seconds": 20, "waveform": "smooth_step", "amplitude": 240, "frequency": 0.8, "kp": 45, "ki": 8},
    {"seconds": 20, "waveform": "sine", "amplitude": 250, "offset": 20, "frequency": 1.1, "kp": 60, "ki": 10},
)
"""What the bench is driven by for the recordings: careful fixed gains; the last one is held out."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to do."""

    folder: Path
    """Where everything goes; what is there already is kept."""
    truth: Path
    """The bench, as a truth.yaml of the emulator."""
    seeds: int = 3
    """Policies trained in either simulation."""
    episodes: int = 64
    """Of each training."""
    configuration: str = "wide"
    """What policies may do: `wide`, K_p up to 300, or `paper`, K_p up to 90 (training.md)."""
    jobs: int = 2
    """Trainings side by side."""

    @property
    def believed(self) -> Path:
        """bench.yaml of the simulation at the beginning."""
        return self.folder / "believed.yaml"

    @property
    def corrected(self) -> Path:
        """What the diagnosis makes of it."""
        return self.folder / "diagnosis" / "corrected.yaml"

    def policies(self, name: str) -> list[Path]:
        """Runs of the trainings called `name`, one per seed."""
        return [self.folder / f"{name}-{seed}" for seed in range(self.seeds)]


def believed_bench() -> Bench:
    """The nominal bench, but for the load cell's amplifier: what somebody without a data sheet would simulate."""
    return replace(Bench.nominal(), load_cell_bandwidth=None)


def believe(plan: Plan) -> None:
    """Write believed.yaml."""
    plan.folder.mkdir(parents=True, exist_ok=True)
    content = yaml.safe_dump(believed_bench().to_mapping(), sort_keys=False)
    plan.believed.write_text(content, encoding="utf-8")


def pretrain(plan: Plan, name: str, bench: Path) -> None:
    """Policies trained in a simulation of `bench`."""
    commands = {}
    for seed, run in enumerate(plan.policies(name)):
        if (run / "curve.json").exists():
            continue
        where = ["--resume", str(run)] if (run / "config.yaml").exists() else ["--out", str(run)]
        simulated = ["--model", str(bench), "--box", str(plan.believed), "--configuration", plan.configuration]
        how = ["--episodes", str(plan.episodes), "--seed", str(seed)]
        arguments = where if where[0] == "--resume" else [*where, *simulated, *how]
        commands[run.name] = (["hydro_policy", "pretrain", *arguments, "--json", str(run / "curve.json")],)
    jobs.run_all(_run, commands, processes=plan.jobs, label=name, unit="training")


def record(plan: Plan) -> list[Path]:
    """Recordings of the bench under careful fixed gains; the last one is to be held out."""
    folder = plan.folder / "recordings"
    folder.mkdir(exist_ok=True)
    bags = [folder / f"run{k}" for k in range(len(DRIVES))]
    for k, drive in enumerate(DRIVES):
        schedule = folder / f"schedule{k}.yaml"
        schedule.write_text(yaml.safe_dump({"segments": [dict(drive)]}), encoding="utf-8")
        if not (bags[k] / "metadata.yaml").exists():
            bench = ["--truth", str(plan.truth), "--bench", str(plan.believed), "--seed", str(100 + k)]
            words = ["--offline", "--out", str(bags[k]), "--schedule", str(schedule), *bench]
            _run(["hydro_sim", "emulator", *words])
    return bags


def diagnose(plan: Plan, bags: Sequence[Path]) -> dict[str, Any]:
    """The diagnosis of the recordings against the believed bench: report.json."""
    out = plan.folder / "diagnosis"
    if not plan.corrected.exists():
        fitted, held = [str(bag) for bag in bags[:-1]], str(bags[-1])
        words = [*fitted, "--holdout", held, "--bench", str(plan.believed), "--out", str(out)]
        _run(["hydro_diagnosis", "diagnose", *words])
    report: dict[str, Any] = json.loads((out / "report.json").read_text(encoding="utf-8"))
    return report


def _run(words: Sequence[str]) -> None:
    """`ros2 run` with its own words on the terminal; its table, which the story does not need, is swallowed."""
    ended = subprocess.run(["ros2", "run", *words], stdout=subprocess.DEVNULL, check=False)
    if ended.returncode:
        raise UserError(
            f"`ros2 run {' '.join(words[:2])}` ended with status {ended.returncode}; run demo again to go on"
        )
    sys.stderr.flush()
