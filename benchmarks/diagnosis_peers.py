# SPDX-License-Identifier: Apache-2.0
"""The diagnosis beside its peers on the same sealed cases: what each names, its held-out error, its time.

    ros2 run hydro_diagnosis prove --cases 224 --seed S      # first: makes the recordings, diagnoses, opens the seal
    python -m venv .venv-bench && .venv-bench/bin/pip install -r requirements-bench.txt    # PySINDy, on its own
    python -m benchmarks.diagnosis_peers --proof runs/proof-S-224

All get the same three recordings and bench.yaml, none the answers; how each is set up stands in `benchmarks.peers`.
"""

from __future__ import annotations

import json
import os
import random
import re
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from benchmarks import _report
from hydro_bridge.cli.console import Table, UserError, command, progress
from hydro_diagnosis.blind_benchmark.blind import ANSWER
from hydro_diagnosis.blind_benchmark.cases import Case
from hydro_diagnosis.blind_benchmark.prove import BLIND, DIGEST, SEALED, unseal
from hydro_diagnosis.blind_benchmark.scores import Result

PEERS = "peers"
"""Folder of what they say, within that of the proof."""
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
    """Run the peers on the cases of a proof."""
    options = _report.parser("diagnosis_peers", __doc__)
    options.add_argument("--proof", type=Path, metavar="DIR", help="folder of `prove` (default: the newest in runs/)")
    options.add_argument("--python", type=Path, default=Path(".venv-bench/bin/python"), help="that has PySINDy")
    options.add_argument("--cases", type=int, default=24, help="the first so many: their order is random (default: 24)")
    options.add_argument("--workers", type=int, default=1)
    options.add_argument("--minutes", type=float, default=float("inf"), help="run again to go on")
    chosen = options.parse_args()
    folder = chosen.proof or max(Path("runs").glob("proof-*"), key=lambda path: path.stat().st_mtime, default=None)
    if chosen.proof and not (folder / BLIND).is_dir():
        raise UserError(f"--proof {folder}: no folder of `prove`; that holds `{BLIND}` with a folder for each case")
    if folder is None or not chosen.python.exists():
        print("skipped: needs the folder of a proof (--proof) and an environment with PySINDy (--python)")
        return
    methods: dict[str, Callable[..., Any]] = {
        "PySINDy": partial(_sindy, chosen.python.absolute()), "neural residual": _neural,
    }  # fmt: skip
    names = sorted(path.name for path in (folder / BLIND).glob("case-*"))[: chosen.cases]
    (folder / PEERS).mkdir(exist_ok=True)
    until = time.monotonic() + 60.0 * chosen.minutes
    jobs = [(folder, name, method, solve) for name in names for method, solve in methods.items()]
    random.shuffle(jobs)  # several can run side by side
    tasks = (delayed(_run)(*job, until) for job in jobs)
    finished = Parallel(chosen.workers, return_as="generator_unordered")(tasks)
    if not all(list(progress(finished, total=len(jobs), label="peers", unit="run"))):
        raise SystemExit(3)
    _show(folder, names, ["diagnosis", *methods], chosen.json)


def _show(folder: Path, names: Sequence[str], methods: Sequence[str], file: Path | None) -> None:
    """Open the seal and print the table."""
    if not (folder / "proof.json").exists():
        print("the peers are done; the table comes once `prove` has opened the seal: then run this again")
        raise SystemExit(3)
    digest = (folder / SEALED / DIGEST).read_text().split()[0]
    cases = [case for case in unseal(folder / SEALED, digest) if case.name in names]
    rows = [_row(folder, case, method) for method in methods for case in cases]
    table = _table(rows)
    print(table.text())
    _report.finish({"table": table.rows, "cases": rows}, file)


def _sindy(python: Path, case: Any) -> Any:
    from benchmarks.peers import sindy  # each in its own process: imported where it runs

    return sindy.solve(case, python)


def _neural(case: Any) -> Any:
    from benchmarks.peers import neural

    return neural.solve(case)


def _run(folder: Path, name: str, method: str, solve: Callable[..., Any], until: float) -> bool:
    """Run one method on one case and keep what it says; False if time was up before."""
    path = _kept(folder, name, method)
    if path.exists():
        return True
    if time.monotonic() > until:
        return False
    from benchmarks.peers.run import load

    begun, cpu = time.monotonic(), _cpu()
    named, held_out = solve(load(folder / BLIND / name))
    content = {"named": named, "held_out": held_out, "seconds": time.monotonic() - begun, "cpu": _cpu() - cpu}
    path.write_text(json.dumps(content), encoding="utf-8")
    return True


def _cpu() -> float:
    """s of CPU of this process and of those it has waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _kept(folder: Path, name: str, method: str) -> Path:
    return folder / PEERS / f"{name}.{method.replace(' ', '-')}.json"


def _row(folder: Path, case: Case, method: str) -> dict[str, Any]:
    """What a method said about a case."""
    about = {"method": method, "case": case.name, "kind": case.kind, "label": case.label}
    if method == "diagnosis":
        answer = json.loads((folder / BLIND / case.name / ANSWER).read_text())
        result = Result(case=case, answer=answer)
        truth, claimed = set(case.effects), set(result.claimed)
        return {**about, "named": result.exact if case.kind != "outside" else not claimed, "said": sorted(claimed),
                "found": truth <= claimed, "extra": len(result.spurious), "held_out": result.held_out,
                "cpu": answer["cpu"]}  # fmt: skip
    content = json.loads(_kept(folder, case.name, method).read_text())
    found, extra = said(content["named"], set(case.effects))
    every = sorted({term for names in content["named"].values() for term in names})
    return {**about, "named": found and not extra, "said": every,
            "found": found, "extra": extra, "held_out": content["held_out"], "cpu": content["cpu"]}  # fmt: skip


def said(named: Mapping[str, Sequence[str]], truth: set[str]) -> tuple[bool, int]:
    """Whether every true cause is among the terms by equation, and how many causes are that are not true.

    `cause@value` is a term of a grid; `cause|cause` one that several causes share: it counts for any of them.
    """
    causes = {frozenset(re.sub(r"@.*", "", term).split("|")) for terms in named.values() for term in terms}
    return all(any(name in cause for cause in causes) for name in truth), sum(not cause & truth for cause in causes)


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    table = Table(COLUMNS, title=f"{len({row['case'] for row in rows})} sealed cases")
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        truthful = [row for row in own if row["kind"] not in ("clean", "outside")]
        errors = [np.inf if row["held_out"] is None else row["held_out"] for row in own]
        names = method != "neural residual"
        table.add(
            method=method,
            named=f"{sum(row['named'] for row in own)}/{len(own)}" if names else "names nothing",
            found=f"{sum(row['found'] for row in truthful)}/{len(truthful)}" if names else "",
            extra=float(np.mean([row["extra"] for row in own])),
            held_out=float(np.median(errors)),
            held_out_p90=float(np.percentile(errors, 90, method="higher")),
            cpu=float(np.median([row["cpu"] for row in own])),
        )
    return table


if __name__ == "__main__":
    main()
