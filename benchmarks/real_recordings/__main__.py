# SPDX-License-Identifier: Apache-2.0
"""The diagnosis on recordings of real rigs, beside answers that were obtained without it.

    python -m benchmarks.real_recordings --fetch                  from the public repositories that rigs/*.yaml names
    python -m benchmarks.real_recordings --json FILE              all rigs whose files are in the data folder
    python -m benchmarks.real_recordings emps lead_screw

Files lie in DATA/RIG/NAME. EMPS has to be put there by hand (nonlinearbenchmark.org).
"""

from __future__ import annotations

import hashlib
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pandas as pd
import yaml
from scipy.io import loadmat

from benchmarks._report import parser
from hydro_core.cli.console import Table, UserError, command, progress
from hydro_core.files.atomic import encode_json, write_atomic
from hydro_diagnosis import Diagnosis, InputError, diagnose
from hydro_diagnosis.report_json import EffectReport

RIGS = {path.stem: path for path in sorted((Path(__file__).parent / "rigs").glob("*.yaml"))}
ORIGIN = "https://raw.githubusercontent.com/{repository}/{commit}/{path}"
COLUMNS = {
    "rig": "",
    "verdict": "and a ! where the answer rules it out",
    "claims": "effects named, with their numbers; laws without a name",
    "agree": "claims that the answer holds: interval and tolerance overlap",
    "contradict": "claims that it excludes",
    "open": "claims that it cannot judge",
    "missed": "causes that it holds and that were not named",
    "curve": "steady speeds at which the force that the claims make is within the tolerance",
    "accounted": "% of the force that the bench file misses on what was held out that names account for (all terms)",
    "left": "% of the error of the bench file alone that is left on what was held out, worst channel",
    "cpu": "s of CPU",
    "work": "s of CPU as the budget counts them",
}


@dataclass
class Score:
    """A diagnosis beside an answer."""

    rig: str
    verdict: str
    allowed: bool
    agree: list[str] = field(default_factory=list)
    contradict: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    curve: list[tuple[float, float, float, bool]] = field(default_factory=list)
    """Speed [m/s], force of the answer, force of the claims [N], within the tolerance."""
    accounted: dict[str, dict[str, float]] = field(default_factory=dict)
    left: dict[str, float] = field(default_factory=dict)
    claims: list[str] = field(default_factory=list)
    laws: list[str] = field(default_factory=list)
    """Terms without a name."""
    cpu: float = 0.0
    work: float = 0.0
    note: str = ""


def recording(paths: Sequence[Path], rig: Mapping[str, Any]) -> pd.DataFrame:
    """Signals of the files of one recording, in SI units, by field of BenchState.

    Expressions see the columns of the file (`name_K` is column K of a matrix) and `row`, the number of the row.
    """
    parts = [_read(path, rig.get("read", {})) for path in paths]
    table = parts[0] if len(parts) == 1 else pd.concat(parts, axis=1, ignore_index=True).add_prefix("c_")
    table["row"] = np.arange(len(table), dtype=float)
    return pd.DataFrame({name: table.eval(str(one), engine="python") for name, one in rig["signals"].items()})


def _read(path: Path, how: Mapping[str, Any]) -> pd.DataFrame:
    if path.suffix not in (".mat", ".npz"):
        return pd.read_csv(path, **how)
    held = dict(np.load(path)) if path.suffix == ".npz" else loadmat(path, squeeze_me=True)
    arrays = {name: np.asarray(one, dtype=float) for name, one in held.items() if not name.startswith("__")}
    columns: dict[str, Any] = {}
    for name, one in arrays.items():
        columns |= {name: one} if one.ndim < 2 else {f"{name}_{k}": part for k, part in enumerate(one.T)}
    rows = max(np.size(one) for one in columns.values())
    return pd.DataFrame({name: one for name, one in columns.items() if np.size(one) in (1, rows)}, index=range(rows))


def diagnosed(rig: Mapping[str, Any], folder: Path) -> Diagnosis:
    """Diagnose the recordings in a folder."""
    with tempfile.TemporaryDirectory() as scratch:
        made: dict[str, list[Path]] = {"fitted": [], "held_out": []}
        for role, paths in made.items():
            files = [folder / Path(path).name for path in rig[role]]
            for number, group in enumerate([files] if rig.get("side_by_side") and files else [[one] for one in files]):
                paths.append(Path(scratch) / f"{role}-{number}.csv")
                recording(group, rig).to_csv(paths[-1], index=False)
        return diagnose(made["fitted"], holdout=made["held_out"], bench=rig["bench"], estimate=rig.get("estimate", ()))


def force(effects: Sequence[EffectReport], speed: float) -> float:
    """Hydraulic force [N] that the named effects need at a steady speed [m/s]."""
    side, sign, total = ("positive" if speed > 0.0 else "negative"), float(np.sign(speed)), 0.0
    for one in effects:
        value = {name: estimate.value for name, estimate in one.parameters.items()}
        match one.id:
            case "friction_coulomb":
                total += sign * value.get("force", value.get(f"force_{side}", 0.0))
            case "friction_viscous":
                total += speed * value.get("coefficient", value.get(f"coefficient_{side}", 0.0))
            case "friction_stribeck":
                total += sign * value["breakaway_force"] * float(np.exp(-np.square(speed / value["velocity"])))
            case "force_offset":
                total -= value["force"]
    return total


def scored(name: str, rig: Mapping[str, Any], found: Diagnosis) -> Score:
    """Hold a report against the answer."""
    report, answer = found.report, rig["answer"]
    score = Score(name, report.verdict, report.verdict in answer["verdict"], cpu=0.0)
    score.claims = [
        f"{one.id}({', '.join(f'{two.value:.4g}' for two in one.parameters.values())})" for one in report.effects
    ]
    score.laws = [f"law in {one.equation}" for one in report.closures]
    for effect in report.effects:
        known = answer.get("numbers", {}).get(effect.id, {})
        wrong = []
        for key in known.keys() & effect.parameters.keys():
            one, (right, tolerance) = effect.parameters[key], known[key]
            low, high = one.ci95 or (one.value, one.value)
            if not low - tolerance <= right <= high + tolerance:
                wrong.append(f"{effect.id}: {key} = {one.value:.4g} ({low:.4g} to {high:.4g}), answer {right:.4g}")
        if wrong or effect.id not in (*known_ids(answer), *answer["possible"]):
            score.contradict += wrong or [f"{effect.id}: {effect.sentence}"]
        else:
            (score.agree if effect.id in known_ids(answer) else score.open).append(effect.id)
    named = {effect.id for effect in report.effects}
    score.missed = [one for one in answer["named"] if one not in named]
    score.missed += [" or ".join(some) for some in answer.get("any_of", ()) if not named & set(some)]
    if report.verdict != "unknown":
        for speed, right, tolerance in answer.get("curve", ()):
            said = force(report.effects, speed)
            score.curve.append((speed, right, said, abs(said - right) <= tolerance))
    score.accounted = report.accounted
    for channel, one in {**report.fit["holdout"], **report.fit["equations"]}.items():
        share = 100.0 * one["rmse_after"] / one["rmse_before"]
        if np.isfinite(share):
            score.left[channel] = share
    return score


def known_ids(answer: Mapping[str, Any]) -> set[str]:
    """Effects that the answer holds."""
    return {*answer["named"], *answer.get("numbers", {}), *(one for some in answer.get("any_of", ()) for one in some)}


def carried_out(name: str, folder: Path) -> Score:
    """Diagnose one rig and score it."""
    rig = yaml.safe_load(RIGS[name].read_text())
    begun = time.process_time()
    try:
        found = diagnosed(rig, folder)
    except Exception as error:  # a rig that breaks the diagnosis is a row too
        verdict = "refused" if isinstance(error, InputError) else "crashed"
        missed, note = list(rig["answer"]["named"]), f"{verdict}: {error}"
        cpu = time.process_time() - begun
        return Score(name, verdict, verdict in rig["answer"]["verdict"], missed=missed, note=note, cpu=cpu)
    score = scored(name, rig, found)
    score.cpu, score.work = time.process_time() - begun, found.problem.budget.spent
    if found.report.lost:
        score.allowed, score.note = False, "; ".join(one.sentence for one in found.report.lost)
    return score


def ready(name: str, folder: Path, *, fetch: bool) -> bool:
    """Whether all files of a rig are there, with the digests of its YAML; `fetch` downloads what is not."""
    rig, there = yaml.safe_load(RIGS[name].read_text()), True
    for path, digest in {**rig["fitted"], **rig["held_out"]}.items():
        file = folder / Path(path).name
        if fetch and rig["repository"] and not file.exists():
            url = ORIGIN.format(repository=rig["repository"], commit=rig["commit"], path=quote(path))
            file.parent.mkdir(parents=True, exist_ok=True)
            try:
                with urllib.request.urlopen(url) as answer:
                    file.write_bytes(answer.read())
            except urllib.error.URLError as error:
                raise UserError(f"{url}: {error}") from None
        if file.exists() and hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            raise UserError(f"{file}: not the file whose digest {RIGS[name].name} holds")
        there &= file.exists()
    return there


@command()
def main() -> None:
    """Diagnose the rigs whose recordings are there and print the table."""
    options = parser("real_recordings", __doc__)
    options.add_argument("rigs", nargs="*", metavar="RIG", help=f"default all: {', '.join(RIGS)}")
    options.add_argument("--data", type=Path, default=Path("runs/real_recordings"), metavar="FOLDER",
                         help="recordings (default: runs/real_recordings)")  # fmt: skip
    options.add_argument("--fetch", action="store_true", help="download them first")
    chosen = options.parse_args()
    if unknown := set(chosen.rigs) - set(RIGS):
        raise UserError(f"no rig {min(unknown)!r}; there are {', '.join(RIGS)}")
    table, scores = Table(COLUMNS), []
    for name in progress(chosen.rigs or list(RIGS), label="real recordings", unit="rig"):
        if not ready(name, chosen.data / name, fetch=chosen.fetch):
            print(f"{name}: skipped, its recordings are not in {chosen.data / name}")
            continue
        score = carried_out(name, chosen.data / name)
        scores.append(asdict(score))
        right = [one[-1] for one in score.curve]
        shares = [f"{100 * one['named']:.0f} ({100 * one['all']:.0f})" for one in score.accounted.values()]
        table.add(
            rig=score.rig, verdict=score.verdict + ("" if score.allowed else " !"),
            claims=", ".join([*score.claims, *score.laws]) or "-", agree=len(score.agree),
            contradict=len(score.contradict), open=len(score.open), missed=len(score.missed),
            curve=f"{sum(right)}/{len(right)}" if right else "-", accounted=", ".join(shares) or "-",
            left=max(score.left.values(), default=float("nan")), cpu=score.cpu, work=score.work,
        )  # fmt: skip
        if chosen.json:
            write_atomic(chosen.json, encode_json({"scores": scores}))
    print(table.text())
    for one in scores:
        for text in (*one["contradict"], *([one["note"]] if one["note"] else [])):
            print(f"{one['rig']}: {text}")


if __name__ == "__main__":
    main()
