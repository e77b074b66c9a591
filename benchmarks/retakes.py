# SPDX-License-Identifier: Apache-2.0
"""Benches that the force law cannot drive: after how many attempts a run can be used, and what is then named.

    python -m benchmarks.retakes --folder runs/retakes --json runs/retakes.json

Drawn are benches whose valve passes more than bench.yaml says, in one way or another, and references as in a proof.
Each run is recorded anew, attempt after attempt, until an operator would take it (`blind_benchmark.retake`).
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hydro_bridge.cli.console import Table, add_json_argument, progress
from hydro_diagnosis import InputError, diagnose
from hydro_diagnosis.blind_benchmark.cases import FITTED, HELD, Case, draw_parts
from hydro_diagnosis.blind_benchmark.recording import clear, fresh, run_emulator, run_seed, whole, written
from hydro_diagnosis.blind_benchmark.retake import ATTEMPTS, usable

GROUPS: Mapping[str, Mapping[str, tuple[str, float, float]]] = {
    "valve gain": {"valve_gain": ("ratio", 1.05, 1.15)},
    "gain asymmetry": {"valve_gain_asymmetry": ("ratio", 1.05, 1.2)},
    "supply": {"supply_pressure": ("ratio", 1.05, 1.1)},
    "piston area": {"piston_area": ("ratio", 0.92, 0.97)},
    "valve gain, supply": {"valve_gain": ("ratio", 1.05, 1.15), "supply_pressure": ("ratio", 1.05, 1.1)},
    "valve gain, late": {"valve_gain": ("ratio", 1.05, 1.15), "transport_delay": ("time", 5e-4, 1.5e-3)},
}
"""Causes with parameter and range."""
RUNS = (*FITTED, HELD)


def drawn(group: str, count: int, rng: np.random.Generator) -> list[Case]:
    """Benches of a group, with references and gains as a proof draws them."""
    plain = draw_parts({"clean": count}, int(rng.integers(10**6)))
    cases = []
    for k, case in enumerate(plain):
        effects = {name: {key: float(rng.uniform(low, high))} for name, (key, low, high) in GROUPS[group].items()}
        name = f"{group.replace(', ', '-').replace(' ', '_')}-{k}"
        noise = float(rng.choice([0.5, 1.0, 2.0]))
        cases.append(Case(name=name, kind="pair", label=group, effects=effects, noise=noise, seed=case.seed,
                          schedules=case.schedules))  # fmt: skip
    return cases


def record(cases: Sequence[Case], folder: Path) -> list[int]:
    """Record all runs; returns how many could be used after each attempt, the earlier ones counted in."""
    left = [(case, name) for case in cases for name in RUNS]
    used = []
    for attempt in ATTEMPTS:
        with tempfile.TemporaryDirectory(prefix="hydro-truth-") as scratch:
            jobs: list[dict[str, Any]] = [
                {"out": str(clear(folder / case.name / name)), "seed": run_seed(case, name),
                 **written(case, name, attempt, Path(scratch))}
                for case, name in left
            ]  # fmt: skip
            batch = Path(scratch) / "batch.yaml"
            batch.write_text(yaml.safe_dump({"jobs": jobs}), encoding="utf-8")
            if jobs:
                run_emulator(["--offline", "--batch", str(batch)])
        left = [(case, name) for case, name in left if not usable(fresh(folder / case.name / name))]
        used.append(len(cases) * len(RUNS) - len(left))
    for case in cases:
        for name in RUNS:
            if not whole(folder / case.name / name):
                fresh(folder / case.name / name).rename(folder / case.name / name)
    return used


def named(case: Case, folder: Path) -> bool:
    """Whether the diagnosis names exactly what the bench has."""
    runs = [folder / case.name / name for name in FITTED]
    try:
        report = diagnose(runs, holdout=[folder / case.name / HELD]).report
    except InputError:
        return False
    return {effect.id for effect in report.effects} == set(case.effects)


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--folder", type=Path, default=Path("runs/retakes"), help="where recordings go; a new one")
    options.add_argument("--benches", type=int, default=3, help="of each group (default: 3)")
    options.add_argument("--seed", type=int, default=11, help="of benches, references and noise (default: 11)")
    add_json_argument(options)
    chosen = options.parse_args()
    if chosen.folder.exists():
        options.error(f"{chosen.folder} exists: choose a new folder")
    rng = np.random.default_rng(chosen.seed)
    attempts = {f"after_{k + 1}": f"runs that can be used after attempt {k + 1}" for k in range(len(ATTEMPTS))}
    table = Table({"group": "causes", "runs": "", **attempts, "named": "benches of which exactly the causes are named"})
    for group in progress(GROUPS, label="recording and diagnosing", total=len(GROUPS)):
        cases = drawn(group, chosen.benches, rng)
        used = record(cases, chosen.folder)
        right = sum(named(case, chosen.folder) for case in cases)
        counts = dict(zip(attempts, used, strict=True))
        table.add(group=group, runs=len(cases) * len(RUNS), **counts, named=f"{right}/{len(cases)}")
    table.show(chosen.json)


if __name__ == "__main__":
    main()
