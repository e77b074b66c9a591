# SPDX-License-Identifier: Apache-2.0
"""The wear story: a model was learned on the healthy bench, the bench wears, and the diagnosis says what has changed.

    python -m benchmarks.wear --folder runs/wear --json runs/wear.json

The healthy bench is the emulator's default profile; the model, the weights that come with hydro_sim, learned on it.
Each case is recorded anew by the emulator's command: two runs of 20 s are fitted, a third is held out.
"""

from __future__ import annotations

import argparse
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.cli.console import Table, add_json_argument, progress
from hydro_diagnosis import diagnose
from hydro_sim.files.weights import shipped

DRIVES = (
    {"seconds": 20, "waveform": "multisine", "amplitude": 260, "frequency": 0.7, "kp": 60, "ki": 10},
    {"seconds": 20, "waveform": "smooth_step", "amplitude": 240, "frequency": 0.8, "kp": 45, "ki": 8},
    {"seconds": 20, "waveform": "sine", "amplitude": 250, "offset": 20, "frequency": 1.1, "kp": 70, "ki": 12},
)


def _lugre(force: float) -> dict[str, Any]:
    return {"friction_coulomb": {"force": force, "form": "lugre"}}


CASES: Mapping[str, tuple[Mapping[str, Any], Mapping[str, float]]] = {
    "healthy": ({}, {}),
    "leak 1e-13 to 1.5e-13": ({"leakage_internal": {"coefficient": 1.5e-13}}, {"leakage_internal": 5e-14}),
    "leak 1e-13 to 3e-13": ({"leakage_internal": {"coefficient": 3e-13}}, {"leakage_internal": 2e-13}),
    "leak 1e-13 to 1e-12": ({"leakage_internal": {"coefficient": 1e-12}}, {"leakage_internal": 9e-13}),
    "friction 12 to 14 N": (_lugre(14.0), {"friction_coulomb": 2.0}),
    "friction 12 to 18 N": (_lugre(18.0), {"friction_coulomb": 6.0}),
    "friction 12 to 27 N": (_lugre(27.0), {"friction_coulomb": 15.0}),
    "overlap 0.1 mA": ({"valve_deadband": {"half_width": 1e-4}}, {"valve_deadband": 1e-4}),
    "overlap 0.3 mA": ({"valve_deadband": {"half_width": 3e-4}}, {"valve_deadband": 3e-4}),
    "overlap 1 mA": ({"valve_deadband": {"half_width": 1e-3}}, {"valve_deadband": 1e-3}),
    "air 0.2 %": ({"entrained_air": {"volume_fraction": 2e-3}}, {"entrained_air": 2e-3}),
    "air 0.5 %": ({"entrained_air": {"volume_fraction": 5e-3}}, {"entrained_air": 5e-3}),
    "air 2 %": ({"entrained_air": {"volume_fraction": 2e-2}}, {"entrained_air": 2e-2}),
    "leak and friction": (
        {"leakage_internal": {"coefficient": 3e-13}, **_lugre(18.0)},
        {"leakage_internal": 2e-13, "friction_coulomb": 6.0},
    ),
}
"""What the emulator is told, and what must be named: the change of each cause's first parameter, SI units."""


def record(folder: Path) -> dict[str, list[Path]]:
    """Recordings by case; those that are there already stay."""
    folder.mkdir(parents=True, exist_ok=True)
    bags: dict[str, list[Path]] = {}
    jobs = []
    for n, (name, (effects, _)) in enumerate(CASES.items()):
        truth = folder / f"truth{n}.yaml"
        truth.write_text(yaml.safe_dump({"profile": "default", "effects": dict(effects)}))
        bags[name] = [folder / f"case{n}.{k}" for k in range(len(DRIVES))]
        for k, (drive, bag) in enumerate(zip(DRIVES, bags[name], strict=True)):
            schedule = folder / f"schedule{k}.yaml"
            schedule.write_text(yaml.safe_dump({"segments": [drive]}))
            if not (bag / "metadata.yaml").exists():
                seed = 1000 + 10 * n + k
                jobs.append({"out": str(bag), "truth": str(truth), "schedule": str(schedule), "seed": seed})
    if jobs:
        (folder / "batch.yaml").write_text(yaml.safe_dump({"jobs": jobs}))
        batch = ["ros2", "run", "hydro_sim", "emulator", "--offline", "--batch", str(folder / "batch.yaml")]
        subprocess.run(batch, check=True, stdout=subprocess.DEVNULL)
    return bags


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--folder", type=Path, default=Path("runs/wear"), help="where recordings go")
    add_json_argument(options)
    chosen = options.parse_args()
    bags = record(chosen.folder)
    table = Table(
        {
            "wear": "what was changed",
            "verdict": "",
            "named": "causes, with the change of each one's first parameter, SI units",
            "right": "exactly these causes, each within 2 %, and held by its 95 % interval or within 0.5 %",
            "cpu": "s",
        }
    )
    for name, (_, truth) in progress(CASES.items(), label="wear", total=len(CASES)):
        begun = time.process_time()
        report = diagnose(bags[name][:2], holdout=bags[name][2:], model=shipped()).report
        found = {effect.id: next(iter(effect.parameters.values())) for effect in report.effects}
        right = set(found) == set(truth) and all(_close(found[key], value) for key, value in truth.items())
        named = ", ".join(f"{key} {one.value:.4g}" for key, one in found.items()) or "nothing"
        seconds = time.process_time() - begun
        table.add(wear=name, verdict=report.verdict, named=named, right="yes" if right else "no", cpu=round(seconds, 1))
    table.show(chosen.json)


def _close(one: Any, value: float) -> bool:
    held = one.ci95 is not None and one.ci95[0] <= value <= one.ci95[1]
    return abs(one.value - value) <= (0.02 if held else 0.005) * abs(value)


if __name__ == "__main__":
    main()
