# SPDX-License-Identifier: Apache-2.0
"""Recordings of the cases by the emulator's command, offline.

The truth is written to a temporary folder, which is deleted before any diagnosis begins. A run that cannot be used is
recorded again as an operator would, decided from the run alone: first lower gains and a smaller reference; if the bench
still trips or swings from stop to stop, the box assumes a stronger valve, so that its force law compensates the
velocity term only in part. The diagnosis reads the recorded valve current and is not concerned.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.prove.cases import FITTED, HELD, Case
from hydro_bridge.bags.recording import read_bag
from hydro_bridge.cli import jobs
from hydro_bridge.cli.console import UserError
from hydro_bridge.signals import Flag
from hydro_diagnosis.io.table import UnusableRecordingError, read_table
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model.bench import Bench

USED = 0.5
"""Share of a run that must be free of end stops and cavitation."""
SATURATED = 0.01
"""Share of a run in which the valve current may stand at its limit."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """Settings of one attempt at a run."""

    amplitude: float = 1.0
    """Share of the drawn reference's amplitude."""
    kp: float = 1e3
    """Upper limit [1/s] of the drawn K_p."""
    ki: float = 1e3
    """Upper limit [1/s^2] of the drawn K_i."""
    believed_flow: float = 1.0
    """`valve_nominal_flow` that the box assumes, over that of bench.yaml."""

    def schedule(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Reference and gains of this attempt."""
        gains = {"kp": min(self.kp, drawn["kp"]), "ki": min(self.ki, drawn["ki"])}
        return {**drawn, "amplitude": self.amplitude * drawn["amplitude"], **gains}

    def box(self) -> Bench | None:
        """Bench that the box assumes; None: bench.yaml unchanged."""
        if self.believed_flow == 1.0:
            return None
        bench = Bench.nominal()
        return replace(bench, valve_nominal_flow=self.believed_flow * bench.valve_nominal_flow)


ATTEMPTS = (
    Attempt(),
    Attempt(amplitude=0.6, kp=30.0, ki=5.0),
    Attempt(believed_flow=1.25),
    Attempt(believed_flow=1.6, amplitude=0.6),
    Attempt(believed_flow=2.5, amplitude=0.6),
)
"""Tried in order until a run is usable; the last one is kept in any case."""


def usable(bag: Path) -> bool:
    """Return whether the box did not trip, the valve hardly saturated, and the stops were mostly left alone."""
    flags = read_bag(bag, topics=("/hydro/state",)).state["flags"]
    if (flags & Flag.TRIPPED).any() or np.mean((flags & Flag.SATURATED) > 0) > SATURATED:
        return False
    try:
        recording = checked(read_table(bag), Bench.nominal())
    except UnusableRecordingError:
        return False
    return recording.seconds >= USED * 1e-3 * len(flags)


SLICE = 8
"""Cases that one process of the emulator records."""
Run = tuple[Case, str]
"""A case and the name of a recording."""


def record(cases: Sequence[Case], folder: Path, until: float, **where: Any) -> bool:
    """Record the missing runs of `cases` into `folder`/CASE/{run1, run2, run3, held}, side by side.

    Returns
    -------
    False if `until`, a time of `time.monotonic`, came before the end.
    """
    missing = [case for case in cases if not all(whole(folder / case.name / name) for name in (*FITTED, HELD))]
    slices = {missing[at].name: (missing[at : at + SLICE], folder) for at in range(0, len(missing), SLICE)}
    done = jobs.complete(_record, slices, **where, until=until, label="recording", unit="slice")
    return len(done) == len(slices)


def _record(cases: Sequence[Case], folder: Path) -> None:
    """Record one slice."""
    runs = [(case, name) for case in cases for name in (*FITTED, HELD) if not whole(folder / case.name / name)]
    left = runs
    for attempt in ATTEMPTS:
        _play(left, attempt, folder)
        left = [(case, name) for case, name in left if not usable(fresh(folder / case.name / name))]
    for case, name in runs:
        fresh(folder / case.name / name).rename(folder / case.name / name)


def _play(runs: Sequence[Run], attempt: Attempt, folder: Path) -> None:
    """Record runs, each as `fresh`, in one process."""
    if not runs:
        return
    with tempfile.TemporaryDirectory(prefix="hydro-truth-") as scratch:
        batch = []
        for case, name in runs:
            out = clear(folder / case.name / name)
            paths = written(case, name, attempt, Path(scratch))
            batch.append({"out": str(out), "seed": run_seed(case, name), **paths})
        file = Path(scratch) / "batch.yaml"
        file.write_text(yaml.safe_dump({"jobs": batch}), encoding="utf-8")
        run_emulator(["--offline", "--batch", str(file)])


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
    """The case as the emulator's truth file: the nominal bench, whatever the box assumes, plus the concealed causes."""
    effects = {name: dict(values) for name, values in case.effects.items()}
    outside = {name: dict(values) for name, values in case.outside.items()}
    parts = {"bench": Bench.nominal().to_mapping(), "sensors": {"noise_scale": case.noise}}
    return {"profile": "nominal", **parts, "effects": effects, "outside": outside}


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
