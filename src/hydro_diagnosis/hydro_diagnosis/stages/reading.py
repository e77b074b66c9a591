# SPDX-License-Identifier: Apache-2.0
"""First stage: recordings and the baseline bench become a problem, and the candidates that can act on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import metadata
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from hydro_diagnosis import stage_bar
from hydro_diagnosis.dataset.loading import load_dataset
from hydro_diagnosis.effects import CANDIDATES
from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Effect
from hydro_diagnosis.estimation.needed_numbers import acts, left_out, refuse_missing
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.unknown_numbers import refuse_others, standing, starting_bench
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.identity import identified
from hydro_diagnosis.io.table import InputError
from hydro_diagnosis.model.baseline import baseline
from hydro_diagnosis.partial_bench import hiding, lacks
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.report.corrected_bench import claims_of
from hydro_diagnosis.wiring.sizes import Doubt
from hydro_sim.model.bench import Bench

Progress = Callable[[str], None]
EQUATIONS = {
    PRESSURE: ("pressure_a", "pressure_b", "actuation"),
    MOTION: ("motion",),
    LOAD: ("load",),
    HYDRAULIC: ("sensor",),
}
"""Equations that each block of residuals checks; `sensor`: the hydraulic force against the pressures."""


@dataclass(frozen=True, kw_only=True)
class Question:
    """What is asked of a diagnosis."""

    recordings: Sequence[str | Path]
    holdout: Sequence[str | Path]
    bench: Bench | Mapping[str, Any] | str | Path | None
    model: str | Path | None
    columns: ColumnMap | Mapping[str, Any] | str | Path | None
    without: Sequence[str]
    estimate: Sequence[str]
    as_wired: bool


@dataclass(frozen=True, kw_only=True)
class Case:
    """A question, read."""

    question: Question
    problem: Problem
    candidates: list[Effect]
    held: list[Segment]
    """Recordings on which nothing is fitted."""
    facts: dict[str, Any]
    """Fields of the report that are known already."""
    numbers: dict[str, float | None]
    """Numbers to be estimated, as they were given."""
    wiring: str = ""
    """Note on how the recordings were taken, as they are or repaired, where both can be meant; else empty."""


def read(question: Question, progress: Progress, doubted: list[Doubt] | None = None) -> Case:
    """Read the recordings, check them against the bench file, begin the estimated numbers; `doubted`: `load_dataset`.

    Raises
    ------
    InputError
        If a recording cannot be diagnosed, or numbers are missing that it needs, in one sentence.
    """
    estimate = tuple(dict.fromkeys(question.estimate))
    refuse_others(estimate)
    base = baseline(question.bench, question.model, estimate)
    given = base.bench
    unruled = _candidates(question.without)
    progress(stage_bar.READING)
    fitted, held, quality = load_dataset(
        question.recordings, question.holdout, hiding(given, estimate), ColumnMap.load(question.columns), doubted
    )  # fmt: skip
    channels = set.intersection(*(set(segment.channels) for segment in fitted))
    refuse_missing(channels, given, estimate)
    believed, baseline_claims = given, claims_of(given)
    if estimate:
        progress("estimating " + ", ".join(estimate))
        with threadpool_limits(1, "blas"):
            believed = starting_bench(fitted, given, baseline_claims, estimate)
    problem = Problem(fitted, believed, baseline_claims, estimated=standing(believed, estimate))
    ruled_out = [effect for effect in CANDIDATES if effect not in unruled and effect.named]
    problem.ruled_out = tuple(_acting(ruled_out, believed))
    if not problem.blocks:
        raise InputError("the recordings hold no channels that any equation connects")
    facts = {
        "checked": [name for block, names in EQUATIONS.items() if block in problem.blocks for name in names],
        "not_checked": [name for block, names in EQUATIONS.items() if block not in problem.blocks for name in names],
        "recordings": [identified(path) for path in (*question.recordings, *question.holdout)],
        "data_quality": [*base.notes, *left_out(channels, believed), *quality],
        "baseline": {"bench": given.to_mapping(), "model": base.model},
        "versions": {"hydro_diagnosis": _version()},
    }
    numbers = {name: None if lacks(given, name) else float(getattr(given, name)) for name in estimate}
    return Case(
        question=question,
        problem=problem,
        candidates=_acting(unruled, believed),
        held=held,
        facts=facts,
        numbers=numbers,
    )


def _acting(effects: Sequence[Effect], bench: Bench) -> list[Effect]:
    return [effect.adapted(bench) for effect in effects if acts(effect, bench)]


def _candidates(without: Sequence[str]) -> list[Effect]:
    """Candidates of the search, except those ruled out."""
    names = {name for effect in CANDIDATES for name in (effect.id, effect.label)}
    for name in without:
        if name not in names:
            close = get_close_matches(name, names, 1)
            raise InputError(f"without: {name!r} is no effect" + (f", did you mean {close[0]!r}?" if close else ""))
    return [effect for effect in CANDIDATES if not {effect.id, effect.label} & set(without)]


def _version() -> str:
    try:
        return metadata.version("hydro_diagnosis")
    except metadata.PackageNotFoundError:
        return "0.1.0"
