# SPDX-License-Identifier: Apache-2.0
"""`python -m benchmarks.prove --seed S`: how often the diagnosis is right, on benches whose causes it cannot see.

Draws benches with nothing, one, two or three causes concealed (effects, wrong bench values, other forms, causes that
have no name), seals the answers and prints their SHA-256, records each bench through the emulator, has the diagnosis
look at recordings and bench.yaml in a process of its own, opens the seal, checks the digest, and scores. After Ctrl-C
the same command goes on where it was. proof.md.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks._report import parser
from benchmarks.prove.cases import PARTS, Case, draw, draw_parts
from benchmarks.prove.scores import Result, confusion, failures, standards
from hydro_bridge.pages import Section, results_page
from hydro_bridge.pages.runs import refresh_index
from hydro_core.cli.console import Table, UserError, bounded_number, command, writable_folder
from hydro_core.files.atomic import write_atomic
from hydro_diagnosis import jobs
from hydro_sim.model.bench import Bench
from hydro_sim.plotting import figure

ANSWERS, DIGEST = "answers.json", "answers.sha256"
ROOT = Path(__file__).resolve().parents[2]


def seal(cases: Sequence[Case], folder: Path) -> str:
    """Write the answers into `folder`, readable by their owner alone; returns their SHA-256.

    Raises UserError: the folder holds the seal of other cases.
    """
    content = json.dumps([case.to_mapping() for case in cases], sort_keys=True, indent=1).encode()
    digest = hashlib.sha256(content).hexdigest()
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / DIGEST
    if kept.exists():
        if kept.read_text().split()[0] != digest:
            raise UserError(f"{folder.parent} holds other cases: choose another --out, or repeat the same options")
        return digest
    (folder / ANSWERS).write_bytes(content)
    (folder / ANSWERS).chmod(0o400)
    kept.write_text(f"{digest}  {ANSWERS}\n", encoding="utf-8")  # as sha256sum -c reads it
    return digest


def unseal(folder: Path, digest: str) -> list[Case]:
    """Return the answers, if they match the seal. Raises UserError: they were changed since."""
    content = (folder / ANSWERS).read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise UserError(f"{folder / ANSWERS} was changed after it was sealed: its digest is not {digest}")
    return [Case.from_mapping(data) for data in json.loads(content)]


SEALED, BLIND = "sealed", "blind"
"""Folders of a proof: answers; input and output of the diagnosis."""


def run(words: Sequence[str]) -> None:
    """Prove."""
    options = parser("prove", __doc__, parallel=True)
    options.add_argument("--cases", type=bounded_number(1, 100_000), default=20, metavar="N",
                         help="benches (default: 20; a proof: 224)")  # fmt: skip
    options.add_argument("--parts", nargs="+", metavar="KIND=N", help="so many of each kind, in place of --cases")
    options.add_argument(
        "--seed", type=bounded_number(0), required=True, metavar="S", help="of everything that is drawn"
    )
    options.add_argument("--out", type=Path, metavar="DIR", help="default: runs/proof-S-N; 9 MB a case")
    chosen = options.parse_args(words)
    from benchmarks.prove.blind import ANSWER, waiting
    from benchmarks.prove.recording import record

    cases = _drawn(chosen)
    folder = writable_folder(chosen.out or Path("runs") / f"proof-{chosen.seed}-{len(cases)}").absolute()
    digest = seal(cases, folder / SEALED)
    print(f"sealed: {len(cases)} answers, SHA-256 {digest}", flush=True)
    (folder / BLIND).mkdir(parents=True, exist_ok=True)
    believed = folder / BLIND / "bench.yaml"
    if not believed.exists():
        believed.write_text(yaml.safe_dump(Bench.nominal().to_mapping(), sort_keys=False), encoding="utf-8")
    where = jobs.job_options(chosen)
    record(cases, folder / BLIND, **where)
    left = waiting(folder / BLIND)
    slices = {left[at].name: (left[at : at + SLICE],) for at in range(0, len(left), SLICE)}
    jobs.run_all(_blindly, slices, **where, label="diagnosing", unit="slice")
    answers = unseal(folder / SEALED, digest)
    print("opened: the answers are those that were sealed")
    said = [json.loads((folder / BLIND / case.name / ANSWER).read_text()) for case in answers]
    results = [Result(case=case, answer=one) for case, one in zip(answers, said, strict=True)]
    _show(results, folder, {"seed": str(chosen.seed), "cases": str(len(cases)), "SHA-256": digest}, chosen.json)


@command(OSError)
def main() -> None:
    """Entry point."""
    run(sys.argv[1:])


def _drawn(chosen: argparse.Namespace) -> list[Case]:
    if not chosen.parts:
        return draw(chosen.cases, chosen.seed)
    parts = dict(word.partition("=")[::2] for word in chosen.parts)
    for kind, count in parts.items():
        if kind not in PARTS or not count.isdigit():
            raise UserError(f"--parts {kind}={count}: must be a kind ({', '.join(PARTS)}) and a number")
    return draw_parts({kind: int(count) for kind, count in parts.items()}, chosen.seed)


SLICE = 4
"""Cases that one process diagnoses: a blindfold is not taken off again."""


def _blindly(cases: Sequence[Path]) -> None:
    words = [sys.executable, "-m", "benchmarks.prove.blind", *map(str, cases)]
    done = subprocess.run(words, check=False, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        raise UserError(done.stderr.strip() or f"the diagnosis ended with status {done.returncode}")


def _show(results: Sequence[Result], folder: Path, about: dict[str, str], json_file: Path | None) -> None:
    """Print the table; write proof.json, the picture and proof.html."""
    about = {**about, "engine": ", ".join(sorted({str(result.answer["engine"]) for result in results}))}
    table, failed = standards(results), failures(results)
    table.show(json_file)
    matrix, picture = confusion(results), folder / "confusion.png"
    draw_confusion(matrix, picture)
    write_page(folder / "proof.html", table, picture, failed, about)
    refresh_index(folder)
    cases = [
        {
            "case": one.case.name, "kind": one.case.kind, "label": one.case.label, "noise": one.case.noise,
            "size": one.case.size, "truth": {**one.case.effects, **one.case.outside}, "verdict": one.verdict,
            "claimed": one.claimed, "passed": one.passed, "located": one.located, "places": one.places,
            "held_out": one.held_out, "forecast": (one.answer["report"] or {}).get("forecast"),
            "estimates": [{**vars(found), "error": found.error} for found in one.estimates],
            "wall": one.answer["wall"], "cpu": one.answer["cpu"],
        }
        for one in results
    ]  # fmt: skip
    content = {"about": about, "standards": table.rows, "confusion": matrix, "failures": failed, "cases": cases}
    write_atomic(folder / "proof.json", (json.dumps(content, indent=1) + "\n").encode())
    print(f"{len(failed)} cases failed: {folder / 'proof.html'}, proof.json")


_CAPTION = "What was said about each cause that was concealed alone; numbers are cases, blue is their share."


def write_page(
    path: Path, table: Table, picture: Path, failed: Sequence[Mapping[str, Any]], about: Mapping[str, str]
) -> None:
    """Write the page; `picture`: of `draw_confusion`, `about`: facts on the run, by name."""
    cases = Table(dict.fromkeys(("case", "kind", "concealed", "verdict", "claimed"), ""), title="Failures")
    for one in failed:
        cases.add(case=one["case"], kind=one["kind"], concealed=_flat(one["truth"]), verdict=one["verdict"],
                  claimed=f"{_flat(one['claimed'])} {one['why']}")  # fmt: skip
    shown = [
        Section(heading="Standards", table=table),
        Section(heading="confusion", text=_CAPTION, picture=picture),
        Section(heading="Failures", table=cases) if failed else Section(heading="Failures", text="None."),
    ]
    write_atomic(path, results_page("Proof on sealed cases", about, shown).encode())


def _flat(data: Mapping[str, Any]) -> str:
    return yaml.safe_dump(_rounded(data), default_flow_style=True, width=10**6).strip() if data else ""


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


_VERDICTS = ("no_mismatch", "unknown", "partly_explained", "modelled", "explained", "refused")


def draw_confusion(matrix: dict[str, dict[str, int]], path: Path) -> None:
    """Confusion matrix. Rows: concealed causes; columns: claimed ones."""
    rows = sorted(matrix, key=lambda name: (name == "nothing", name))
    said = {name for counts in matrix.values() for name in counts}
    columns = [name for name in rows if name in said] + sorted(said - set(rows) - set(_VERDICTS))
    columns += [name for name in _VERDICTS if name in said]
    share = np.array([[matrix[row].get(column, 0) / sum(matrix[row].values()) for column in columns] for row in rows])
    size = (1.8 + 0.22 * len(columns), 1.6 + 0.2 * len(rows))
    with figure(path, size=size) as (_, (axis,)):
        axis.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        axis.grid(visible=False)
        axis.set_xticks(range(len(columns)), [name.replace("_", " ") for name in columns], rotation=90, fontsize=7)
        axis.set_yticks(range(len(rows)), [name.replace("_", " ") for name in rows], fontsize=7)
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                if matrix[row].get(column):
                    axis.text(j, i, matrix[row][column], ha="center", va="center", fontsize=6,
                              color="white" if share[i, j] > 0.6 else "black")  # fmt: skip
        axis.set(xlabel="said", ylabel="concealed, alone")


if __name__ == "__main__":
    main()
