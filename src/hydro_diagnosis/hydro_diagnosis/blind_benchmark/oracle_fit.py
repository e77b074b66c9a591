# SPDX-License-Identifier: Apache-2.0
"""Oracle fit, after the seal is opened: the true structure with fitted parameters, on the same held-out run.

No diagnosis can be expected to predict better; the difference is the cost of naming. Where exactly the concealed
causes were named, the diagnosis has fitted the true structure itself, and the fit is not repeated.
"""

from __future__ import annotations

import json
import os
import random
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from hydro_bridge.cli.console import progress
from hydro_diagnosis import InputError
from hydro_diagnosis.blind_benchmark.cases import FITTED, HELD, Case
from hydro_diagnosis.blind_benchmark.scores import Result
from hydro_diagnosis.effects import LIBRARY, Claim, Effect
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.loading import load_dataset
from hydro_diagnosis.validation import HORIZON, WINDOWS, compare
from hydro_sim.model.bench import Bench

KINDS = ("single", "faint", "value", "form", "pair", "triple")
"""Cases whose true structure is in the library."""


def rule(results: Sequence[Result], blind: Path, folder: Path, workers: int) -> list[Result]:
    """Return results with the held-out errors of the true structure, computed where missing and kept in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    judged = [result.case for result in results if result.case.kind in KINDS and not result.exact]
    missing = [case for case in judged if not (folder / f"{case.name}.json").exists()]
    random.shuffle(missing)  # as in `blind`: several can run side by side
    tasks = (delayed(_keep)(case, blind / case.name, folder / f"{case.name}.json") for case in missing)
    finished = Parallel(workers, return_as="generator_unordered")(tasks)
    for _ in progress(finished, total=len(missing), label="fitting the true structure", unit="case"):
        pass
    rulings = {case.name: json.loads((folder / f"{case.name}.json").read_text()) for case in judged}
    return [replace(result, ruling=rulings.get(result.case.name, {})) for result in results]


def _keep(case: Case, recordings: Path, path: Path) -> None:
    if path.exists():
        return
    scratch = path.with_suffix(f".{os.getpid()}")
    scratch.write_text(json.dumps(ruling(case, recordings)), encoding="utf-8")
    os.replace(scratch, path)


def ruling(case: Case, recordings: Path) -> dict[str, Any]:
    """Held-out error of the true structure by channel; empty if the recordings cannot be used."""
    bench = Bench.nominal()
    try:
        fitted, held, _ = load_dataset([recordings / name for name in FITTED], [recordings / HELD], bench)
    except InputError:
        return {}
    problem = Problem(fitted, bench)
    claims = true_fit(problem, case.effects, bench).claims
    models = [SegmentModel(segment, bench) for segment in held]
    errors = compare(models, (), claims, problem.sensor_noise, seconds=HORIZON, windows=WINDOWS, shooting=True)
    return {name: asdict(error) for name, error in errors.channels.items()}


def true_fit(problem: Problem, effects: Mapping[str, Mapping[str, Any]], bench: Bench) -> Fit:
    """The concealed causes, each in the library's form that fits best, from the true values."""
    best = fit(problem, ())
    for name, truth in effects.items():
        trials = [fit(problem, (*best.claims, claim)) for claim in _starts(name, truth, bench)]
        best = min(trials, key=lambda trial: trial.deviance)
    return best


def _starts(name: str, truth: Mapping[str, Any], bench: Bench) -> list[Claim]:
    places = {key: str(truth[key]) for key in ("chamber", "cell", "sensor") if key in truth}
    effects = [effect for effect in LIBRARY if effect.id == name and places.items() <= dict(effect.options).items()]
    return [Claim(effect.adapted(bench), _values(effect.adapted(bench), truth)) for effect in effects]


def _values(effect: Effect, truth: Mapping[str, Any]) -> dict[str, float]:
    return {one.name: float(truth.get(one.name, one.probes[0])) for one in effect.parameters}
