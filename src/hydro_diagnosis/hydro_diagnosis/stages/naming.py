# SPDX-License-Identifier: Apache-2.0
"""Second and third stage: causes of the table are searched for and judged, the remainder is modelled by laws.

Names and laws are tried on the held-out recordings, and withdrawn where they predict these worse. Names that the
recordings contradict are dropped, and what they leave is modelled again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hydro_diagnosis import stage_bar
from hydro_diagnosis.bench_numbers import can_simulate
from hydro_diagnosis.closure.admission import Admitted, admitted, reports, without_harmful_names
from hydro_diagnosis.closure.model_selection import closures
from hydro_diagnosis.effects.base import MOTION, Claim, Effect
from hydro_diagnosis.estimation.fit import QUANTILE, Fit, by_claim, fit, without_one
from hydro_diagnosis.estimation.intervals import (
    Interval,
    all_exclude_neutral,
    intervals,
    is_significant,
    without_insignificant,
)
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.experiment_design import next_for_law, next_recording
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.report_json import ClosureReport
from hydro_diagnosis.selection.localisation import locate_claims
from hydro_diagnosis.selection.search import Outcome, Search
from hydro_diagnosis.selection.steady_motion import FRICTION, Point, curves, missed, reproduced
from hydro_diagnosis.selection.verdict import Assessment, assess, refuted, unexplained
from hydro_diagnosis.stages.reading import Progress
from hydro_diagnosis.validation import Known, equation_errors, held_out


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """Claims at the end of a stage, and their validation."""

    problem: Problem
    outcome: Outcome
    assessment: Assessment
    bounds: list[Interval]
    """Intervals of the claims' parameters."""
    holdout: Problem
    """The held-out recordings, weighed for the claims."""
    simulated: Known
    """Simulations of the held-out recordings so far."""
    proof: dict[str, Any]
    """`fit` of report.json."""
    withdrawn: str = ""
    """Note on names that were taken back, since they predict the held-out recordings worse; else empty."""
    refused: Mapping[str, str] = field(default_factory=dict)
    """Reasons, by label, why names that fit are not claimed."""
    closures: list[ClosureReport] = field(default_factory=list)
    next_recording: dict[str, Any] | None = None
    """The recording that separates the closest rivals among the claims."""

    @property
    def names(self) -> set[str]:
        """Labels of the named claims."""
        return {claim.effect.label for claim in self.assessment.fit.claims if claim.effect.named}


def search_causes(search: Search, held: Sequence[Segment]) -> StageResult:
    """Names that account for the recordings, unless they make the held-out ones worse."""
    progress = search.progress
    progress(stage_bar.SEARCHING)
    outcome = search.run()
    problem = outcome.problem
    progress(stage_bar.JUDGING)
    assessment, bounds = _assess(problem, outcome)
    progress(stage_bar.CHECKING)
    holdout = problem.on(held).weighed(assessment.fit.claims)
    simulated: Known = {}
    proof = held_out(problem, holdout, assessment.fit.claims, simulated)
    found = StageResult(
        problem=problem, outcome=outcome, assessment=assessment, bounds=bounds, holdout=holdout,
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
        proof=held_out(problem, holdout, assessment.fit.claims, found.simulated),
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
    found = admitted(problem, holdout, candidates, names.proof, names.simulated)
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
    if not problem.noticeable(found.closed.fit.residual):
        return replace(assessment, verdict="modelled", remainder=(), forms=())
    search_causes = any(claim.effect.named and not claim.effect.estimated for claim in claims)
    verdict = "partly_explained" if search_causes else assessment.verdict
    remainder, forms = unexplained(problem, found.closed.fit)
    return replace(assessment, verdict=verdict, remainder=remainder or assessment.remainder, forms=forms)


WORSE = 1.1
"""Ratio of a held-out channel's error after to that before from which a model has made it worse."""
SHOWN = 1.35
"""Noise floors from which a simulated held-out channel's RMS error is more than noise and an uncertain start."""


def made_worse(proof: Mapping[str, Any]) -> str:
    """Held-out channels that the corrected model predicts worse than the bench file; empty where none is.

    `proof`: `fit` of report.json. Under much noise wrong names may leave nothing in what they were fitted to.
    """
    worse = [
        f"{channel} at {error['rmse_after'] / error['noise_floor']:.3g} noise floors instead of "
        f"{error['rmse_before'] / error['noise_floor']:.3g}"
        for channel, error in proof["holdout"].items()
        if error["rmse_after"] > max(WORSE * error["rmse_before"], SHOWN * error["noise_floor"])
    ]
    return "; ".join(worse)


def made_worse_in_all(proof: Mapping[str, Any]) -> str:
    """`made_worse`, where the squared errors beyond the noise have grown over all channels together; else empty."""
    ratios = [(error["rmse_before"], error["rmse_after"], error["noise_floor"]) for error in proof["holdout"].values()]
    grown = [max((after / floor) ** 2, 1.0) - max((before / floor) ** 2, 1.0) for before, after, floor in ratios]
    return made_worse(proof) if sum(grown) > 0.0 else ""


def withheld(claims: Sequence[Claim], worse: str, *, whole: bool) -> str:
    """Note on names that fit and are not handed back, since `worse` of the held-out recordings.

    `whole`: whether they leave nothing of what was fitted.
    """
    names = ", ".join(dict.fromkeys(claim.effect.id for claim in claims))
    share = "" if whole else "a part of "
    return (
        f"{names} would explain {share}the recordings that were fitted, but predict the held-out ones worse than the "
        f"bench file does ({worse}): not claimed; record with less noise or more motion"
    )


MOVED = 0.25
"""Share of its size by which a number may move when one recording is left out."""
MOST_SPEEDS = 0.5
"""Share of the steady speeds that claims may miss."""
_CONFIRMING = 4
"""Steps of the fit without a recording: it begins where the fit with all of them ended."""


def contradicted(
    problem: Problem,
    found: Fit,
    earlier: Sequence[Fit],
    bounds: Sequence[Interval],
    points: Sequence[Point],
    noise: float,
    threshold: float,
) -> dict[str, str]:
    """Reasons by label of named claims that the recordings contradict, though they fit.

    Parameters
    ----------
    earlier
        Fits with names that are not claimed any more, and nothing else that is not in `found`.
    bounds
        Of the parameters of all claims, in their order.
    points, noise
        Force over steady speed (`steady_motion.curves`), and the standard deviation [N] of a residual.
    threshold
        Evidence [BIC] that a claim needs: that of the search.
    """
    named = [claim for claim in found.judged if claim.effect.named]
    ends = [claim.effect.label for claim in named if not is_significant(claim)]
    reasons = dict.fromkeys(ends, "ends at a bound of what is physical, or is too small to matter")
    reasons |= dict.fromkeys(
        moved(problem, found, bounds), "moves by more than a quarter without one of the recordings"
    )
    turned = "has another size while the piston speeds up than while it slows down"
    reasons |= dict.fromkeys(differing(problem, found, bounds), turned)
    depends = "has another size beside names that are not claimed"
    reasons |= dict.fromkeys((label for one in earlier for label in apart(found, one, bounds)), depends)
    if reproduced(problem, found.claims) <= 0.0:
        unfounded = "in motion the equation predicts the force no better than the force's mean would"
        reasons |= {claim.effect.label: unfounded for claim in named if MOTION in claim.effect.blocks}
    for label, evidence in _evidence(problem, found, bounds).items():
        if evidence < threshold:
            reasons[label] = "by the number of its independent samples it may be chance"
    off = missed(points, noise)
    if len(off) > MOST_SPEEDS * len(points):
        for claim in named:
            others = curves(problem, found.but(claim))[FRICTION]
            without = {one.at: one.model for one in others}
            if any(abs(without[one.at] - one.model) > noise for one in off):
                reasons[claim.effect.label] = f"misses the force at {len(off)} of {len(points)} steady speeds"
    return reasons


def _evidence(problem: Problem, found: Fit, bounds: Sequence[Interval]) -> dict[str, float]:
    """Evidence [BIC] of each named claim by its label, by as many samples as are worth one that is independent."""
    evidence, needed = {}, {name for claim in found.claims for name in claim.effect.needs}
    for claim, own in by_claim(found.claims, bounds):
        variance = max((bound.inflation**2 for bound in own), default=1.0)
        if claim.effect.named and not claim.effect.estimated and claim.effect.id not in needed:
            rise = without_one(problem, found, claim).deviance - found.deviance
            evidence[claim.effect.label] = rise / variance - len(own) * float(np.log(len(found.residual) / variance))
    return evidence


def moved(problem: Problem, found: Fit, bounds: Sequence[Interval]) -> list[str]:
    """Named claims whose size moves by more than `MOVED`, and out of its interval, without one of the recordings.

    `bounds`: of the parameters of all claims, in their order.
    """
    names = list(dict.fromkeys(model.segment.recording for model in problem.models))
    labels: list[str] = []
    for name in names if len(names) > 1 and found.judged else []:
        others = [model.segment for model in problem.models if model.segment.recording != name]
        fewer = problem.on(others).weighed(found.claims)
        labels += apart(found, fit(fewer, found.claims, iterations=_CONFIRMING), bounds)
    return list(dict.fromkeys(labels))


def differing(problem: Problem, found: Fit, bounds: Sequence[Interval]) -> list[str]:
    """Named claims of the equation of motion whose size is another where the piston speeds up, or slows down.

    By more than `MOVED`, and not by chance; to first order. What takes force to set the piston moving, and gives none
    back, is no mass.
    """
    if MOTION not in problem.blocks or not found.judged:
        return []
    rows = problem.layout.channel == CHANNELS.index(MOTION)
    power = np.concatenate([model.kept(model.v) * model.kept_finish(model.a) for model in problem.models])
    deviation = np.sqrt(problem.variances(found.residual)[CHANNELS.index(MOTION)])
    slopes, left = found.jacobian[rows] / deviation, found.residual[rows] / deviation
    labels: list[str] = []
    for there in (power > 0.0, power < 0.0):
        covariance = np.linalg.pinv(slopes[there].T @ slopes[there], hermitian=True)
        moves, k = -covariance @ (slopes[there].T @ left[there]), 0
        for claim in found.claims:
            for one in claim.effect.parameters:
                size, move = abs(claim.values[one.name] - one.neutral), abs(moves[k]) * one.span
                chance = QUANTILE * float(np.sqrt(covariance[k, k])) * one.span * bounds[k].inflation
                named = claim.effect.named and not claim.effect.estimated and MOTION in claim.effect.blocks
                if named and one.smallest > 0.0 and move > max(MOVED * size, chance) > 0.0:
                    labels.append(claim.effect.label)
                k += 1
    return list(dict.fromkeys(labels))


def apart(found: Fit, other: Fit, bounds: Sequence[Interval]) -> list[str]:
    """Named claims whose size in another fit differs by more than `MOVED`, and lies out of its interval."""
    sizes, labels = {claim.effect.label: claim for claim in other.claims}, []
    for claim, own in by_claim(found.claims, bounds):
        label = claim.effect.label
        if label in sizes and claim.effect.named and not claim.effect.estimated and _moves(claim, sizes[label], own):
            labels.append(label)
    return labels


def _moves(claim: Claim, other: Claim, bounds: Sequence[Interval]) -> bool:
    for parameter, bound in zip(claim.effect.parameters, bounds, strict=True):
        value, moved_to = claim.values[parameter.name], other.values[parameter.name]
        outside = not bound.low <= moved_to <= bound.high
        if parameter.smallest > 0.0 and outside and abs(moved_to - value) > MOVED * abs(value - parameter.neutral):
            return True
    return False
