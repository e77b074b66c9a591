# SPDX-License-Identifier: Apache-2.0
"""Last stage: the report of what is claimed, and of what may still be wrong with it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy.signal

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, by_claim, cause, fit, holdout_gain
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.estimation.problem import CHANNELS, NOTICEABLE, Layout, Problem
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report_json import INTERRUPTED, EffectReport, Location, LookAlike, Report, Rival
from hydro_diagnosis.selection.localisation import Place, locate
from hydro_diagnosis.selection.search import CLOSE, Outcome, Search
from hydro_diagnosis.selection.steady_motion import FRICTION, Point, curves, missed
from hydro_diagnosis.selection.verdict import Assessment
from hydro_diagnosis.stages.naming import StageResult, made_worse
from hydro_diagnosis.stages.reading import Case
from hydro_diagnosis.stages.unclaimed import confirmed, number_estimates, undetectable_causes

SLOWEST = 5.0
"""Hz: what repeats less often may be the reference's doing."""
AROUND = 40
"""Bins on either side of a line whose median is what it stands out of."""
STANDS_OUT = 40.0
"""Times that median: among 5000 bins of white noise it is exceeded once in 10^8."""
SHARE = 0.3
"""Least share of a channel's remainder that a spectral line must hold."""


@dataclass(frozen=True)
class Line:
    """A line in the spectrum of what remains, the same in all recordings."""

    frequency: float
    """Hz."""
    share: float
    """Share of the squared remainder in that channel, in the recording with the least of it."""

    @property
    def sentence(self) -> str:
        """Typical origin of a line at that frequency."""
        return (
            f"{100.0 * self.share:.0f} % of what remains repeats every {1e3 / self.frequency:.3g} ms "
            f"({self.frequency:.3g} Hz), unless the reference does: typical of the mains, a pump's strokes, a dither "
            "or a machine nearby; stop it, for it is not modelled."
        )


def line_of(parts: Sequence[tuple[Layout, FloatArray]], channel: str) -> Line | None:
    """Return the line that holds most of what remains in a channel of the residuals in every recording, or None.

    `parts`: layouts, and residuals [noise] in their order: of the fitted recordings, of the held-out ones.
    """
    lines, finest = [], 0.0
    for layout, residual in parts:
        here = layout.channel == CHANNELS.index(channel)
        for segment in np.unique(layout.segment[here]):
            at = here & (layout.segment == segment)
            lines.append(_strongest(layout.time[at], residual[at]))
            finest = max(finest, 2.0 / max(float(np.ptp(layout.time[at])), 1e-9))
    told = [line for line in lines if line is not None]
    if not told or len(told) < len(lines) or np.ptp([line.frequency for line in told]) > finest:
        return None
    return Line(float(np.mean([line.frequency for line in told])), min(line.share for line in told))


def _strongest(time: FloatArray, residual: FloatArray) -> Line | None:
    """The line of one recording: most of the residual's power beyond the noise (1 a sample) within two bins."""
    if len(time) < 8 * AROUND:
        return None
    step = float(np.median(np.diff(time)))
    even = np.interp(np.arange(time[0], time[-1], step), time, residual)
    frequency, power = scipy.signal.periodogram(even, 1.0 / step, window="hann", scaling="spectrum")
    beyond = float(np.mean(even * even)) - 1.0
    best = int(np.argmax(np.where(frequency > SLOWEST, power, 0.0)))
    around = np.r_[power[max(best - AROUND, 1) : max(best - 2, 1)], power[best + 3 : best + AROUND]]
    if beyond <= 0.0 or frequency[best] <= SLOWEST or power[best] < STANDS_OUT * np.median(around):
        return None
    share = float(power[best - 2 : best + 3].sum()) / 1.5 / beyond  # Hann's window widens a line: 1.5 bins of noise
    return Line(float(frequency[best]), min(share, 1.0)) if share > SHARE else None


TIMING = 2e-5
"""Tolerance [s] of a dead time of one row."""


def current_is_early(problem: Problem, effects: Sequence[EffectReport]) -> str | None:
    """Return a sentence if a claimed dead time is one row: a current written a row before it acts looks the same."""
    rows = {model.step * model.spacing for model in problem.models}
    for effect in effects:
        bounds = effect.parameters["time"].ci95 if effect.id == "transport_delay" else None
        if bounds and any(bounds[0] - TIMING <= row <= bounds[1] + TIMING for row in rows):
            return (
                "the dead time is that of one row: a logger that writes each row's current a row before it acts looks "
                "the same; if this one does, move that column down by one row and diagnose again"
            )
    return None


def describe(
    problem: Problem, held: Problem, outcome: Outcome, assessment: Assessment, bounds: Sequence[Interval]
) -> list[EffectReport]:
    """One entry per name that stands, the strongest evidence first.

    `held`: the held-out recordings; `bounds`: of the parameters of all claims, in their order.
    """
    found = assessment.fit
    reports = [
        _report(problem, held, outcome, found, claim, own)
        for claim, own in by_claim(found.claims, bounds)
        if claim.effect.named and not claim.effect.estimated
    ]
    return sorted(reports, key=lambda report: -report.evidence["delta_bic"])


def _report(
    problem: Problem, held: Problem, outcome: Outcome, found: Fit, claim: Claim, bounds: Sequence[Interval]
) -> EffectReport:
    without = fit(problem, found.but(claim))
    parameters = {
        parameter.name: bound.estimate(parameter.unit)
        for parameter, bound in zip(claim.effect.parameters, bounds, strict=True)
        if parameter.reported
    }
    rivals, look_alikes = _rivals(outcome, found, claim)
    return EffectReport(
        id=claim.effect.id,
        equation=claim.effect.equations[0],
        options=dict(claim.effect.options),
        sentence=claim.effect.sentence(claim.values),
        parameters=parameters,
        evidence={
            "delta_bic": without.score - found.score,
            "holdout_gain": holdout_gain(held, without, found),
        },
        rivals=rivals,
        look_alikes=look_alikes,
    )


def _rivals(outcome: Outcome, found: Fit, claim: Claim) -> tuple[list[Rival], list[LookAlike]]:
    """Other causes in a claim's place, the closest first; apart from them those that the table has no id for."""
    rivals, look_alikes = [], []
    if any(isinstance(one.effect, Closure) for one in found.claims):
        return [], []  # rivals were fitted without the closure: no fair comparison
    seen = {cause(claim.effect)}
    for other in outcome.rivals.get(claim.effect.label, []):
        last = other.claims[-1]
        if cause(last.effect) in seen or len(other.claims) != len(found.claims):
            continue
        seen.add(cause(last.effect))
        distance = other.score - found.score
        apart, words = distance > CLOSE, last.effect.label.replace(":", " ")
        words = words if last.effect.named else words.replace("_", " ")
        why = (
            f"{words} in its place fits worse: its BIC is higher by {distance:.0f}"
            if apart
            else f"{words} explains these recordings as well: another recording must tell"
        )
        if last.effect.named:
            rivals.append(Rival(id=last.effect.id, delta_bic=distance, distinguishable=apart, why=why))
        else:
            likeness = last.effect.sentence(last.values)
            look_alikes.append(LookAlike(likeness=likeness, delta_bic=distance, distinguishable=apart, why=why))
    return rivals[:3], look_alikes


def location_of(place: Place, problem: Problem) -> Location:
    """A place as it stands in the report: windows by recording."""
    windows: dict[str, list[list[float]]] = {}
    for model, stretches in zip(problem.models, place.windows, strict=True):
        windows.setdefault(model.segment.recording, []).extend([list(stretch) for stretch in stretches])
    region = {name: list(bounds) for name, bounds in place.region.items()}
    return Location(equation=place.equation, share=place.share, windows=windows, region=region, sentence=place.sentence)


def build_report(case: Case, search: Search, found: StageResult, begun: float) -> Diagnosis:
    """The report and the data behind it; `begun`: monotonic time [s] at which the diagnosis began."""
    problem, assessment = found.problem, found.assessment
    problem.columns.clear()
    hidden = undetectable_causes(problem, assessment.fit, search.library, search.settings.threshold)
    effects = describe(problem, found.holdout, found.outcome, assessment, found.bounds)
    read_off = curves(problem, assessment.fit.claims)
    doubts = objections(assessment.fit, found.bounds, found.proof, read_off.get(FRICTION, ()))
    refused = [f"{label} fits, but is rejected: {reason}" for label, reason in found.refused.items()]
    notes = (
        *([case.wiring] if case.wiring else []),
        *_notes(found, effects, hidden, search.library),
        *refused,
        *doubts,
    )
    report = Report(
        verdict=doubted(assessment.verdict, doubts, named=bool(effects)),
        location=[location_of(place, problem) for place in assessment.places],
        effects=effects,
        remainder=_remainder(found),
        closures=found.closures,
        checks={
            "curves": {name: [asdict(point) for point in points] for name, points in read_off.items()},
            "explained": explained_shares(found.proof),
            "refused": dict(found.refused),
            "objections": [*refused, *doubts],
        },
        estimated=number_estimates(problem, assessment.fit, found.bounds, search.library, case.numbers),
        fit=found.proof,
        next_recording=found.next_recording,
        seconds=time.monotonic() - begun,
        steps=_steps(search),
        **{**case.facts, "data_quality": [*case.facts["data_quality"], *notes]},
    )
    return Diagnosis(report, case.problem.bench, problem, assessment, found.outcome, found.holdout.models)


def interrupted_report(case: Case, search: Search, begun: float) -> Report:
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


def _notes(
    found: StageResult, effects: Sequence[EffectReport], hidden: str | None, library: Sequence[Effect]
) -> tuple[str, ...]:
    """Return notes on limits of the verdict."""
    assessment, cut_short, budget = found.assessment, "", found.problem.budget
    if budget.exhausted:
        cut_short = (
            f"the budget of work ({budget.seconds:.3g} s of CPU as counted) was spent: this is the best answer until "
            "then; --seconds sets another"
        )
    elif found.outcome.cut_short and assessment.remainder:
        cut_short = f"the search for causes ended early ({found.outcome.cut_short}): there may be more than it names"
    sure = "" if assessment.remainder else confirmed(found.problem, assessment.fit, found.bounds, library, hidden or "")
    early = current_is_early(found.problem, effects)
    beyond = "" if assessment.remainder else not_predicted(found.holdout, assessment.fit.claims)
    distrust = distrusted(made_worse(found.proof))
    return tuple(note for note in (early, hidden, cut_short, beyond, found.withdrawn, distrust, sure) if note)


def _steps(search: Search) -> list[dict[str, Any]]:
    return [{"action": step.action, "label": step.label, "delta_bic": -step.score} for step in search.steps]


def _remainder(found: StageResult) -> dict[str, Any] | None:
    problem, holdout, assessment = found.problem, found.holdout, found.assessment
    if not assessment.remainder:
        return None
    equation = assessment.remainder[0].equation
    left = ((problem.layout, assessment.fit.residual), (holdout.layout, holdout.residual(assessment.fit.claims)))
    line = line_of(left, assessment.remainder[0].channel)
    like = [claim.effect.sentence(claim.values) for claim in assessment.dropped if not claim.effect.named]
    telling = [form for form in assessment.forms if form.gain > 0.0 and form.equation == equation]
    return {
        "location": [vars(location_of(place, problem)) for place in assessment.remainder],
        "depends_on": list(dict.fromkeys(form.variable for form in telling[:3])),
        "dropped": [claim.effect.id for claim in assessment.dropped if claim.effect.named],
        "looks_like": [*like, line.sentence] if line else like,
    }


def distrusted(worse: str) -> str:
    """Note on a model that is handed back although `worse`; empty where it is not."""
    if not worse:
        return ""
    return (
        f"the held-out recordings are predicted worse than by the bench file ({worse}): do not trust what is named; "
        "record with less noise or more motion"
    )


def not_predicted(holdout: Problem, claims: Sequence[Claim]) -> str:
    """Note on held-out recordings that hold more than noise, weighed for these claims; empty where they do not.

    Names fit what they can take the form of: viscous friction with a Stribeck rise takes that of drag with the square
    of speed, as far as the piston was moved.
    """
    residual = holdout.residual(claims)
    if not holdout.noticeable(residual):
        return ""
    places = ", ".join(dict.fromkeys(place.equation for place in locate(holdout, residual)))
    return (
        f"the held-out recordings hold more than noise ({places}), which those that were fitted do not show: the "
        "model that is handed back does not predict them; fit recordings of all that the bench does"
    )


LEFT = 0.25
"""Share of the bench file's error that may be left on held-out recordings where everything is explained."""


def explained_shares(proof: Mapping[str, Any]) -> dict[str, float]:
    """Share of each equation's held-out mean square beyond the noise, as the bench file leaves it, that claims remove.

    `proof`: `fit` of report.json. Without equations whose mismatch is noise.
    """
    shares = {}
    for name, one in proof.get("equations", {}).items():
        before, after = (max(one[key] ** 2 - one["noise_floor"] ** 2, 0.0) for key in ("rmse_before", "rmse_after"))
        if before > NOTICEABLE * one["noise_floor"] ** 2:
            shares[name] = 1.0 - after / before
    return shares


def doubted(verdict: str, doubts: Sequence[str], *, named: bool) -> str:
    """Return the verdict with `objections`: what is not all of it is no `explained`, nor `modelled`."""
    if verdict not in ("explained", "modelled") or not doubts:
        return verdict
    return "partly_explained" if named else "unknown"


def objections(
    found: Fit,
    bounds: Sequence[Interval],
    proof: Mapping[str, Any],
    points: Sequence[Point],
) -> list[str]:
    """Sentences on why claims do not explain everything, though they leave no more than the noise that they allow.

    `found`, `bounds`: the claims, and the intervals of their parameters. `proof`: `fit` of report.json. `points`: force
    over steady speed (`steady_motion.curves`).
    """
    owners = [(claim, one) for claim in found.claims for one in claim.effect.parameters]
    vague = [
        f"{claim.effect.id}: {one.name}"
        for (claim, one), bound in zip(owners, bounds, strict=True)
        if claim.effect.named and not claim.effect.estimated and one.smallest > 0.0 and not bound.identifiable
    ]
    said = [f"not identifiable from these recordings, or at its bound: {', '.join(vague)}"] if vague else []
    for name, one in proof.get("equations", {}).items():
        before, after, floor = one["rmse_before"], one["rmse_after"], one["noise_floor"]
        if after > LEFT * before and after**2 > (1.0 + NOTICEABLE) * floor**2:
            left = f"{100.0 * after / before:.0f} % of the bench file's error in {name} is left on what was held out"
            left = left if found.judged else f"something small is missing: {name} on what was held out"
            said.append(f"{left}, {after / floor:.3g} times the sensors' noise")
    noise = proof.get("equations", {}).get("motion", {}).get("noise_floor", 0.0)
    off = missed(points, noise) if found.judged else []
    if off:
        worst = max(off, key=lambda point: abs(point.measured - point.model))
        said.append(
            f"the model misses the measured force at {len(off)} of {len(points)} steady speeds; worst: "
            f"{abs(worst.measured - worst.model):.3g} N off at {worst.at * 1e3:.3g} mm/s, measured "
            f"{abs(worst.measured):.3g} N"
        )
    return said
