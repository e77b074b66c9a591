# SPDX-License-Identifier: Apache-2.0
"""Recordings of the study's cases, from the emulator's command line: the study needs no code of the truth plant."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import yaml
from cases import Case


def record(cases: Sequence[Case], folder: Path) -> dict[str, list[Path]]:
    """Write the recordings of all cases; returns the bags by case name, the held-out one last."""
    folder.mkdir(parents=True, exist_ok=True)
    jobs, bags = [], {}
    for case in cases:
        truth = folder / f"{case.name}.truth.yaml"
        truth.write_text(yaml.safe_dump(_truth(case)))
        bags[case.name] = []
        for k, segments in enumerate(case.schedules):
            schedule = folder / f"{case.name}.{k}.schedule.yaml"
            schedule.write_text(yaml.safe_dump({"segments": [dict(segment) for segment in segments]}))
            bag = folder / f"{case.name}.{k}"
            bags[case.name].append(bag)
            if not (bag / "metadata.yaml").exists():
                seed = case.seed % 10**6 + k
                jobs.append({"out": str(bag), "truth": str(truth), "schedule": str(schedule), "seed": seed})
    if jobs:
        batch = folder / "batch.yaml"
        batch.write_text(yaml.safe_dump({"jobs": jobs}))
        command = ["ros2", "run", "hydro_sim", "emulator", "--offline", "--batch", str(batch)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return bags


def _truth(case: Case) -> dict[str, object]:
    effects = {name: dict(values) for name, values in case.effects.items()}
    return {
        "profile": "nominal",
        "sensors": {"noise_scale": case.noise},
        "effects": effects,
        "outside": dict(case.outside),
    }
