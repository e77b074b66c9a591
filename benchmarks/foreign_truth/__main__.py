# SPDX-License-Identifier: Apache-2.0
"""The diagnosis on a bench that somebody else wrote, from the specification alone.

Each case conceals something in a plant that shares no code with the project, records two runs of 25 s (the second is
held out), runs `diagnose` on them in a process of its own, and holds the report against the truth.

    python -m benchmarks.foreign_truth --list                    the cases, by name
    python -m benchmarks.foreign_truth                           all of them: about ten minutes
    python -m benchmarks.foreign_truth stribeck clean_bag        two of them
    python -m benchmarks.foreign_truth --again                   diagnose the recordings that are there once more

Ctrl-C loses no finished case: run it again to go on. OUT/NAME/ holds the recordings, the report and result.json.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

from benchmarks.foreign_truth.cases import CASES, KINDS, Case
from benchmarks.foreign_truth.plant import SUBSTEPS
from benchmarks.foreign_truth.recordings import COLUMNS, SECONDS, recorded
from benchmarks.foreign_truth.score import scored, table
from hydro_bridge.cli.console import Table, UserError, add_json_argument, command, progress, writable_folder

RESULT = "result.json"


@command()
def main() -> None:
    """Run what is asked for and print the table."""
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.foreign_truth",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("names", nargs="*", metavar="NAME", help="cases (default: all)")
    options.add_argument("--out", type=writable_folder, default=Path("runs/foreign_truth"), metavar="DIR",
                         help="where recordings and reports go (default: runs/foreign_truth)")  # fmt: skip
    options.add_argument("--again", action="store_true", help="diagnose cases again that are done")
    options.add_argument("--substeps", type=int, default=SUBSTEPS, metavar="N",
                         help="plant steps a millisecond, for what is not recorded yet (default: 200)")  # fmt: skip
    options.add_argument("--list", action="store_true", help="list the cases and stop")
    add_json_argument(options)
    asked = options.parse_args()
    if asked.substeps < 1:
        raise UserError(f"--substeps {asked.substeps}: at least 1 is meant")
    cases = chosen(asked.names)
    if asked.list:
        listed(cases).show(asked.json)
        return
    rows = []
    for case in (bar := progress(cases, label="foreign truth", unit="case")):
        bar.set_postfix_str(case.name)
        rows.append(carried_out(case, asked.out / case.name, substeps=asked.substeps, again=asked.again))
    table(rows).show(asked.json)


def chosen(names: list[str]) -> list[Case]:
    """Cases by name, in the order of the list; all for none."""
    unknown = set(names) - {case.name for case in CASES}
    if unknown:
        raise UserError(f"there is no case {min(unknown)}; --list shows them")
    return [case for case in CASES if case.name in names or not names]


def listed(cases: list[Case]) -> Table:
    """What each case conceals."""
    kinds = "; ".join(f"{kind}, {meaning}" for kind, meaning in KINDS.items())
    shown = Table({"case": "", "kind": kinds, "conceals": "", "recorded": ""}, title="cases")
    for case in cases:
        parts = [f"{name} {value:.5g}" for name, value in case.truth.items()] or [KINDS[case.kind]]
        shown.add(case=case.name, kind=case.kind, conceals=", ".join(parts), recorded="CSV" if case.table else "bag")
    return shown


def carried_out(
    case: Case, folder: Path, *, seconds: float = SECONDS, substeps: int = SUBSTEPS, again: bool = False
) -> dict[str, Any]:
    """Record, diagnose and score a case, or take the result that is there."""
    kept = folder / RESULT
    if kept.exists() and not again:
        return dict(json.loads(kept.read_text(encoding="utf-8")))
    fitted, held = recorded(case, folder, seconds, substeps)
    report = folder / "report"
    shutil.rmtree(report, ignore_errors=True)
    words = ["ros2", "run", "hydro_diagnosis", "diagnose", str(fitted), "--holdout", str(held), "--out", str(report)]
    begun = time.monotonic()
    done = subprocess.run(
        [*words, "--quiet", *(["--columns", COLUMNS] if case.table else [])],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    took = time.monotonic() - begun
    said = (done.stdout + done.stderr).strip()
    if done.returncode not in (0, 2):
        raise UserError(f"`{' '.join(words)}` ended with status {done.returncode}: {said[-2000:]}")
    content = json.loads((report / "report.json").read_text(encoding="utf-8")) if done.returncode == 0 else None
    row = scored(case, content, said, took)
    kept.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
    return row


if __name__ == "__main__":
    main()
