# SPDX-License-Identifier: Apache-2.0
"""Last stage: the report of the claims, of the remaining mismatch, and of the limits of both."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.signal

from hydro_diagnosis import stage_bar
from hydro_diagnosis.curve_claims import OPERATOR_EFFECTS
from hydro_diagnosis.curve_reports import curve_reports
from hydro_diagnosis.effects.base import BLOCKS, CHANNELS, HYDRAULIC, PRESSURE, Effect, EffectHypothesis, FloatArray
from hydro_diagnosis.effects.closure import is_closure
from hydro_diagnosis.estimation.budget import SEARCH_SHARE
from hydro_diagnosis.estimation.fit import Fit, by_claim, cause_key, fit, holdout_gain
from hydro_diagnosis.forecast import forecasts
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report_json import EffectReport, Location, LookAlike, Regime, Report, Rival, Validity
from hydro_diagnosis.selection.regimes import where, wrong_regimes
from hydro_diagnosis.significance import VERY_STRONG_EVIDENCE
from hydro_diagnosis.stage_border import StageBorder
from hydro_diagnosis.stages.parameter_checks import bench_parameter_estimates, confirmation_note, undetectable_note

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Layout, Problem
    from hydro_diagnosis.selection.localisation import MismatchLocation
    from hydro_diagnosis.selection.search import Search, SearchOutcome
    from hydro_diagnosis.stages.naming import StageResult
    from hydro_diagnosis.stages.reading import PreparedDiagnosis


@dataclass(frozen=True)
class SpectralLine:
    """Spectral line of the residuals, at the same frequency in all recordings."""

    frequency: float
    """Hz."""
    share: float
    """Share of a channel's squared residuals beyond the noise: the smallest over the recordings."""

    @property
    def sentence(self) -> str:
        """Sentence on the line's share and period, with typical origins."""
        return (
            f"{100.0 * self.share:.0f} % of what remains repeats every {1e3 / self.frequency:.3g} ms "
            f"({self.frequency:.3g} Hz), as of the mains, a pump, a dither or a machine nearby: it is not modelled."
        )


def common_spectral_line(parts: Sequence[tuple[Layout, FloatArray]], channel: str) -> SpectralLine | None:
    """Return the spectral line common to a channel's residuals in all segments, or None.

    `parts`: layout and residuals [noise standard deviations] of the fitted, and of the held-out recordings.
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
    return SpectralLine(float(np.mean([line.frequency for line in told])), min(line.share for line in told))


def _strongest(time: FloatArray, residual: FloatArray) -> SpectralLine | None:
    """Spectral line of one segment: over 30 % of the residual's power beyond the noise (1 per sample) within two bins.

    Its peak is at least 40 times the median of 40 bins on either side: for white noise once in 10^8, with 5000 bins.
    Lines below 5 Hz are ignored, since the reference may cause them.
    """
    around, slowest = 40, 5.0
    if len(time) < 8 * around:
        return None
    step = float(np.median(np.diff(time)))
    even = np.interp(np.arange(time[0], time[-1], step), time, residual)
    frequency, power = scipy.signal.periodogram(even, 1.0 / step, window="hann", scaling="spectrum")
    beyond = float(np.mean(even * even)) - 1.0
    best = int(np.argmax(np.where(frequency > slowest, power, 0.0)))
    floor = np.median(np.r_[power[max(best - around, 1) : max(best - 2, 1)], power[best + 3 : best + around]])
    if beyond <= 0.0 or frequency[best] <= slowest or power[best] < 40.0 * floor:
        return None
    share = float(power[best - 2 : best + 3].sum()) / 1.5 / beyond  # Hann's window widens a line: 1.5 bins of noise
    return SpectralLine(float(frequency[best]), min(share, 1.0)) if share > 0.3 else None


def effect_reports(findings: StageResult) -> list[EffectReport]:
    """Report entries of the retained named effects, sorted by decreasing evidence."""
    problem, found, read = findings.problem, findings.assessment.fit, findings.by_curve
    reports = []
    for claim, bounds in by_claim(found.claims, findings.bounds):
        effect = claim.effect
        if not effect.named or effect.estimated:
            continue
        if read is not None and effect.label in read.evidence:
            evidence, look_alikes = dict(read.evidence[effect.label]), list[LookAlike]()
            rivals = [one for one in read.rivals if (effect.id in OPERATOR_EFFECTS) != (one.id == "force_offset")]
            rivals = rivals if effect.id in (*OPERATOR_EFFECTS, "friction_coulomb") else []
        else:
            without = fit(problem, found.claims_without(claim))
            rivals, look_alikes = _rivals(findings.outcome, found, claim)
            if effect.id == "force_offset" and HYDRAULIC not in problem.blocks:
                why = "a bias of the force cell explains these recordings as well: record the pressures beside it"
                rivals = [Rival(id="load_cell_bias", delta_bic=0.0, distinguishable=False, why=why), *rivals]
            evidence = {
                "delta_bic": without.score - found.score,
                "holdout_gain": holdout_gain(findings.holdout, without, found),
            }
        estimates = {
            parameter.name: bound.estimate(parameter.unit)
            for parameter, bound in zip(effect.parameters, bounds, strict=True)
            if parameter.reported
        }
        reports.append(EffectReport(
            id=effect.id, equation=effect.equations[0], options=dict(effect.options),
            sentence=effect.sentence(claim.values), parameters=estimates, evidence=evidence, rivals=rivals,
            look_alikes=look_alikes, holds=validity(findings, effect),
        ))  # fmt: skip
    return sorted(reports, key=lambda report: -report.evidence["delta_bic"])


_OVER = {"motion": "velocity", "load": "position", "actuation": "current", "pressure_a": "pressure",
         "pressure_b": "pressure"}  # fmt: skip
"""Variable over which an effect's claim holds, by its equation."""
_OVER_POSITION = ("force_offset", "end_cushion", "spring")
_UNITS = {"velocity": "m/s", "position": "m", "current": "A", "pressure": "Pa"}


def validity(findings: StageResult, effect: Effect) -> Validity | None:
    """Return the range of the fitted recordings over which an effect was seen; None for errors of sensors."""
    over = "position" if effect.id.startswith(_OVER_POSITION) else _OVER.get(effect.equations[0], "")
    if over == "velocity" and findings.curve is not None and findings.curve.points:
        seen = np.abs([point.velocity for point in findings.curve.points])
    else:
        names = {"velocity": "", "position": "piston_position", "current": "valve_current", "pressure": "pressure"}
        parts = [np.abs(model.v) for model in findings.problem.models if over == "velocity"]
        parts += [
            values
            for model in findings.problem.models
            for name, values in model.channels.items()
            if names.get(over) and name.startswith(names[over])
        ]
        seen = np.percentile(np.concatenate(parts), [1.0, 99.0]) if parts else np.array([])
    return Validity(over=over, unit=_UNITS[over], low=float(seen.min()), high=float(seen.max())) if len(seen) else None


def extrapolation_note(findings: StageResult) -> str:
    """Return a note on held-out speeds that were not fitted; empty if there are none beyond a fifth of the range."""
    fitted, held = (
        [float(np.percentile(np.abs(model.v), 99.0)) for model in models if model.has_position]
        for models in (findings.problem.models, findings.holdout.models)
    )
    if not fitted or not held or max(held) <= 1.2 * max(fitted):
        return ""
    return (
        f"what was held out moves at up to {1e3 * max(held):.3g} mm/s, what was fitted at up to "
        f"{1e3 * max(fitted):.3g}: beyond that the claims are extrapolated"
    )


def _rivals(outcome: SearchOutcome, found: Fit, claim: EffectHypothesis) -> tuple[list[Rival], list[LookAlike]]:
    """Rivals of a claim, the closest first, and separately those without an id in the table of effects."""
    rivals, look_alikes = [], []
    if any(is_closure(one.effect) for one in found.claims):
        return [], []  # rivals were fitted without the closure: no fair comparison
    seen = {cause_key(claim.effect)}
    for other in outcome.rivals.get(claim.effect.label, []):
        last = other.claims[-1]
        if cause_key(last.effect) in seen or len(other.claims) != len(found.claims):
            continue
        seen.add(cause_key(last.effect))
        distance = other.score - found.score
        apart, words = distance > VERY_STRONG_EVIDENCE, last.effect.label.replace(":", " ")
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


def location_of(place: MismatchLocation, problem: Problem, regimes: Mapping[str, list[Regime]]) -> Location:
    """Report entry of a location of the mismatch, with its windows by recording; `regimes`: by channel."""
    windows: dict[str, list[list[float]]] = {}
    for model, stretches in zip(problem.models, place.windows, strict=True):
        windows.setdefault(model.segment.recording, []).extend([list(stretch) for stretch in stretches])
    region = {name: list(bounds) for name, bounds in place.region.items()}
    wrong = regimes.get(place.channel, [])
    return Location(
        equation=place.equation, share=place.share, windows=windows, region=region, regimes=wrong,
        sentence=place.sentence, where=where(wrong, "Pa" if place.channel in BLOCKS[PRESSURE] else "N"),
    )  # fmt: skip


def build_report(
    prepared: PreparedDiagnosis, search: Search, found: StageResult, begun: float, border: StageBorder
) -> Diagnosis:
    """Build the report, with its underlying data; `begun`: monotonic time [s] at which the diagnosis began."""
    problem, assessment = found.problem, found.assessment
    searched = found.by_curve is None
    hidden = undetectable_note(problem, assessment.fit, search.library, search.settings.threshold) if searched else ""
    effects = effect_reports(found)
    notes = (*([prepared.wiring] if prepared.wiring else []), *_notes(found, effects, hidden, search.library))
    search.progress(stage_bar.FORECASTING)
    given = (*prepared.inputs.recordings, *prepared.inputs.holdout)
    claims = assessment.fit.claims
    forecast, reason = border.run(
        "forecast", lambda: forecasts(problem, claims, prepared.held_out, given), lambda: (None, "it failed")
    )
    lacking = [f"forecast: {reason}"] if reason else []
    wrong = wrong_regimes(problem, found.outcome.baseline_fit.residual)
    report = Report(
        verdict=assessment.verdict,
        location=[location_of(place, problem, wrong) for place in assessment.locations],
        effects=effects,
        remainder=_remainder(found),
        closures=found.closures,
        curves=border.run("curves", lambda: curve_reports(problem, claims, found.curve, found.by_curve), list),
        accounted=found.accounted,
        estimated=bench_parameter_estimates(
            problem, assessment.fit, found.bounds, search.library, prepared.estimated_parameters
        ),
        forecast=forecast,
        fit=found.holdout_report,
        next_recording=found.next_recording,
        seconds=time.monotonic() - begun,
        steps=[{"action": step.action, "label": step.label, "delta_bic": -step.score} for step in search.steps],
        lost=border.lost,
        **prepared.report_fields
        | {"data_quality": [*prepared.report_fields["data_quality"], *notes]}
        | {"not_checked": [*prepared.report_fields["not_checked"], *lacking]},
    )
    return Diagnosis(report, prepared.problem.bench, problem, assessment, found.outcome, found.holdout.models, border)


def _notes(
    found: StageResult, effects: Sequence[EffectReport], hidden: str, library: Sequence[Effect]
) -> tuple[str, ...]:
    """Return notes on limits of the verdict."""
    assessment, stop_reason, budget, early = found.assessment, "", found.problem.budget, ""
    rows = {model.step * model.spacing for model in found.problem.models}
    for effect in effects:
        bounds = effect.parameters["time"].ci95 if effect.id == "transport_delay" else None
        if bounds and any(bounds[0] <= row <= bounds[1] for row in rows):
            early = "the dead time is that of one row: check that the logger writes each current in the row it acts in"
    if budget.exhausted or (budget.exceeds(SEARCH_SHARE) and found.outcome.stop_reason):
        left_out = ", ".join([*(["further causes"] if found.outcome.stop_reason else []), *budget.untried])
        stop_reason = (
            f"the budget of work ({budget.seconds:.3g} s of CPU as counted) was spent: --seconds sets another; "
            f"not tried: {left_out or 'nothing'}"
        )
    elif found.outcome.stop_reason and assessment.remainder:
        stop_reason = f"the search for causes ended early ({found.outcome.stop_reason}): there may be more"
    sure = (
        "" if assessment.remainder else confirmation_note(found.problem, assessment.fit, found.bounds, library, hidden)
    )
    lacking = found.by_curve.why if found.by_curve is not None else ""
    lacking = f"no friction is named: {lacking}" if lacking else ""
    return tuple(note for note in (early, hidden, stop_reason, lacking, sure, extrapolation_note(found)) if note)


def _remainder(found: StageResult) -> dict[str, Any] | None:
    problem, holdout, assessment = found.problem, found.holdout, found.assessment
    if not assessment.remainder:
        return None
    equation = assessment.remainder[0].equation
    left = ((problem.layout, assessment.fit.residual), (holdout.layout, holdout.residual(assessment.fit.claims)))
    line = common_spectral_line(left, assessment.remainder[0].channel)
    like = [claim.effect.sentence(claim.values) for claim in assessment.dropped if not claim.effect.named]
    telling = [form for form in assessment.forms if form.gain > 0.0 and form.equation == equation]
    wrong = wrong_regimes(problem, assessment.fit.residual)
    return {
        "location": [vars(location_of(place, problem, wrong)) for place in assessment.remainder],
        "depends_on": list(dict.fromkeys(form.variable for form in telling[:3])),
        "dropped": [claim.effect.id for claim in assessment.dropped if claim.effect.named],
        "looks_like": [*like, line.sentence] if line else like,
    }
