# SPDX-License-Identifier: Apache-2.0
"""Second stage: causes of the table are searched for, judged, and tried on the held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from hydro_diagnosis import stage_bar
from hydro_diagnosis.estimation.intervals import Interval, intervals, surely
from hydro_diagnosis.estimation.needed_numbers import rehearsable
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.experiment_design.next_recording import next_recording
from hydro_diagnosis.findings import ClosureReport
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.selection.foretelling import made_worse, made_worse_in_all, withheld
from hydro_diagnosis.selection.outcome import Outcome
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.selection.verdict import Assessment, assess, refuted
from hydro_diagnosis.validation.equations import held_out
from hydro_diagnosis.validation.heldout import Known


@dataclass(frozen=True, kw_only=True)
class Standing:
    """What is claimed at the end of a stage, and how it holds."""

    problem: Problem
    outcome: Outcome
    assessment: Assessment
    bounds: list[Interval]
    """Of the claims' parameters."""
    models: list[SegmentModel]
    """Held-out recordings."""
    unseen: Problem
    """The same, weighed for the claims."""
    simulated: Known
    """Of the held-out recordings."""
    proof: dict[str, Any]
    """`fit` of report.json."""
    taken_back: str = ""
    """Note on names that were taken back, since they predict the held-out recordings worse; else empty."""
    closures: list[ClosureReport] = field(default_factory=list)
    next_recording: dict[str, Any] | None = None
    """The recording that separates the closest rivals among the claims."""

    @property
    def names(self) -> set[str]:
        """Labels of the named claims."""
        return {claim.effect.label for claim in self.assessment.fit.claims if claim.effect.named}


def named(search: Search, held: Sequence[Segment]) -> Standing:
    """Names that account for the recordings, unless they make the held-out ones worse."""
    problem, progress = search.problem, search.progress
    progress(stage_bar.SEARCHING)
    outcome = search.run()
    progress(stage_bar.JUDGING)
    assessment, bounds = _judged(problem, outcome)
    models = [SegmentModel(segment, problem.bench) for segment in held]
    progress(stage_bar.CHECKING)
    unseen = Problem(held, problem.bench, problem.baseline, noise=problem.sensor_noise)
    unseen.update_weights(assessment.fit.claims)
    simulated: Known = {}
    proof = held_out(problem, unseen, assessment.fit.claims, models, simulated)
    found = Standing(
        problem=problem, outcome=outcome, assessment=assessment, bounds=bounds, models=models, unseen=unseen,
        simulated=simulated, proof=proof,
    )  # fmt: skip
    if assessment.verdict == "explained" and (worse := made_worse(proof)):
        return _withdrawn(found, worse)
    return replace(found, next_recording=_ahead(found))


def trusted(found: Standing, names: Standing) -> Standing:
    """`found`, or neither names nor closures where on the whole the held-out recordings are predicted worse with them.

    `names`: the same before closures.
    """
    worse = made_worse_in_all(found.proof) if found.names else ""
    return _withdrawn(names, worse) if worse else found


def _withdrawn(found: Standing, worse: str) -> Standing:
    """The bench file again, with a note on the names: `worse` of the held-out recordings."""
    problem, nothing = found.problem, found.outcome.nothing
    assessment = refuted(problem, found.assessment, nothing)
    found.unseen.update_weights(assessment.fit.claims)
    bare = replace(
        found,
        assessment=assessment,
        bounds=intervals(problem, assessment.fit),
        proof=held_out(problem, found.unseen, assessment.fit.claims, found.models, found.simulated),
        taken_back=withheld(found.assessment.fit.judged, worse, whole=not found.assessment.remainder),
    )
    return replace(bare, next_recording=_ahead(bare))


def _ahead(found: Standing) -> dict[str, Any] | None:
    """The next recording; None where the bench file is not known enough to rehearse one."""
    problem = found.problem
    return next_recording(problem, found.outcome, found.assessment) if rehearsable(problem.bench) else None


def _judged(problem: Problem, outcome: Outcome) -> tuple[Assessment, list[Interval]]:
    """Return assessment and intervals; claims whose intervals include neutral are dropped, the rest is judged anew."""
    assessment = assess(problem, outcome.fit, outcome.nothing)
    while True:
        sure, bounds = surely(problem, assessment.fit)
        if len(sure.claims) == len(assessment.fit.claims):
            return assessment, bounds
        assessment = assess(problem, sure, outcome.nothing)
