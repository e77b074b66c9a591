# SPDX-License-Identifier: Apache-2.0
"""Second and third stage: causes of the table are searched for and judged, the remainder is modelled by laws.

Names and laws are tried on the held-out recordings, and withdrawn where they predict these worse. Names that the
recordings contradict are dropped, and what they leave is modelled again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hydro_diagnosis import stage_bar
from hydro_diagnosis.bench_numbers import can_simulate
from hydro_diagnosis.closure.admission import Admitted, admitted, reports, without_harmful_names
from hydro_diagnosis.closure.model_selection import closures
from hydro_diagnosis.effects.base import Effect
from hydro_diagnosis.estimation.fit import Fit, fit, noticeable
from hydro_diagnosis.estimation.intervals import Interval, all_exclude_neutral, intervals, without_insignificant
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design import next_for_law, next_recording
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.selection.effect_summary import made_worse, made_worse_in_all, withheld
from hydro_diagnosis.selection.localisation import locate_claims
from hydro_diagnosis.selection.outcome import Outcome
from hydro_diagnosis.selection.reliability import contradicted
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.selection.steady_motion import FRICTION, curves
from hydro_diagnosis.selection.verdict import Assessment, assess, refuted, unexplained
from hydro_diagnosis.stages.reading import Progress, StageResult
from hydro_diagnosis.validation import Known, equation_errors, held_out


def search_causes(search: Search, held: Sequence[Segment]) -> StageResult:
    """Names that account for the recordings, unless they make the held-out ones worse."""
    progress = search.progress
    progress(stage_bar.SEARCHING)
    outcome = search.run()
    problem = outcome.problem
    progress(stage_bar.JUDGING)
    assessment, bounds = _assess(problem, outcome)
    models = [SegmentModel(segment, problem.bench) for segment in held]
    progress(stage_bar.CHECKING)
    holdout = Problem(held, problem.bench, problem.baseline, noise=problem.sensor_noise)
    holdout = holdout.weighed(assessment.fit.claims)
    simulated: Known = {}
    proof = held_out(problem, holdout, assessment.fit.claims, models, simulated)
    found = StageResult(
        problem=problem, outcome=outcome, assessment=assessment, bounds=bounds, models=models, holdout=holdout,
        simulated=simulated, proof=proof,
    )  # fmt: skip
    if assessment.verdict == "explained" and (worse := made_worse(proof)):
        return _withdraw(found, outcome.nothing, worse)
    return replace(found, next_recording=_next_recording(found))


def model_claims(names: StageResult, search: Search) -> StageResult:
    """Names that the recordings do not contradict, and laws for what they leave."""
    refused: dict[str, str] = {}
    earlier: list[Fit] = []
    while True:
        library = [effect for effect in search.library if effect.named and effect.label not in refused]
        found = withdraw_if_worse(model_remainder(names, library, search.progress), names)
        reasons = _contradicted(found, earlier, search.settings.threshold)
        unsure = found.closures and reasons and reasons.keys() <= names.names
        if unsure and not _contradicted(names, earlier, search.settings.threshold):
            found, reasons = names, {}  # alone they hold: it is the law beside which they do not
        if not reasons:
            return replace(found, refused=refused)
        refused |= reasons
        earlier.append(found.assessment.fit)
        claims = names.assessment.fit.claims
        kept = tuple(claim for claim in claims if claim.effect.label not in refused)
        ids = {claim.effect.id for claim in kept}
        kept = tuple(claim for claim in kept if set(claim.effect.needs) <= ids)
        names = _withdraw(names, fit(names.problem, kept) if kept else names.outcome.nothing)


def _contradicted(found: StageResult, earlier: Sequence[Fit], threshold: float) -> dict[str, str]:
    """`contradicted`, with what it needs; `earlier`: fits with names that are refused by now."""
    problem, fitted = found.problem, found.assessment.fit
    noise = found.proof.get("equations", {}).get("motion", {}).get("noise_floor", 0.0)
    points = curves(problem, fitted.claims).get(FRICTION, ()) if fitted.judged else ()
    searched = [] if found.closures else [found.outcome.fit]
    return contradicted(problem, fitted, [*earlier, *searched], found.bounds, points, noise, threshold)


def withdraw_if_worse(found: StageResult, names: StageResult) -> StageResult:
    """`found`, or neither names nor closures where on the whole the held-out recordings are predicted worse with them.

    `names`: the same before closures.
    """
    worse = made_worse_in_all(found.proof) if found.names else ""
    return _withdraw(names, names.outcome.nothing, worse) if worse else found


def _withdraw(found: StageResult, kept: Fit, worse: str = "") -> StageResult:
    """The claims of `kept` alone, with a note on the others if they are `worse` on held-out recordings."""
    problem = found.problem
    assessment = refuted(problem, found.assessment, kept)
    holdout = found.holdout.weighed(assessment.fit.claims)
    bare = replace(
        found,
        holdout=holdout,
        assessment=assessment,
        bounds=intervals(problem, assessment.fit),
        proof=held_out(problem, holdout, assessment.fit.claims, found.models, found.simulated),
        withdrawn=withheld(found.assessment.fit.judged, worse, whole=not found.assessment.remainder) if worse else "",
    )
    return replace(bare, next_recording=_next_recording(bare))


def _next_recording(found: StageResult) -> dict[str, Any] | None:
    """The next recording; None where the bench file is not known enough to rehearse one."""
    problem = found.problem
    return next_recording(problem, found.outcome, found.assessment) if can_simulate(problem.bench) else None


def _assess(problem: Problem, outcome: Outcome) -> tuple[Assessment, list[Interval]]:
    """Return assessment and intervals; claims whose intervals include neutral are dropped, the rest is judged again."""
    assessment = assess(problem, outcome.fit, outcome.nothing)
    while True:
        sure, bounds = without_insignificant(problem, assessment.fit)
        if len(sure.claims) == len(assessment.fit.claims):
            return assessment, bounds
        assessment = assess(problem, sure, outcome.nothing)


def model_remainder(names: StageResult, library: Sequence[Effect], progress: Progress) -> StageResult:
    """Names and closure together; the names alone where nothing remains, or no closure is admitted.

    Nor is any sought where what remains may be a ringing that the rows are too slow to show. `library`: causes that may
    stand beside it.
    """
    if not names.assessment.remainder or names.problem.budget.exhausted or names.problem.unseen_ringing:
        return names
    progress(stage_bar.MODELLING)
    problem, holdout = names.problem, names.holdout
    candidates = (without_harmful_names(one, holdout) for one in closures(problem, names.assessment, library))
    found = admitted(problem, holdout, candidates, names.models, names.proof, names.simulated)
    bounds = intervals(found.closed.problem, found.closed.fit) if found else []
    if not found or not all_exclude_neutral(found.closed.fit.claims, bounds):
        return names
    beside = replace(
        names,
        problem=found.closed.problem,
        assessment=_closed(found.closed.problem, names.assessment, found),
        bounds=bounds,
        closures=reports(found, bounds),
    )
    ahead = names.next_recording if beside.names == names.names else None  # it would tell apart what is not claimed
    if ahead is None and can_simulate(problem.bench):
        ahead = next_for_law(beside.problem, found.closed.fit, found.closed.screen)
    holdout = holdout.weighed(found.closed.fit.claims)
    proof = {**found.held, "equations": equation_errors(holdout, found.closed.fit.claims)}
    return replace(beside, holdout=holdout, proof=proof, next_recording=ahead)


def _closed(problem: Problem, assessment: Assessment, found: Admitted) -> Assessment:
    """The judgement with a closure: `model_remainder` where it leaves nothing, else something remains as before."""
    claims = found.closed.fit.claims
    labels = {claim.effect.label for claim in claims}
    dropped = tuple(claim for claim in assessment.dropped if claim.effect.label not in labels)
    places = tuple(locate_claims(problem, found.closed.fit, problem.residual(())))
    assessment = replace(assessment, fit=found.closed.fit, places=places, dropped=dropped)
    if not noticeable(problem, found.closed.fit.residual):
        return replace(assessment, verdict="modelled", remainder=(), forms=())
    search_causes = any(claim.effect.named and not claim.effect.estimated for claim in claims)
    verdict = "partly_explained" if search_causes else assessment.verdict
    remainder, forms = unexplained(problem, found.closed.fit)
    return replace(assessment, verdict=verdict, remainder=remainder or assessment.remainder, forms=forms)
