# SPDX-License-Identifier: Apache-2.0
"""Naming of the mismatch: by the shape of the force curve for rough recordings, else by the search; then by closures.

In rough recordings (`curves.ROUGHNESS_THRESHOLD`) the force contains more than any curve of the motion explains, so
that the evidence of samples is that of unmodelled physics; effects are then identified by the curve's shape (`shapes`).
Claims of the search in the other equations are retained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hydro_diagnosis import stage_bar
from hydro_diagnosis.bench_parameters import can_simulate
from hydro_diagnosis.closure.selection import best_closure, further_names
from hydro_diagnosis.closure.validation import closure_reports, errors_with_closure, share_closed
from hydro_diagnosis.curve_claims import CurveClaims, claims_from_curve
from hydro_diagnosis.curves import ForceCurve, Motion, motions
from hydro_diagnosis.effects.base import MOTION, PRESSURE, Effect, EffectHypothesis
from hydro_diagnosis.effects.closure import is_closure
from hydro_diagnosis.estimation.fit import fit, remove_claim
from hydro_diagnosis.estimation.intervals import Interval, intervals
from hydro_diagnosis.experiment_design import next_for_law, next_recording
from hydro_diagnosis.judge import (
    Assessment,
    ExplainedShares,
    accounted_shares,
    assess,
    least_evident,
    retain_claims,
    supported_names,
)
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.report_json import ClosureReport
from hydro_diagnosis.validation import HORIZON_TIME, SimulationCache, equation_errors, holdout_errors, worse_channels

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem
    from hydro_diagnosis.selection.search import Search, SearchOutcome
    from hydro_diagnosis.stages.reading import PreparedDiagnosis


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """Retained claims and their validation."""

    problem: Problem
    outcome: SearchOutcome
    assessment: Assessment
    bounds: list[Interval]
    """Confidence intervals of the claims' parameters."""
    holdout: Problem
    """Held-out recordings, reweighted for the claims."""
    simulations: SimulationCache
    """Simulations of the held-out recordings so far."""
    holdout_report: dict[str, Any]
    """Held-out errors: `fit` of report.json."""
    accounted: ExplainedShares
    curve: ForceCurve | None = None
    """Curve of the missing force; None without the equation of motion."""
    by_curve: CurveClaims | None = None
    """Claims identified by the curve's shape, for rough recordings."""
    closures: list[ClosureReport] = field(default_factory=list)
    next_recording: dict[str, Any] | None = None
    """Proposed recording that separates a claim from its closest rival."""

    @property
    def names(self) -> set[str]:
        """Labels of the named claims."""
        return {claim.effect.label for claim in self.assessment.fit.claims if claim.effect.named}


def name_causes(prepared: PreparedDiagnosis, search: Search) -> StageResult:
    """Name the causes, by the search or by the force curve of rough recordings; return them with their validation."""
    problem, progress = search.problem, search.progress
    progress(stage_bar.CURVES)
    moving = moving_motions(problem) if MOTION in problem.blocks else []
    curve = ForceCurve.over_speed(moving) if moving else None
    if curve is not None and PRESSURE not in problem.blocks and curve.rough:
        return _by_curve(problem, search.baseline_outcome(), prepared.held_out, ForceCurve(curve.motions), search, ())
    progress(stage_bar.SEARCHING)
    outcome = search.run()
    problem = outcome.problem
    progress(stage_bar.SELECTING)
    holdout = problem.for_segments(prepared.held_out)
    kept, bounds = retain_claims(problem, holdout, outcome.fit, outcome.baseline_fit)
    progress(stage_bar.CHECKING)
    holdout = holdout.reweighted(kept.claims)
    simulations: SimulationCache = {}
    holdout_report = holdout_errors(problem, holdout, kept.claims, simulations)
    while kept.removable and worse_channels(holdout_report):  # what is missing is not among the names
        kept, bounds = retain_claims(problem, holdout, remove_claim(problem, kept, least_evident(problem, kept)),
                                     outcome.baseline_fit)  # fmt: skip
        holdout = holdout.reweighted(kept.claims)
        holdout_report = holdout_errors(problem, holdout, kept.claims, simulations)
    accounted = accounted_shares(holdout_report["equations"], holdout_report["equations"])
    assessment = assess(problem, outcome.fit, kept, outcome.baseline_fit, holdout, accounted, holdout_report)
    known = can_simulate(problem.bench)  # needed to simulate a proposed recording
    return StageResult(
        problem=problem, outcome=outcome, assessment=assessment, bounds=bounds, holdout=holdout,
        simulations=simulations, holdout_report=holdout_report, accounted=accounted, curve=curve,
        next_recording=next_recording(problem, outcome, assessment) if known else None,
    )  # fmt: skip


def name_nothing(prepared: PreparedDiagnosis, search: Search) -> StageResult:
    """Return the result without a name and without what is checked on held-out recordings: of a lost stage."""
    outcome = search.baseline_outcome()
    return StageResult(
        problem=outcome.problem, outcome=outcome, bounds=[], simulations={}, accounted={},
        assessment=Assessment("unknown", outcome.fit, (), (), (), ()),
        holdout=outcome.problem.for_segments(prepared.held_out),
        holdout_report={
            "holdout": {}, "horizon_s": HORIZON_TIME, "free_run": {}, "why": "a stage before failed", "equations": {}
        },
    )  # fmt: skip


def moving_motions(problem: Problem) -> list[Motion]:
    """Motions of the problem's segments in which the piston moves."""
    return [one for one in motions(problem.models, problem.baseline) if float(np.ptp(one.position)) > 0.0]


def model_remainder(found: StageResult, prepared: PreparedDiagnosis, search: Search) -> StageResult:
    """Return the result extended by closures; unchanged if no mismatch remains or none improves the fit.

    None is sought if the remainder may be a resonance aliased by the logger (`Problem.aliased_resonance`), or if the
    budget is spent. If there is none in the motion equation of rough recordings, the force curve names effects.
    """
    problem, curve = found.problem, found.curve
    if found.by_curve is not None or not found.assessment.remainder:
        return found
    if not problem.aliased_resonance and not problem.budget.leaves_out("laws"):
        search.progress(stage_bar.MODELLING)
        library = [effect for effect in search.library if effect.named]
        if modelled := _with_laws(found, library):
            return modelled
    in_motion = any(place.equation == MOTION for place in found.assessment.remainder)
    if curve is None or not in_motion or not (curve.rough or problem.aliased_resonance):
        return found
    others = tuple(one for one in found.assessment.fit.claims if MOTION not in one.effect.blocks)
    read = _by_curve(problem, found.outcome, prepared.held_out, ForceCurve(curve.motions), search, others)
    return read if read.by_curve is not None and read.names - found.names else found


def _by_curve(
    problem: Problem, outcome: SearchOutcome, held: Sequence[Segment], curve: ForceCurve, search: Search,
    others: Sequence[EffectHypothesis],
) -> StageResult:  # fmt: skip
    """Result with effects named by the force curve, jointly with claims of other equations."""
    search.progress(stage_bar.SELECTING)
    holdout = problem.for_segments(held)
    read = claims_from_curve(curve, moving_motions(holdout), problem, search.library)
    others_fit = fit(problem, others)
    kept = fit(problem, (*others_fit.claims, *read.claims), iterations=0)
    holdout = holdout.reweighted(kept.claims)
    holdout_report = holdout_errors(problem, holdout, kept.claims)
    accounted = accounted_shares(holdout_report["equations"], holdout_report["equations"]) | {
        MOTION: dict(read.accounted)
    }
    bounds = [*intervals(problem, others_fit), *read.bounds]
    assessment = assess(problem, kept, kept, outcome.baseline_fit, holdout, accounted, holdout_report)
    return StageResult(
        problem=problem, outcome=outcome, assessment=assessment, bounds=bounds, holdout=holdout, simulations={},
        holdout_report=holdout_report, accounted=accounted, curve=curve, by_curve=read, closures=list(read.closures),
    )  # fmt: skip


def _with_laws(names: StageResult, library: Sequence[Effect]) -> StageResult | None:
    """Result with a closure, fitted jointly with the claims; None if none improves the simulation of held-out data."""
    found = best_closure(names.problem, names.assessment.fit, library)
    if found is None:
        return None
    problem, base = found.problem, names.assessment.fit
    joint_fit, bounds = supported_names(problem, names.holdout, found.fit, base)
    if not any(is_closure(one.effect) for one in joint_fit.claims) and not further_names(joint_fit, base):
        return None
    errors = errors_with_closure(names.problem, names.holdout, joint_fit, names.holdout_report, names.simulations)
    share = share_closed(names.holdout_report, errors)
    if not share > 0.0 or worse_channels(errors, names.holdout_report):
        return None
    holdout = names.holdout.reweighted(joint_fit.claims)
    named = tuple(one for one in joint_fit.claims if one.effect.named)
    everything = equation_errors(holdout, joint_fit.claims)
    accounted = accounted_shares(everything, equation_errors(holdout, named))
    baseline_fit = names.outcome.baseline_fit
    result = replace(
        names, problem=problem, holdout=holdout, bounds=bounds,
        closures=closure_reports(joint_fit, bounds, share), accounted=accounted,
        assessment=assess(problem, names.outcome.fit, joint_fit, baseline_fit, holdout, accounted, errors),
        holdout_report={**errors, "equations": everything},
    )  # fmt: skip
    ahead = names.next_recording if result.names == names.names else None  # else it would separate a dropped claim
    if ahead is None and can_simulate(problem.bench):
        ahead = next_for_law(problem, joint_fit, found.screen)
    return replace(result, next_recording=ahead)
