# SPDX-License-Identifier: Apache-2.0
"""Recordings of the cases by the emulator's command, in separate processes: no code of the truth plant is needed.

The truth is written to a temporary folder, which is deleted before any diagnosis begins. A run that cannot be used is
recorded again as an operator would (`retake`); that decision knows only the recording.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from joblib import Parallel, delayed
from tqdm import tqdm

from hydro_bridge.cli.console import UserError, progress
from hydro_diagnosis.blind_benchmark.cases import FITTED, HELD, Case
from hydro_diagnosis.blind_benchmark.retake import ATTEMPTS, Attempt, usable

SLICE = 8
"""Cases that one process of the emulator records."""


Run = tuple[Case, str]
"""A case and the name of a recording."""


def record(cases: Sequence[Case], folder: Path, workers: int, until: float) -> bool:
    """Record the missing runs of `cases` into `folder`/CASE/{run1, run2, run3, held}, side by side.

    Returns
    -------
    False if `until`, a time of `time.monotonic`, came before the end.
    """
    missing = [case for case in cases if not all(whole(folder / case.name / name) for name in (*FITTED, HELD))]
    slices = [missing[at : at + SLICE] for at in range(0, len(missing), SLICE)]
    bar: tqdm[Any] = progress(total=len(missing), label="recording", unit="case")
    with bar:
        tasks = (delayed(_record)(part, folder, until) for part in slices)
        done = 0
        for count in Parallel(workers, prefer="threads", return_as="generator_unordered")(tasks):
            done += count
            bar.update(count)
    return done == len(missing)


def _record(cases: Sequence[Case], folder: Path, until: float) -> int:
    """Record one slice; return the number of cases recorded, 0 once time is up."""
    if time.monotonic() > until:
        return 0
    runs = [(case, name) for case in cases for name in (*FITTED, HELD) if not whole(folder / case.name / name)]
    left = runs
    for attempt in ATTEMPTS:
        _play(left, attempt, folder)
        left = [(case, name) for case, name in left if not usable(fresh(folder / case.name / name))]
    for case, name in runs:
        fresh(folder / case.name / name).rename(folder / case.name / name)
    return len(cases)


def _play(runs: Sequence[Run], attempt: Attempt, folder: Path) -> None:
    """Record runs, each as `fresh`, in one process."""
    if not runs:
        return
    with tempfile.TemporaryDirectory(prefix="hydro-truth-") as scratch:
        jobs = []
        for case, name in runs:
            out = clear(folder / case.name / name)
            paths = written(case, name, attempt, Path(scratch))
            jobs.append({"out": str(out), "seed": run_seed(case, name), **paths})
        batch = Path(scratch) / "batch.yaml"
        batch.write_text(yaml.safe_dump({"jobs": jobs}), encoding="utf-8")
        run_emulator(["--offline", "--batch", str(batch)])


def fresh(bag: Path) -> Path:
    """Temporary folder of a recording until it is accepted."""
    return bag.with_name(f"{bag.name}-fresh")


def clear(bag: Path) -> Path:
    """Return `fresh`, emptied of what a Ctrl-C or a trip has left."""
    shutil.rmtree(fresh(bag), ignore_errors=True)
    bag.parent.mkdir(parents=True, exist_ok=True)
    return fresh(bag)


def written(case: Case, name: str, attempt: Attempt, scratch: Path) -> dict[str, str]:
    """Write truth, schedule and the box's bench file for the emulator; return their paths by option."""
    files = {"truth": truth_of(case), "schedule": {"segments": [attempt.schedule(case.schedules[name])]}}
    box = attempt.box()
    if box is not None:
        files["bench"] = box.to_mapping()
    paths = {}
    for option, content in files.items():
        path = scratch / f"{case.name}.{name}.{option}.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        paths[option] = str(path)
    return paths


def truth_of(case: Case) -> dict[str, Any]:
    """The case as the emulator's truth file: the nominal bench plus the concealed causes."""
    effects = {name: dict(values) for name, values in case.effects.items()}
    outside = {name: dict(values) for name, values in case.outside.items()}
    return {"profile": "nominal", "sensors": {"noise_scale": case.noise}, "effects": effects, "outside": outside}


def run_seed(case: Case, name: str) -> int:
    """Seed of one run's noise."""
    return 10 * case.seed + (*FITTED, HELD).index(name)


def run_emulator(words: Sequence[str]) -> None:
    """Run the emulator's command to its end; raises UserError with its last line if it fails."""
    done = subprocess.run(["ros2", "run", "hydro_sim", "emulator", *words], check=False, capture_output=True, text=True)
    if done.returncode:
        raise UserError(f"the emulator could not record: {(done.stderr.strip() or 'it was ended').splitlines()[-1]}")


def whole(bag: Path) -> bool:
    """Return whether a recording was finished."""
    return (bag / "metadata.yaml").exists()
