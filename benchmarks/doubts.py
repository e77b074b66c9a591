# SPDX-License-Identifier: Apache-2.0
"""Each doubt of the diagnosis switched off, one at a time: what sealed cases, slow loggers and real rigs then say.

    python -m benchmarks.doubts --cases 40 --seed S --data FOLDER --json FILE
    python -m benchmarks.doubts --only insignificant "searched+harmful" --parts clean=20 faint=24 outside=24

A doubt withholds a name or a law that the search has found, or widens what is known of it. One that changes no figure
here has no measured case. After Ctrl-C the same command goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import parser
from benchmarks.prove.blind import ENGINE
from hydro_core.cli.console import Table, UserError, command, progress

SWITCH = "HYDRO_WITHOUT_DOUBT"
"""Environment variable that names the doubt that every process of a benchmark leaves out."""
NONE = "none"
Change = Callable[[Any], Any]
"""From what stands in the diagnosis to what takes its place."""


def _constant(value: Any) -> Change:
    return lambda before: value


def _answer(value: Any) -> Change:
    return lambda before: lambda *arguments: value


def _without_inflation(uncertainty: Any) -> Any:
    def plain(problem: Any, found: Any) -> Any:
        deviation, inflation = uncertainty(problem, found)
        return deviation, np.ones_like(inflation)

    return plain


_JUDGE, _SEARCH = "judge", "selection.search"
_INTERVALS, _NOISE, _PROBLEM = "estimation.intervals", "estimation.noise:SegmentNoise", "estimation.problem"
DOUBTS: dict[str, tuple[str, str, Change]] = {
    "searched": ("search: a claim below its smallest size, or the error of its signal, is not taken",
                 f"{_SEARCH}:all_significant", _answer(True)),
    "form errors": ("search: a claim that explains no more than an error in the form of its kin, and what others "
                    "explain beside it", f"{_SEARCH}:form_error", _answer(False)),
    "nearly all": ("judge: where names leave something, those that act there need 98 % of the squares",
                   f"{_JUDGE}:MIN_EXPLAINED_SHARE", _constant(0.0)),
    "insignificant": ("judge: an interval that includes absence",
                      f"{_INTERVALS}:_includes_neutral", _answer(False)),
    "harmful": ("judge: a name that makes what was held out worse", f"{_JUDGE}:_most_harmful", _answer(None)),
    "noisy signal": ("interval: noise in the acceleration that a mass multiplies",
                     f"{_PROBLEM}:mass_attenuation", _answer(0.0)),
    "missing rows": ("noise and interval: what half of the rows change", f"{_PROBLEM}:Problem._changes",
                     lambda old: lambda self, claims: {key: 0.0 * one for key, one in old(self, claims).items()}),
    "ringing": ("laws: none where a mass rings too fast for the rows",
                f"{_PROBLEM}:Problem.aliased_resonance", _constant(0.0)),
    "reversals": ("noise: the smoothed velocity is off where the piston turns round",
                  f"{_NOISE}._kink", lambda old: lambda self, claims: np.zeros_like(self._model.v)),
    "standstill": ("noise: the sign of friction near standstill, and the one above", f"{_NOISE}.friction",
                   lambda old: lambda self, *_: self._model.at_evaluated(np.zeros_like(self._model.v))),
    "flows": ("noise: timing and noise of the valve's flow", f"{_NOISE}._of_flows", _answer(None)),
    "sandwich": ("interval: residuals that are neither independent nor Gaussian",
                 f"{_INTERVALS}:_uncertainty", _without_inflation),
    "recurrence": ("interval: blocks of residuals that resemble their neighbours", f"{_INTERVALS}:_recurrence",
                   lambda old: lambda moves, blocks: np.ones(moves.shape[1])),
    "forms": ("interval: another form of a law that fits as well",
              "effects.dynamics:Stribeck.other_forms", _constant(())),
    "rough": ("curves first: rough recordings are named by their curve", "curves:ForceCurve.rough", _constant(False)),
}  # fmt: skip
"""By name: what it does; where it is in hydro_diagnosis, `module:attribute`; what leaves it out."""


def leave_out(names: str) -> None:
    """Leave a doubt, or several joined by `+`, out of every diagnosis of this process."""
    for _, place, change in (DOUBTS[name] for name in names.split("+")):
        module, _, attribute = place.partition(":")
        *owners, last = attribute.split(".")
        owner: Any = import_module(f"hydro_diagnosis.{module}")
        for one in owners:
            owner = getattr(owner, one)
        setattr(owner, last, change(getattr(owner, last)))


def proof(folder: Path, drawn: Sequence[str], doubt: str) -> dict[str, Any]:
    """Return proof.json of the sealed cases without a doubt; their recordings are those of `NONE`."""
    out, first = folder / doubt.replace(" ", "_"), folder / NONE
    if doubt != NONE and not out.exists():
        answers = shutil.ignore_patterns("answer.json", "corrected.yaml")
        shutil.copytree(first / "blind", out / "blind", copy_function=os.link, ignore=answers)
    _run(doubt, "benchmarks.prove", *drawn, "--out", str(out))  # leaves alone what this version has answered
    found: dict[str, Any] = json.loads((out / "proof.json").read_text())
    return found


def _run(doubt: str, module: str, *words: str) -> None:
    environment = {**os.environ, SWITCH: "" if doubt == NONE else doubt}
    done = subprocess.run(
        [sys.executable, "-m", module, *words], check=False, env=environment, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    if done.returncode:
        raise UserError(f"{module} without {doubt}: {done.stderr.strip()[-500:]}")


def written(folder: Path, doubt: str, name: str, module: str, *words: str) -> list[dict[str, Any]]:
    """Return the rows that a benchmark writes without a doubt, once for each version and `words`; none without data."""
    key = hashlib.sha256(json.dumps([ENGINE, words]).encode()).hexdigest()[:12]
    file = folder / doubt.replace(" ", "_") / f"{name}-{key}.json"
    if not file.exists():
        part = file.with_suffix(".part")
        part.unlink(missing_ok=True)
        _run(doubt, module, *words, "--json", str(part))
        if not part.exists():
            return []
        part.rename(file)
    held = json.loads(file.read_text())
    rows: list[dict[str, Any]] = held if isinstance(held, list) else held.get("scores", held.get("rows", []))
    return rows


COLUMNS = {
    "doubt": "that is left out",
    "right": "sealed cases that are right",
    "lost": "cases that were right with it",
    "gained": "cases that were wrong with it",
    "spurious": "claims of causes that are not there, in all cases",
    "coverage": "% of the 95 % intervals that hold the truth",
    "loggers": "names of what is there whose interval holds, of slow and lossy loggers",
    "others": "their claims of what is not there",
    "rigs": "claims of real rigs that their answers hold",
    "excluded": "claims that they exclude",
    "missed": "causes that they hold and that were not named",
    "verdicts": "verdicts that they rule out",
    "speeds": "steady speeds met",
}


def row(
    doubt: str, told: dict[str, Any], usual: dict[str, Any], loggers: Sequence[Any], rigs: Sequence[Any]
) -> dict[str, Any]:
    """A row of the table; `told`, `usual`: proof.json without the doubt and with all."""
    right, before = ({one["case"] for one in each["cases"] if one["passed"]} for each in (told, usual))
    inside = [two["inside"] for one in told["cases"] for two in one["estimates"]]
    wrong = sum(len(set(one["claimed"]) - set(one["truth"])) for one in told["cases"])
    curve = [two[-1] for one in rigs for two in one["curve"]]
    return {
        "doubt": doubt, "right": f"{len(right)}/{len(told['cases'])}", "lost": ", ".join(sorted(before - right)) or "-",
        "gained": ", ".join(sorted(right - before)) or "-", "spurious": wrong,
        "coverage": 100.0 * float(np.mean(inside)) if inside else float("nan"),
        "loggers": sum(one["holds"] is True for one in loggers), "others": sum(one["others"] for one in loggers),
        "rigs": sum(len(one["agree"]) for one in rigs), "excluded": sum(len(one["contradict"]) for one in rigs),
        "missed": sum(len(one["missed"]) for one in rigs), "verdicts": sum(not one["allowed"] for one in rigs),
        "speeds": f"{sum(curve)}/{len(curve)}",
    }  # fmt: skip


@command(OSError)
def main() -> None:
    """Leave out one after the other, and print the table."""
    options = parser("doubts", __doc__)
    options.add_argument("--cases", type=int, default=40, help="sealed cases (default: 40)")
    options.add_argument("--parts", nargs="+", metavar="KIND=N", help="so many of each kind, in place of --cases")
    options.add_argument("--seed", type=int, default=1, help="of the cases (default: 1)")
    options.add_argument("--data", type=Path, default=Path("runs/real_recordings"), metavar="FOLDER",
                         help="recordings of real rigs (default: %(default)s)")  # fmt: skip
    options.add_argument("--rigs", nargs="*", default=(), metavar="RIG", help="of them; default: all that are there")
    options.add_argument("--conditions", nargs="*", default=("100 Hz", "200 Hz", "1 kHz, 5 % lost"), metavar="NAME",
                         help="of benchmarks.logging_rates (default: three)")  # fmt: skip
    each = "; ".join(f"{name}: {words}" for name, (words, *_) in DOUBTS.items()).replace("%", "%%")
    options.add_argument(
        "--only", nargs="+", default=list(DOUBTS), metavar="DOUBT", help=f"or several joined by +: {each}"
    )
    options.add_argument("--out", type=Path, default=Path("runs/doubts"), metavar="DIR", help="default: %(default)s")
    chosen = options.parse_args()
    if unknown := {name for word in chosen.only for name in word.split("+")} - set(DOUBTS):
        raise UserError(f"no doubt {min(unknown)!r}; there are {', '.join(DOUBTS)}")
    table, usual, folder = Table(COLUMNS), None, chosen.out.absolute()
    cases = ["--parts", *chosen.parts] if chosen.parts else ["--cases", str(chosen.cases)]
    drawn = ["--seed", str(chosen.seed), *cases]
    for doubt in progress([NONE, *chosen.only], label="doubts", unit="doubt"):
        told = proof(folder, drawn, doubt)
        usual = usual or told
        with ThreadPoolExecutor(2) as both:  # each is one process
            words = "--seeds", "2", "--conditions", *chosen.conditions
            loggers = both.submit(written, folder, doubt, "loggers", "benchmarks.logging_rates", *words)
            words = *chosen.rigs, "--data", str(chosen.data.absolute())
            rigs = both.submit(written, folder, doubt, "rigs", "benchmarks.real_recordings", *words)
        table.add(**row(doubt, told, usual, loggers.result(), rigs.result()))
    table.show(chosen.json)


if __name__ == "__main__":
    main()
