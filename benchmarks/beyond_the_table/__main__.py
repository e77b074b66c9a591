# SPDX-License-Identifier: Apache-2.0
"""The diagnosis on physics that its table has no name for: whether it is located, modelled, and in the right form.

Each case conceals one such kind, alone, beside named causes or under more noise, or nothing at all; it records two runs
of 25 s (the second is held out) and runs `diagnose` on them in a process of its own.

    python -m benchmarks.beyond_the_table --half sealed --cases 20     the sixteen kinds alone, and four clean ones
    python -m benchmarks.beyond_the_table --half dev --kinds turbulent_drag --cases 5
    python -m benchmarks.beyond_the_table --half named --cases 44      what the table names

Ctrl-C loses no finished case: run it again to go on. OUT/SEED/NAME/ holds the report and what it cost.
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
from pathlib import Path
from typing import Any

from benchmarks._report import parser
from benchmarks.beyond_the_table.cases import SECONDS, Case, drawn, recorded
from benchmarks.beyond_the_table.kinds import HALVES, NAMES
from benchmarks.beyond_the_table.score import scored, table
from hydro_core.cli.console import UserError, bounded_number, command, writable_folder
from hydro_diagnosis import jobs


@command()
def main() -> None:
    """Run what is asked for and print the table."""
    options = parser("beyond_the_table", __doc__, parallel=True)
    options.add_argument("--cases", type=bounded_number(1), default=10, metavar="N", help="how many (default: 10)")
    options.add_argument(
        "--seed", type=bounded_number(0), default=1, metavar="S", help="that they are drawn from (default: 1)"
    )
    options.add_argument("--half", choices=HALVES, default="dev", help="of the kinds (default: dev)")
    options.add_argument("--kinds", nargs="+", choices=NAMES, metavar="KIND", help=f"of: {', '.join(NAMES)}")
    options.add_argument("--out", type=writable_folder, default=Path("runs/beyond_the_table"), metavar="DIR",
                         help="where reports go (default: runs/beyond_the_table)")  # fmt: skip
    asked = options.parse_args()
    cases = drawn(asked.half, asked.cases, asked.seed, asked.kinds)
    if not cases:
        raise UserError(f"none of {', '.join(asked.kinds)} is of the half {asked.half}")
    wanted = {case.name: (case, asked.out / str(asked.seed) / case.name) for case in cases}
    found = jobs.run_all(carried_out, wanted, **jobs.job_options(asked), label="beyond the table", unit="case")
    table([scored(case, found[case.name]) for case in cases]).show(asked.json)


def carried_out(case: Case, folder: Path, *, seconds: float = SECONDS) -> dict[str, Any]:
    """Record and diagnose a case, or take what is there: `report` (null where it was refused), `said`, `cpu` [s]."""
    kept = folder / "result.json"
    if kept.exists():
        return dict(json.loads(kept.read_text(encoding="utf-8")))
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    fitted, held = recorded(case, folder, seconds)
    words = ["ros2", "run", "hydro_diagnosis", "diagnose", str(fitted), "--holdout", str(held), "--quiet"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([*words, "--out", str(folder / "report")], capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = (done.stdout + done.stderr).strip()
    if done.returncode not in (0, 2):
        raise UserError(f"`{' '.join(words)}` ended with status {done.returncode}: {said[-2000:]}")
    report = None
    if done.returncode == 0:
        report = json.loads((folder / "report" / "report.json").read_text(encoding="utf-8"))
    shutil.rmtree(fitted)
    shutil.rmtree(held)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    result = {"report": report, "said": said, "cpu": round(cpu, 1)}
    kept.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return result


if __name__ == "__main__":
    main()
