# SPDX-License-Identifier: Apache-2.0
"""The diagnosis beside PySINDy on the same sealed cases: what each names, its held-out error, its time.

    ros2 run hydro_diagnosis prove --cases 224 --seed S      # first: makes the recordings, diagnoses, opens the seal
    python -m venv .venv-bench && .venv-bench/bin/pip install -r requirements-bench.txt    # PySINDy, on its own
    python -m benchmarks.diagnosis_peers --proof runs/proof-S-224

All get the same three recordings and bench.yaml, none the answers; how PySINDy is set up stands in `benchmarks.peers`.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import parser, resumable
from hydro_bridge.cli.console import Table, UserError, command
from hydro_diagnosis.blind_benchmark.blind import ANSWER
from hydro_diagnosis.blind_benchmark.cases import Case
from hydro_diagnosis.blind_benchmark.prove import BLIND, DIGEST, SEALED, unseal
from hydro_diagnosis.blind_benchmark.scores import Result

COLUMNS = {
    "method": "",
    "named": "cases in which exactly what is concealed is named (clean and outside: nothing is)",
    "found": "cases in which what is concealed is among what is named",
    "extra": "causes named that are not concealed, mean per case",
    "held_out": "held-out error over the noise floor, median",
    "held_out_p90": "the same, 90th percentile",
    "cpu": "s of CPU, median per case",
}


@command()
def main() -> None:
    """Run the peer on the cases of a proof."""
    options = parser("diagnosis_peers", __doc__)
    options.add_argument("--proof", type=Path, metavar="DIR", help="folder of `prove` (default: the newest in runs/)")
    options.add_argument("--python", type=Path, default=Path(".venv-bench/bin/python"), help="that has PySINDy")
    options.add_argument("--cases", type=int, default=24, help="the first so many: their order is random (default: 24)")
    options.add_argument("--workers", type=int, default=1)
    chosen = options.parse_args()
    folder = chosen.proof or max(Path("runs").glob("proof-*"), key=lambda path: path.stat().st_mtime, default=None)
    if chosen.proof and not (folder / BLIND).is_dir():
        raise UserError(f"--proof {folder}: no folder of `prove`; that holds `{BLIND}` with a folder for each case")
    if folder is None or not chosen.python.exists():
        print("skipped: needs the folder of a proof (--proof) and an environment with PySINDy (--python)")
        return
    names = sorted(path.name for path in (folder / BLIND).glob("case-*"))[: chosen.cases]
    jobs = {name: (folder / BLIND / name, chosen.python.absolute()) for name in names}
    found = resumable(run, jobs, folder / "peers.jsonl", "peers", chosen.workers)
    if not (folder / "proof.json").exists():
        raise UserError("the peer is done; the table comes once `prove` has opened the seal: then run this again")
    digest = (folder / SEALED / DIGEST).read_text().split()[0]
    cases = [case for case in unseal(folder / SEALED, digest) if case.name in names]
    rows = [_ours(folder / BLIND / case.name, case) for case in cases]
    rows += [_theirs(found[case.name], case) for case in cases]
    table(rows).show(chosen.json)


def run(folder: Path, python: Path) -> dict[str, Any]:
    """What PySINDy says of a case."""
    from benchmarks.peers import sindy  # in its own process: imported where it runs
    from benchmarks.peers.run import load

    before = sum(os.times()[:4])
    named, held_out = sindy.solve(load(folder), python)
    return {"named": named, "held_out": held_out, "cpu": sum(os.times()[:4]) - before}


def _ours(folder: Path, case: Case) -> dict[str, Any]:
    answer = json.loads((folder / ANSWER).read_text())
    result = Result(case=case, answer=answer)
    truth, claimed = set(case.effects), set(result.claimed)
    return {"method": "diagnosis", "kind": case.kind, "found": truth <= claimed, "extra": len(result.spurious),
            "named": result.exact if case.kind != "outside" else not claimed, "held_out": result.held_out,
            "cpu": answer["cpu"]}  # fmt: skip


def _theirs(content: Mapping[str, Any], case: Case) -> dict[str, Any]:
    found, extra = said(content["named"], set(case.effects))
    return {"method": "PySINDy", "kind": case.kind, "found": found, "extra": extra, "named": found and not extra,
            "held_out": content["held_out"], "cpu": content["cpu"]}  # fmt: skip


def said(named: Mapping[str, Sequence[str]], truth: set[str]) -> tuple[bool, int]:
    """Whether every true cause is among the terms by equation, and how many causes are that are not true.

    `cause@value` is a term of a grid; `cause|cause` one that several causes share: it counts for any of them.
    """
    causes = {frozenset(re.sub(r"@.*", "", term).split("|")) for terms in named.values() for term in terms}
    return all(any(name in cause for cause in causes) for name in truth), sum(not cause & truth for cause in causes)


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Of both."""
    made = Table(COLUMNS, title=f"{len(rows) // 2} sealed cases")
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        truthful = [row for row in own if row["kind"] not in ("clean", "outside")]
        errors = [np.inf if row["held_out"] is None else row["held_out"] for row in own]
        made.add(
            method=method,
            named=f"{sum(row['named'] for row in own)}/{len(own)}",
            found=f"{sum(row['found'] for row in truthful)}/{len(truthful)}",
            extra=float(np.mean([row["extra"] for row in own])),
            held_out=float(np.median(errors)),
            held_out_p90=float(np.percentile(errors, 90, method="higher")),
            cpu=float(np.median([row["cpu"] for row in own])),
        )
    return made


if __name__ == "__main__":
    main()
