# SPDX-License-Identifier: Apache-2.0
"""Changed benches after `relearn`: a minute recorded, model and metric made anew, then wide gains behind the filter.

The emulator's truth is changed (spring, supply, valve gain); the box keeps to the nominal bench.yaml, and nothing but
the recording tells of the change. Schedule of the recording: 20 s of everything under (90, 15), three times. The runs
are those of `benchmarks.bench_file_filter`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from benchmarks.bench_file_filter import CASES as ALL
from benchmarks.bench_file_filter import COLUMNS, FILE_NAME, add_runs, loaded
from hydro_bridge.cli.console import Table, UserError, add_json_argument, command, progress
from hydro_filter.controller.loop_filter import LoopFilter
from hydro_filter.training.relearn import METRIC, MODEL
from hydro_filter.validation.plants import modified_truth
from hydro_sim.emulator.truth.plant import TruthPlant

CASES = {name: case[0] for name, case in ALL.items() if name != "deadband 0.5 mA"}
"""Of each bench: the truth's change."""
SECONDS = 60.0


def made_for(name: str, folder: Path, seed: int) -> tuple[LoopFilter, dict[str, Any]]:
    """The filter that `relearn` makes of a minute of recordings, and what is said of it (raises ValueError)."""
    truth, bag, out = folder / "truth.yaml", folder / "recording", folder / "relearned"
    truth.write_text(yaml.safe_dump({"profile": "default", **CASES[name]}), encoding="utf-8")
    words = ["--offline", "--truth", str(truth), "--seconds", str(SECONDS), "--seed", str(seed), "--out", str(bag)]
    _run("hydro_sim.emulator.command", *words)
    began = time.monotonic()
    said = _run("hydro_filter.training.relearn", str(bag), "--out", str(out))
    took = time.monotonic() - began
    made = loaded(out / METRIC, out / MODEL)
    rows = yaml.safe_load((out / "metric.json").read_text(encoding="utf-8"))["rows"]
    violated = next(one["violated"] for one in rows if one["metric"] == "solved" and one["gains"] == "certified")
    span = said.rpartition("certified range: K_p ")[2].split(" 1/s")[0]
    return made, {"range": span, "violated": violated, "made_in": took}


def table_of(names: list[str], seeds: int) -> Table:
    """All rows."""
    table = Table(COLUMNS, title="The filter after relearn")
    for seed, name in progress(list(product(range(1, seeds + 1), names)), label="benches", unit="bench"):
        with TemporaryDirectory(suffix=name.translate(FILE_NAME)) as folder:
            filtering = made_for(name, Path(folder), seed)
        add_runs(table, name, TruthPlant(modified_truth(CASES[name])), filtering, "relearned", seed)
    return table


def _run(module: str, *words: str) -> str:
    """What a command of ours says on stderr (raises ValueError with its own words)."""
    start = f"import sys; from hydro_bridge.process.start import main_of; sys.exit(main_of.{module}())"
    done = subprocess.run([sys.executable, "-c", start, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(f"{module}: {done.stderr.strip().splitlines()[-1].removeprefix('error: ')}")
    return done.stderr


@command(ValueError)
def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.relearned_filter", description=__doc__)
    parser.add_argument("--bench", nargs="+", default=list(CASES), choices=list(CASES), help="default: all")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="of recording and runs (default: 1)")
    add_json_argument(parser)
    asked = parser.parse_args()
    if asked.seeds < 1:
        raise UserError("--seeds of at least 1 is meant")
    table_of(asked.bench, asked.seeds).show(asked.json)


if __name__ == "__main__":
    main()
