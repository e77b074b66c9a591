# SPDX-License-Identifier: Apache-2.0
"""First stage: recordings and the baseline bench become a problem, and the candidates that can act on it.

The baseline is the assumed bench, as a `Bench` whose `effects` are known and are not claimed again. It comes from a
bench.yaml, from a diagnosis' corrected.yaml, or from the learned weights of `ros2 run hydro_sim learn`: then the
constants that were learned are the bench's numbers, and spool, leak, friction, bristles and amplifier its effects.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from importlib import metadata
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hydro_bridge.bags.recording import RecordingError, stream_bag
from hydro_diagnosis import stage_bar
from hydro_diagnosis.bench_numbers import applies, completed, hiding, lacks, left_out, read_bench, refuse_missing
from hydro_diagnosis.effects import CANDIDATES
from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Effect
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.unknown_numbers import estimated_claims, refuse_inestimable, starting_bench
from hydro_diagnosis.findings import ClosureReport
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.table import is_bag
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.loading import load_dataset
from hydro_diagnosis.recording import InputError, Segment
from hydro_diagnosis.report.corrected_bench import claims_of
from hydro_diagnosis.selection.outcome import Outcome
from hydro_diagnosis.selection.verdict import Assessment
from hydro_diagnosis.validation import Known
from hydro_diagnosis.wiring import Doubt
from hydro_sim.files.weights import WeightsError
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench
from hydro_sim.structured.model import StructuredModel


def recording_entry(path: str | Path) -> dict[str, Any]:
    """`name`, and `begin` [s since 1970] of a bag with /hydro/state; None for files of other loggers."""
    path = Path(path)
    if not is_bag(path):
        return {"name": path.stem, "begin": None}
    try:
        return {"name": path.name, "begin": float(next(stream_bag(path))["time"][0])}
    except (RecordingError, StopIteration, IndexError):  # a bag of other topics
        return {"name": path.stem, "begin": None}


NUMBERS = (
    "bulk_modulus", "piston_area", "area_ratio", "dead_volume_a", "dead_volume_b", "supply_pressure", "tank_pressure",
    "moving_mass", "viscous_friction", "spring_stiffness", "spring_rest_position", "stroke",
)  # fmt: skip
"""Learned constants that are numbers of a bench."""
GAINS = ("valve_gain_a_positive", "valve_gain_a_negative", "valve_gain_b_positive", "valve_gain_b_negative")
GAIN_ALIKE = 0.002
"""Share by which the four learned gains may differ from their mean without a note."""


@dataclass(frozen=True)
class Baseline:
    """The assumed bench, its origin, and the parts of it that the diagnosis cannot represent."""

    bench: Bench
    model: str
    """`analytic`, or `learned` and the file's name."""
    notes: tuple[str, ...] = ()


def baseline(
    bench: Bench | Mapping[str, Any] | str | Path | None,
    model: str | Path | None = None,
    estimated: Collection[str] = (),
) -> Baseline:
    """The baseline of a bench, of a bench's file or its content (None: the nominal one), or of learned weights.

    Of a bench whose file lacks numbers it is a `PartialBench`; `estimated`: those that will be estimated.

    Raises
    ------
    InputError
        If a file cannot be read, if both are given, or if the weights hold no equations.
    """
    if model is not None:
        if bench is not None:
            raise InputError("give a bench file or learned weights as baseline, not both: weights hold a bench")
        return _learned(Path(model))
    try:
        return Baseline(bench if isinstance(bench, Bench) else _read(bench, frozenset(estimated)), "analytic")
    except ValueError as error:
        raise InputError(str(error)) from None


def _read(bench: Mapping[str, Any] | str | Path | None, estimated: frozenset[str]) -> Bench:
    if bench is None:
        return Bench.nominal()
    return completed(bench, estimated) if isinstance(bench, Mapping) else read_bench(bench, estimated)


def _learned(path: Path) -> Baseline:
    try:
        learned = Learned.load(path).model
    except WeightsError as error:
        raise InputError(str(error)) from None
    constants = {entry["name"]: float(entry["value"]) for entry in learned.header()["constants"]}
    return Baseline(bench_of(constants, learned.bench), f"learned {path.name}", tuple(_left_out(constants, learned)))


def bench_of(constants: Mapping[str, float], start: Bench) -> Bench:
    """Learned constants as a bench with effects; `start` gives what is not learned."""
    limits = {entry.name: entry.metadata for entry in fields(start)}
    values = {name: min(max(constants[name], limits[name]["low"]), limits[name]["high"]) for name in NUMBERS}
    gain = sum(constants[name] for name in GAINS) / len(GAINS)
    flow = gain * start.valve_nominal_current * sqrt(start.valve_nominal_pressure_drop / 2.0)
    return replace(
        start, **values, valve_nominal_flow=flow, load_cell_bandwidth=None, effects=tuple(_effects(constants))
    )


def _effects(c: Mapping[str, float]) -> list[dict[str, Any]]:
    """Effects of the learned model beyond a bench's numbers, as entries of a corrected.yaml."""
    entries = [
        _entry("valve_lag", bandwidth=c["spool_frequency"] / (2.0 * pi), damping=c["spool_damping"]),
        _entry("friction_coulomb", force=c["friction_coulomb"]),
        _entry("friction_stribeck", breakaway_force=c["friction_stribeck"], velocity=c["stribeck_velocity"]),
        _entry("friction_presliding", stiffness=c["bristle_stiffness"]),
        _entry("leakage_internal", coefficient=max(c["leakage_internal"], 0.0)),
        _entry(
            "sensor_lag",
            sensor="load_force",
            bandwidth=c["load_cell_frequency"] / (2.0 * pi),
            damping=c["load_cell_damping"],
        ),
        _entry("valve_offset", current=c["valve_offset"]),
    ]
    if c["force_h_bias"]:
        entries.append(_entry("load_cell_bias", cell="hydraulic_force", force=c["force_h_bias"]))
    return entries


def _entry(identifier: str, **values: Any) -> dict[str, Any]:
    options = {name: value for name, value in values.items() if isinstance(value, str)}
    numbers = {name: value for name, value in values.items() if not isinstance(value, str)}
    return {"id": identifier, **options, "parameters": numbers}


def _left_out(constants: Mapping[str, float], learned: StructuredModel) -> list[str]:
    """Parts of the learned model that the baseline lacks, one sentence each."""
    notes = []
    gains = [constants[name] for name in GAINS]
    spread = (max(gains) - min(gains)) / (2.0 * sum(gains) / len(gains))
    if spread > GAIN_ALIKE:
        notes.append(f"the learned valve gains differ by {100 * spread:.2g} % around their mean, which was taken")
    last = learned.compiled[1]
    if last.w3.any() or last.b3.any():
        notes.append("the learned model's network, which adds to flows and force, is not part of the baseline")
    return notes


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
    """Input of a diagnosis: recordings, baseline, and options."""

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
    refuse_inestimable(estimate)
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
    ruled_out = [effect for effect in CANDIDATES if effect not in unruled and effect.named]
    problem = Problem(
        fitted, believed, baseline_claims,
        estimated=estimated_claims(believed, estimate), ruled_out=_acting(ruled_out, believed),
    )  # fmt: skip
    if not np.isfinite(problem.residual(())).all():
        raise InputError(
            "the recordings and the bench file give residuals that are not finite: check units and numbers"
        )
    facts = {
        "checked": [name for block, names in EQUATIONS.items() if block in problem.blocks for name in names],
        "not_checked": [name for block, names in EQUATIONS.items() if block not in problem.blocks for name in names],
        "recordings": [recording_entry(path) for path in (*question.recordings, *question.holdout)],
        "data_quality": [*base.notes, *_untried(question.without), *left_out(channels, believed), *quality],
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


def _untried(without: Sequence[str]) -> list[str]:
    return [f"--without {' '.join(without)}: these causes were not tried"] if without else []


def _acting(effects: Sequence[Effect], bench: Bench) -> list[Effect]:
    return [effect.adapted(bench) for effect in effects if applies(effect, bench)]


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


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """Claims at the end of a stage, and their validation."""

    problem: Problem
    outcome: Outcome
    assessment: Assessment
    bounds: list[Interval]
    """Intervals of the claims' parameters."""
    models: list[SegmentModel]
    """Held-out recordings."""
    holdout: Problem
    """The same, weighed for the claims."""
    simulated: Known
    """Simulations of the held-out recordings so far."""
    proof: dict[str, Any]
    """`fit` of report.json."""
    withdrawn: str = ""
    """Note on names that were taken back, since they predict the held-out recordings worse; else empty."""
    closures: list[ClosureReport] = field(default_factory=list)
    next_recording: dict[str, Any] | None = None
    """The recording that separates the closest rivals among the claims."""

    @property
    def names(self) -> set[str]:
        """Labels of the named claims."""
        return {claim.effect.label for claim in self.assessment.fit.claims if claim.effect.named}
