# SPDX-License-Identifier: Apache-2.0
"""`diagnose`: from recordings to a report. The stages in order; each is documented in its own module."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from importlib import metadata
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from hydro_bridge.process import endings
from hydro_diagnosis import stage_bar
from hydro_diagnosis.closure.admission import Admitted, admitted, reports
from hydro_diagnosis.closure.foretold import foretold
from hydro_diagnosis.closure.selection import closures
from hydro_diagnosis.dataset.loading import load_dataset
from hydro_diagnosis.effects import CANDIDATES
from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Effect
from hydro_diagnosis.estimation.free_form import free_forms
from hydro_diagnosis.estimation.intervals import Interval, all_hold, intervals, surely
from hydro_diagnosis.estimation.needed_numbers import acts, left_out, refuse_missing, rehearsable
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.unknown_numbers import refuse_others, standing, starting_bench
from hydro_diagnosis.estimation.unrecorded_rows import untold
from hydro_diagnosis.experiment_design.next_recording import next_recording
from hydro_diagnosis.experiment_design.rival_laws import next_for_law
from hydro_diagnosis.findings import INTERRUPTED, DiagnosisInterrupted, Report
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.identity import identified
from hydro_diagnosis.io.table import InputError
from hydro_diagnosis.model.baseline import baseline
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.partial_bench import hiding, lacks
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.report.corrected_bench import claims_of
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.selection.current_alignment import current_is_early, current_is_late
from hydro_diagnosis.selection.effect_summary import describe, location_of
from hydro_diagnosis.selection.foretelling import distrusted, made_worse, not_foretold, withheld
from hydro_diagnosis.selection.localisation import locate, locate_claims, noticeable
from hydro_diagnosis.selection.number_estimates import number_estimates
from hydro_diagnosis.selection.outcome import NAMES, Outcome, SearchSettings
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.selection.verdict import Assessment, assess, refuted
from hydro_diagnosis.validation.equations import equations_told, held_out
from hydro_diagnosis.validation.heldout import Known
from hydro_sim.model.bench import Bench

Progress = Callable[[str], None]


def diagnose(
    recordings: Sequence[str | Path],
    *,
    holdout: Sequence[str | Path] = (),
    bench: Bench | Mapping[str, Any] | str | Path | None = None,
    model: str | Path | None = None,
    columns: ColumnMap | Mapping[str, Any] | str | Path | None = None,
    without: Sequence[str] = (),
    estimate: Sequence[str] = (),
    as_wired: bool = False,
    settings: SearchSettings | None = None,
    progress: Progress = lambda text: None,
) -> Diagnosis:
    """Locate, name, size and model what a bench has and its simulation leaves out.

    Parameters
    ----------
    recordings
        rosbag2 folders, .mcap, or files of other loggers (see `table.read_table`).
    holdout
        Recordings on which nothing is fitted (all are read by joblib: `joblib.parallel_config` chooses backend and
        number of jobs); without, the last recording, or the last third of the only one.
    bench
        The baseline: a Bench, the path of a bench.yaml or corrected.yaml or its content, or None for the nominal one.
        A file or content needs only the numbers that the recorded channels connect (`needed_numbers`).
    model
        Learned weights as the baseline, in place of `bench` (structured ones: see `baseline`).
    columns
        Column map of a file, or of a bag's fields or topics: see `column_map`.
    without
        Causes that are ruled out, by id or by id and options (`friction_viscous:directional`): they are not tried.
    estimate
        Numbers of the bench file that are not known, or only roughly: they are estimated, and are no causes.
    as_wired
        Continue where channels contradict each other or the bench file (`wiring`), instead of refusing them.
    settings
        Of the search.
    progress
        Is told the stages.

    Raises
    ------
    InputError
        If a recording cannot be diagnosed, or numbers are missing that it needs, in one sentence.
    DiagnosisInterrupted
        On Ctrl-C once the recordings are read; its `report` holds what was finished.
    """
    started = time.monotonic()
    estimate = tuple(dict.fromkeys(estimate))
    refuse_others(estimate)
    base = baseline(bench, model, estimate)
    given = base.bench
    unruled = _candidates(without)
    progress(stage_bar.READING)
    read_with = hiding(given, estimate)
    fitted, held, quality = load_dataset(recordings, holdout, read_with, ColumnMap.load(columns), as_wired=as_wired)
    channels = set.intersection(*(set(segment.channels) for segment in fitted))
    refuse_missing(channels, given, estimate)
    believed, baseline_claims = given, claims_of(given)
    if estimate:
        progress("estimating " + ", ".join(estimate))
        with threadpool_limits(1, "blas"):
            believed = starting_bench(fitted, given, baseline_claims, estimate)
    candidates = [effect.adapted(believed) for effect in unruled if acts(effect, believed)]
    problem = Problem(fitted, believed, baseline_claims, estimated=standing(believed, estimate))
    ruled_out = [effect for effect in CANDIDATES if effect not in unruled and effect.named]
    problem.ruled_out = tuple(effect.adapted(believed) for effect in ruled_out if acts(effect, believed))
    if not problem.blocks:
        raise InputError("the recordings hold no channels that any equation connects")
    search = Search(problem, candidates, settings or NAMES, progress)
    facts: dict[str, Any] = {
        "checked": [name for block, names in _EQUATIONS.items() if block in problem.blocks for name in names],
        "not_checked": [name for block, names in _EQUATIONS.items() if block not in problem.blocks for name in names],
        "recordings": [identified(path) for path in (*recordings, *holdout)],
        "data_quality": [*base.notes, *left_out(channels, believed), *quality],
        "baseline": {"bench": given.to_mapping(), "model": base.model},
        "versions": {"hydro_diagnosis": _version()},
    }
    try:
        with threadpool_limits(1, "blas"):  # the matrices are thin: more threads only wait for one another
            return _diagnosed(search, held, facts, started, {name: _given(given, name) for name in estimate})
    except KeyboardInterrupt as interruption:
        raise DiagnosisInterrupted(_unfinished(search, facts, started), endings.status(interruption)) from None


def _diagnosed(
    search: Search, held: list[Segment], facts: Mapping[str, Any], begun: float, numbers: Mapping[str, float | None]
) -> Diagnosis:
    """Search, judge, prove; `facts` go into the report as they are; `numbers`: estimated ones as they were given."""
    problem, believed, progress = search.problem, search.problem.bench, search.progress
    progress(stage_bar.SEARCHING)
    outcome = search.run()
    progress(stage_bar.JUDGING)
    assessment, bounds = _judged(problem, outcome)
    late = current_is_late(problem, assessment)
    models = [SegmentModel(segment, believed) for segment in held]
    progress(stage_bar.CHECKING)
    unseen = Problem(held, believed, problem.baseline, noise=problem.sensor_noise)
    unseen.update_weights(assessment.fit.claims)
    simulated: Known = {}
    proof = held_out(problem, unseen, assessment.fit.claims, models, simulated)
    taken_back = ""
    if assessment.verdict == "explained" and (worse := made_worse(proof)):
        taken_back = withheld(assessment.fit.judged, worse)
        assessment = refuted(problem, assessment, outcome.nothing)
        bounds = intervals(problem, assessment.fit)
        unseen.update_weights(assessment.fit.claims)
        proof = held_out(problem, unseen, assessment.fit.claims, models, simulated)
    ahead = next_recording(problem, outcome, assessment) if rehearsable(believed) else None
    closing = []
    if assessment.remainder and not late:
        progress(stage_bar.MODELLING)
        names = [effect for effect in search.library if effect.named]
        candidates = (foretold(one, unseen) for one in closures(problem, assessment, names))
        closed = admitted(problem, unseen, candidates, models, proof, simulated)
        within = intervals(closed.closed.problem, closed.closed.fit) if closed else []
        if closed and all_hold(closed.closed.fit.claims, within):
            problem, bounds, before = closed.closed.problem, within, _names(assessment)
            assessment, closing = _closed(problem, assessment, closed), reports(closed, bounds)
            ahead = ahead if _names(assessment) == before else None  # it would tell names apart that are not claimed
            ahead = ahead or (next_for_law(problem, assessment.fit) if rehearsable(believed) else None)
            unseen.update_weights(assessment.fit.claims)
            proof = {**closed.held, "equations": equations_told(unseen, assessment.fit.claims)}
    problem.forget()
    hidden = untold(problem, assessment.fit, search.library, search.settings.threshold)
    effects = describe(problem, unseen, outcome, assessment, bounds)
    beyond = "" if assessment.remainder else not_foretold(unseen, assessment.fit.claims)
    cut_short, distrust = _cut_short(outcome, assessment), distrusted(made_worse(proof))
    said = (late, current_is_early(problem, effects), hidden, cut_short, beyond, taken_back, distrust)
    notes = tuple(note for note in said if note)
    report = Report(
        verdict=assessment.verdict,
        location=[location_of(place, problem) for place in assessment.places],
        effects=effects,
        remainder=_remainder(assessment, problem),
        closures=closing,
        estimated=number_estimates(problem, assessment.fit, bounds, search.library, numbers),
        fit=proof,
        next_recording=ahead,
        seconds=time.monotonic() - begun,
        steps=_steps(search),
        **{**facts, "data_quality": [*facts["data_quality"], *notes]},
    )
    return Diagnosis(report, believed, problem, assessment, outcome, models, notes)


def _given(bench: Bench, name: str) -> float | None:
    return None if lacks(bench, name) else float(getattr(bench, name))


def _cut_short(outcome: Outcome, assessment: Assessment) -> str:
    """Note on a search that ended before nothing paid; empty where it did not, or where names leave nothing."""
    if not outcome.cut_short or not assessment.remainder:
        return ""
    return f"the search for causes ended early ({outcome.cut_short}): there may be more than it names"


def _names(assessment: Assessment) -> set[str]:
    return {claim.effect.label for claim in assessment.fit.claims if claim.effect.named}


def _judged(problem: Problem, outcome: Outcome) -> tuple[Assessment, list[Interval]]:
    """Return assessment and intervals; claims whose intervals include neutral are dropped, the rest is judged anew."""
    assessment = assess(problem, outcome.fit, outcome.nothing)
    while True:
        sure, bounds = surely(problem, assessment.fit)
        if len(sure.claims) == len(assessment.fit.claims):
            return assessment, bounds
        assessment = assess(problem, sure, outcome.nothing)


def _closed(problem: Problem, assessment: Assessment, found: Admitted) -> Assessment:
    """The judgement with a closure: `modelled` where it leaves nothing, else something remains as before."""
    claims = found.closed.fit.claims
    labels = {claim.effect.label for claim in claims}
    dropped = tuple(claim for claim in assessment.dropped if claim.effect.label not in labels)
    places = tuple(locate_claims(problem, found.closed.fit, problem.residual(())))
    assessment = replace(assessment, fit=found.closed.fit, places=places, dropped=dropped)
    if not noticeable(problem, found.closed.fit.residual):
        return replace(assessment, verdict="modelled", remainder=(), forms=())
    named = any(claim.effect.named and not claim.effect.estimated for claim in claims)
    verdict = "partly_explained" if named else assessment.verdict
    forms = tuple(free_forms(problem, found.closed.fit)[:6])
    remainder = tuple(locate(problem, found.closed.fit.residual, forms)) or assessment.remainder
    return replace(assessment, verdict=verdict, remainder=remainder, forms=forms)


def _unfinished(search: Search, facts: Mapping[str, Any], begun: float) -> Report:
    """Return the report after Ctrl-C: the equations that can be checked, and the steps so far, which prove nothing."""
    return Report(
        verdict=INTERRUPTED,
        location=[],
        effects=[],
        remainder=None,
        fit={},
        next_recording=None,
        seconds=time.monotonic() - begun,
        steps=_steps(search),
        **facts,
    )


def _steps(search: Search) -> list[dict[str, Any]]:
    return [{"action": step.action, "label": step.label, "delta_bic": -step.score} for step in search.steps]


_EQUATIONS = {
    PRESSURE: ("pressure_a", "pressure_b", "actuation"),
    MOTION: ("motion",),
    LOAD: ("load",),
    HYDRAULIC: ("sensor",),
}
"""Equations that each block of residuals checks; `sensor`: the hydraulic force against the pressures."""


def _remainder(assessment: Assessment, problem: Problem) -> dict[str, Any] | None:
    if not assessment.remainder:
        return None
    equation = assessment.remainder[0].equation
    telling = [form for form in assessment.forms if form.gain > 0.0 and form.equation == equation]
    return {
        "location": [vars(location_of(place, problem)) for place in assessment.remainder],
        "depends_on": list(dict.fromkeys(form.variable for form in telling[:3])),
        "dropped": [claim.effect.id for claim in assessment.dropped if claim.effect.named],
        "looks_like": [claim.effect.sentence(claim.values) for claim in assessment.dropped if not claim.effect.named],
    }


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
