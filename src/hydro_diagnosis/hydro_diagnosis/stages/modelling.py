# SPDX-License-Identifier: Apache-2.0
"""Third stage: what no name explains is modelled by laws or smooth functions, where they hold on held-out data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydro_diagnosis import stage_bar
from hydro_diagnosis.closure.admission import Admitted, admitted, reports
from hydro_diagnosis.closure.foretold import foretold
from hydro_diagnosis.closure.selection import closures
from hydro_diagnosis.effects.base import Effect
from hydro_diagnosis.estimation.free_form import free_forms
from hydro_diagnosis.estimation.intervals import all_hold, intervals
from hydro_diagnosis.estimation.needed_numbers import rehearsable
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design.rival_laws import next_for_law
from hydro_diagnosis.selection.localisation import locate, locate_claims, noticeable
from hydro_diagnosis.selection.verdict import Assessment
from hydro_diagnosis.stages.naming import Standing
from hydro_diagnosis.stages.reading import Progress
from hydro_diagnosis.validation.equations import equations_told


def modelled(names: Standing, library: Sequence[Effect], progress: Progress) -> Standing:
    """Names and closure together; the names alone where nothing remains, or no closure is admitted."""
    if not names.assessment.remainder:
        return names
    progress(stage_bar.MODELLING)
    problem, unseen = names.problem, names.unseen
    others = [effect for effect in library if effect.named]
    candidates = (foretold(one, unseen) for one in closures(problem, names.assessment, others))
    found = admitted(problem, unseen, candidates, names.models, names.proof, names.simulated)
    bounds = intervals(found.closed.problem, found.closed.fit) if found else []
    if not found or not all_hold(found.closed.fit.claims, bounds):
        return names
    beside = replace(
        names,
        problem=found.closed.problem,
        assessment=_closed(found.closed.problem, names.assessment, found),
        bounds=bounds,
        closures=reports(found, bounds),
    )
    ahead = names.next_recording if beside.names == names.names else None  # it would tell apart what is not claimed
    if ahead is None and rehearsable(problem.bench):
        ahead = next_for_law(beside.problem, found.closed.fit)
    unseen.update_weights(found.closed.fit.claims)
    proof = {**found.held, "equations": equations_told(unseen, found.closed.fit.claims)}
    return replace(beside, proof=proof, next_recording=ahead)


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
