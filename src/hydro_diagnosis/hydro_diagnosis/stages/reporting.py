# SPDX-License-Identifier: Apache-2.0
"""Last stage: what is claimed, and what may still be wrong with it, as a report."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from hydro_diagnosis.estimation.unrecorded_rows import untold
from hydro_diagnosis.findings import INTERRUPTED, EffectReport, Report
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.selection.current_alignment import current_is_early
from hydro_diagnosis.selection.effect_summary import describe, location_of
from hydro_diagnosis.selection.foretelling import distrusted, made_worse, not_foretold
from hydro_diagnosis.selection.number_estimates import number_estimates
from hydro_diagnosis.selection.periodicity import line_of
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.stages.naming import Standing
from hydro_diagnosis.stages.reading import Case


def reported(case: Case, search: Search, found: Standing, begun: float) -> Diagnosis:
    """The report and the data behind it; `begun`: monotonic time [s] at which the diagnosis began."""
    problem, assessment = found.problem, found.assessment
    problem.forget()
    hidden = untold(problem, assessment.fit, search.library, search.settings.threshold)
    effects = describe(problem, found.unseen, found.outcome, assessment, found.bounds)
    notes = (*([case.wiring] if case.wiring else []), *_notes(found, effects, hidden))
    report = Report(
        verdict=assessment.verdict,
        location=[location_of(place, problem) for place in assessment.places],
        effects=effects,
        remainder=_remainder(found),
        closures=found.closures,
        estimated=number_estimates(problem, assessment.fit, found.bounds, search.library, case.numbers),
        fit=found.proof,
        next_recording=found.next_recording,
        seconds=time.monotonic() - begun,
        steps=_steps(search),
        **{**case.facts, "data_quality": [*case.facts["data_quality"], *notes]},
    )
    return Diagnosis(report, case.problem.bench, problem, assessment, found.outcome, found.models, notes)


def unfinished(case: Case, search: Search, begun: float) -> Report:
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
        **case.facts,
    )


def _notes(found: Standing, effects: Sequence[EffectReport], hidden: str | None) -> tuple[str, ...]:
    """What the verdict does not say."""
    assessment, cut_short = found.assessment, ""
    if found.outcome.cut_short and assessment.remainder:
        cut_short = f"the search for causes ended early ({found.outcome.cut_short}): there may be more than it names"
    early = current_is_early(found.problem, effects)
    beyond = "" if assessment.remainder else not_foretold(found.unseen, assessment.fit.claims)
    distrust = distrusted(made_worse(found.proof))
    return tuple(note for note in (early, hidden, cut_short, beyond, found.taken_back, distrust) if note)


def _steps(search: Search) -> list[dict[str, Any]]:
    return [{"action": step.action, "label": step.label, "delta_bic": -step.score} for step in search.steps]


def _remainder(found: Standing) -> dict[str, Any] | None:
    problem, unseen, assessment = found.problem, found.unseen, found.assessment
    if not assessment.remainder:
        return None
    equation = assessment.remainder[0].equation
    left = ((problem.layout, assessment.fit.residual), (unseen.layout, unseen.residual(assessment.fit.claims)))
    line = line_of(left, assessment.remainder[0].channel)
    like = [claim.effect.sentence(claim.values) for claim in assessment.dropped if not claim.effect.named]
    telling = [form for form in assessment.forms if form.gain > 0.0 and form.equation == equation]
    return {
        "location": [vars(location_of(place, problem)) for place in assessment.remainder],
        "depends_on": list(dict.fromkeys(form.variable for form in telling[:3])),
        "dropped": [claim.effect.id for claim in assessment.dropped if claim.effect.named],
        "looks_like": [*like, line.sentence] if line else like,
    }
