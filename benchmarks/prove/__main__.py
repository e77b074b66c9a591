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
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from benchmarks.prove import pictures
from benchmarks.prove.cases import PARTS, Case, draw, draw_parts
from benchmarks.prove.scores import Result, confusion, failures, standards
from hydro_bridge.cli import jobs
from hydro_bridge.cli.console import UserError, add_json_argument, command, number, writable_folder
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.viewer.runs import refresh_index
from hydro_sim.model.bench import Bench

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


def parser() -> argparse.ArgumentParser:
    """The command line."""
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.prove", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--cases", type=number(1, 100_000), default=20, metavar="N",
                         help="benches (default: 20; a proof: 224)")  # fmt: skip
    options.add_argument("--parts", nargs="+", metavar="KIND=N", help="so many of each kind, in place of --cases")
    options.add_argument("--seed", type=number(0), required=True, metavar="S", help="of everything that is drawn")
    options.add_argument("--out", type=Path, metavar="DIR", help="default: runs/proof-S-N; 9 MB a case")
    jobs.add_arguments(options)
    options.add_argument("--minutes", type=float, default=float("inf"),
                         help="begin no new case after so long; the same command goes on later")  # fmt: skip
    options.add_argument("--again", action="store_true",
                         help="diagnose again what another version of the diagnosis answered")  # fmt: skip
    add_json_argument(options)
    return options


def run(arguments: Sequence[str]) -> int:
    """Prove; 0 when cases are scored, 3 when time was up before."""
    chosen = parser().parse_args(arguments)
    from benchmarks.prove.blind import ANSWER

    cases = _drawn(chosen)
    until = time.monotonic() + 60.0 * chosen.minutes
    folder = writable_folder(chosen.out or Path("runs") / f"proof-{chosen.seed}-{len(cases)}").absolute()
    digest = seal(cases, folder / SEALED)
    print(f"sealed: {len(cases)} answers, SHA-256 {digest}", flush=True)
    recorded = _record(cases, folder / BLIND, chosen, until)
    if chosen.again:
        _forget_other_versions(folder)
    finished = recorded and _diagnose(folder / BLIND, until, **jobs.where(chosen))
    if not finished:
        done = sum((folder / BLIND / case.name / ANSWER).exists() for case in cases)
        print(f"time is up: {done} of {len(cases)} cases are diagnosed; the same command goes on")
        return 3
    answers = unseal(folder / SEALED, digest)
    print("opened: the answers are those that were sealed")
    said = [json.loads((folder / BLIND / case.name / ANSWER).read_text()) for case in answers]
    results = [Result(case=case, answer=one) for case, one in zip(answers, said, strict=True)]
    _show(results, folder, {"seed": str(chosen.seed), "cases": str(len(cases)), "SHA-256": digest}, chosen.json)
    return 0


@command(OSError)
def main() -> int:
    """Entry point; 2 for words that cannot be used, 3 when time was up, 130 after Ctrl-C."""
    return run(sys.argv[1:])


def _drawn(chosen: argparse.Namespace) -> list[Case]:
    if not chosen.parts:
        return draw(chosen.cases, chosen.seed)
    parts = dict(word.partition("=")[::2] for word in chosen.parts)
    for kind, count in parts.items():
        if kind not in PARTS or not count.isdigit():
            raise UserError(f"--parts {kind}={count}: must be a kind ({', '.join(PARTS)}) and a number")
    return draw_parts({kind: int(count) for kind, count in parts.items()}, chosen.seed)


def _record(cases: Sequence[Case], folder: Path, chosen: argparse.Namespace, until: float) -> bool:
    """Record all cases; False if time was up."""
    from benchmarks.prove.recording import record

    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "bench.yaml").exists():
        believed = yaml.safe_dump(Bench.nominal().to_mapping(), sort_keys=False)
        (folder / "bench.yaml").write_text(believed, encoding="utf-8")
    return record(cases, folder, until, **jobs.where(chosen))


SLICE = 4
"""Cases that one process diagnoses: a blindfold is not taken off again."""


def _diagnose(folder: Path, until: float, **where: Any) -> bool:
    """Have all cases diagnosed in processes of their own; False if time was up."""
    from benchmarks.prove.blind import waiting

    left = waiting(folder)
    slices = {left[at].name: (left[at : at + SLICE],) for at in range(0, len(left), SLICE)}
    return len(jobs.complete(_blindly, slices, **where, until=until, label="diagnosing", unit="slice")) == len(slices)


def _blindly(cases: Sequence[Path]) -> None:
    words = [sys.executable, "-m", "benchmarks.prove.blind", *map(str, cases)]
    done = subprocess.run(words, check=False, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        raise UserError(done.stderr.strip() or f"the diagnosis ended with status {done.returncode}")


def _forget_other_versions(folder: Path) -> None:
    """Remove what another version of the diagnosis answered."""
    from benchmarks.prove.blind import ANSWER, ENGINE

    for answer in (folder / BLIND).glob(f"*/{ANSWER}"):
        if json.loads(answer.read_text())["engine"] != ENGINE:
            answer.unlink()


def _show(results: Sequence[Result], folder: Path, about: dict[str, str], json_file: str | None) -> None:
    """Print the table; write proof.json, the pictures and proof.html."""
    from benchmarks.prove.blind import ENGINE

    engines = sorted({str(result.answer["engine"]) for result in results})
    about = {**about, "engine": ", ".join(engines)}
    table, failed = standards(results), failures(results)
    table.show(json_file)
    drawn = pictures.draw(results, folder)
    pictures.write_page(folder / "proof.html", table, drawn, failed, about)
    refresh_index(folder)
    content = {"about": about, "standards": table.rows, "confusion": confusion(results), "failures": failed,
               "floors": pictures.floors(results), "cases": [_row(result) for result in results]}  # fmt: skip
    write_whole(folder / "proof.json", (json.dumps(content, indent=1) + "\n").encode())
    if engines != [ENGINE]:
        others = ", ".join(other for other in engines if other != ENGINE)
        print(f"warning: cases were diagnosed by another version ({others}): --again diagnoses them again",
              file=sys.stderr)  # fmt: skip
    print(f"{len(failed)} cases failed: {folder / 'proof.html'}, proof.json")


def _row(result: Result) -> dict[str, Any]:
    """One case as it stands in proof.json."""
    case = result.case
    return {
        "case": case.name, "kind": case.kind, "label": case.label, "noise": case.noise, "size": case.size,
        "truth": {**case.effects, **case.outside}, "verdict": result.verdict, "claimed": result.claimed,
        "passed": result.passed, "located": result.located, "places": result.places,
        "held_out": result.held_out, "worst_channel": result.worst_channel(),
        "estimates": [{**vars(one), "error": one.error} for one in result.estimates],
        "wall": result.answer["wall"], "cpu": result.answer["cpu"],
    }  # fmt: skip


if __name__ == "__main__":
    main()
