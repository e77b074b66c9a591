# SPDX-License-Identifier: Apache-2.0
"""The diagnosis against benches whose effects it cannot see: standards reached beside goals, confusion, failures.

    python src/hydro_diagnosis/benchmarks/study.py --single 60 --pair 20 --clean 60 --outside 12 --seed 7 --folder
    runs/study

Truth comes from the emulator's command line; the diagnosis gets bags and bench.yaml, nothing else.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import yaml
from cases import Case, draw
from joblib import Parallel, delayed
from standards import table
from truth import record

from hydro_diagnosis import InputError, diagnose

KINDS = ("single", "value", "form", "pair", "triple", "clean", "outside")


def run_case(case: Case, bags: list[Path]) -> dict[str, Any]:
    """Diagnose one case; what is kept is plain data."""
    begun, cpu = time.monotonic(), time.process_time()
    try:
        found = diagnose(bags[:-1], holdout=bags[-1:])
    except InputError:  # the bench ran into its stops in every recording
        try:
            found = diagnose(bags)
        except InputError as error:
            return _refused(case, str(error), time.monotonic() - begun)
    report = json.loads(found.report.to_json())
    kept = {key: report[key] for key in ("verdict", "location", "effects", "remainder", "fit", "steps", "data_quality")}
    for place in kept["location"]:
        place.pop("windows")
    return {
        "name": case.name,
        "kind": case.kind,
        "noise": case.noise,
        "truth": {"effects": case.effects, "outside": case.outside},
        "wall": time.monotonic() - begun,
        "cpu": time.process_time() - cpu,
        **kept,
    }


def _refused(case: Case, why: str, wall: float) -> dict[str, Any]:
    truth = {"effects": case.effects, "outside": case.outside}
    empty: dict[str, Any] = {"location": [], "effects": [], "remainder": None, "fit": {"holdout": {}}, "steps": []}
    return {"name": case.name, "kind": case.kind, "noise": case.noise, "truth": truth, "wall": wall, "cpu": wall,
            "verdict": "refused", "data_quality": [why], **empty}  # fmt: skip


def main() -> None:
    """Run the study."""
    options = argparse.ArgumentParser(description=__doc__)
    for kind in KINDS:
        options.add_argument(f"--{kind}", type=int, default=0)
    options.add_argument("--seed", type=int, default=7)
    options.add_argument("--folder", type=Path, default=Path("runs/study"))
    options.add_argument("--only", nargs="*", default=[], help="parts of names")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument(
        "--budget", type=float, default=1e9, help="s, after which no new case begins; run again to go on"
    )
    options.add_argument("--json", type=Path, help="where the table goes as JSON")
    chosen = options.parse_args()
    cases = draw({kind: getattr(chosen, kind) for kind in KINDS}, chosen.seed)
    cases = [case for case in cases if not chosen.only or any(part in case.name for part in chosen.only)]
    folder = chosen.folder / str(chosen.seed)
    results = _results(cases, folder, chosen.workers, chosen.budget)
    summary = table(results)
    print(summary["text"])
    if chosen.json:
        chosen.json.write_text(json.dumps({**summary, "seed": chosen.seed, "cases": results}, indent=1))


def _results(cases: list[Case], folder: Path, workers: int, budget: float) -> list[dict[str, Any]]:
    """Results of all cases, the new ones computed in slices and kept as JSON beside the recordings."""
    begun = time.monotonic()
    missing = [case for case in cases if not _kept(case, folder).exists()]
    for at in range(0, len(missing), 4 * workers):
        if time.monotonic() - begun > budget:
            break
        slice_ = missing[at : at + 4 * workers]
        bags = record(slice_, folder)
        done = Parallel(workers, return_as="generator")(delayed(run_case)(case, bags[case.name]) for case in slice_)
        for case, result in zip(slice_, done, strict=True):
            _kept(case, folder).write_text(json.dumps(result))
            print(line(result), flush=True)
            for bag in bags[case.name]:
                for part in bag.glob("*.mcap"):
                    part.unlink()
                (bag / "metadata.yaml").unlink()
                bag.rmdir()
    return [json.loads(_kept(case, folder).read_text()) for case in cases if _kept(case, folder).exists()]


def _kept(case: Case, folder: Path) -> Path:
    return folder / f"{case.name}.result.json"


def line(result: dict[str, Any]) -> str:
    """One case in one line."""
    names = [effect["id"] for effect in result["effects"]]
    truth = yaml.safe_dump(
        {**result["truth"]["effects"], **result["truth"]["outside"]}, default_flow_style=True, width=500
    )
    values = [
        f"{name}={one['value']:.4g}" for effect in result["effects"] for name, one in effect["parameters"].items()
    ]
    return f"{result['name']} [{result['cpu']:.1f} s] {result['verdict']} {names} {values} | {truth.strip()}"


if __name__ == "__main__":
    main()
