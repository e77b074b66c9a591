# SPDX-License-Identifier: Apache-2.0
"""Last stage: the report of what is claimed, and of what may still be wrong with it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import scipy.signal

from hydro_diagnosis.effects.base import Claim, Effect, FloatArray, display_unit
from hydro_diagnosis.estimation.fit import QUANTILE, Fit, orthogonal, pack, residual_variances
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.estimation.problem import CHANNELS, Layout, Problem
from hydro_diagnosis.estimation.score_test import allowed, cause
from hydro_diagnosis.recording import MEASURED
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report_json import INTERRUPTED, EffectReport, NumberEstimate, Report
from hydro_diagnosis.selection.effect_summary import describe, distrusted, location_of, made_worse, not_predicted
from hydro_diagnosis.selection.reliability import doubted, explained_shares, objections
from hydro_diagnosis.selection.search import Search
from hydro_diagnosis.selection.steady_motion import FRICTION, curves
from hydro_diagnosis.stages.reading import Case, StageResult
from hydro_sim.model.bench import Bench

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


ALIKE = 0.999
"""Correlation of what a number and a cause change in the residuals, beside all that is fitted, from which they are one.
"""
OWN = 0.01
"""Share of a number's signature that nothing else in the fit makes, below which it cannot be told from the others."""
VAGUE = 0.5
"""Half width of the interval over the value from which a number is not told."""


def number_estimates(
    problem: Problem,
    found: Fit,
    bounds: Sequence[Interval],
    library: Sequence[Effect],
    numbers: Mapping[str, float | None],
) -> list[NumberEstimate]:
    """One entry per estimated number, in their order.

    `bounds`: of the parameters of all claims; `numbers`: by name, the bench file's value if it holds one.
    """
    weight = np.sqrt(1.0 / residual_variances(problem, found.residual))[problem.layout.channel]
    columns = found.jacobian * weight[:, None]
    owners = [claim for claim in found.claims for _ in claim.effect.parameters]
    names = dict(zip((claim.effect.label for claim in problem.estimated), numbers, strict=True))
    entries = []
    for k, (claim, bound) in enumerate(zip(owners, bounds, strict=True)):
        if claim.effect.estimated:
            mixed = _mixed(columns, k, [names.get(one.effect.label, one.effect.id) for one in owners])
            others = mixed or _alike(problem, found, columns, k, weight, library)
            name = names[claim.effect.label]
            entries.append(_entry(problem.bench, name, claim, bound, numbers[name], others, told=not mixed))
    return entries


def _mixed(columns: FloatArray, k: int, names: Sequence[str]) -> list[str]:
    """Return the other terms of the fit that explain nearly all of a number's signature; itself if it has none."""
    column = columns[:, k]
    if not np.linalg.norm(column) > 1e-9 * np.sqrt(len(column)):
        return [names[k]]
    others = np.delete(columns, k, axis=1)
    lengths = np.linalg.norm(others, axis=0)
    if not len(lengths) or np.linalg.norm(orthogonal(others, column)) > OWN * np.linalg.norm(column):
        return []
    lengths = np.maximum(lengths, 1e-300)
    shares = np.linalg.lstsq(others / lengths, column, rcond=1e-12)[0]
    by_size = np.argsort(-np.abs(shares))
    rest = [name for j, name in enumerate(names) if j != k]
    return list(dict.fromkeys(rest[j] for j in by_size if abs(shares[j]) > 0.3 * np.max(np.abs(shares))))


def _alike(
    problem: Problem, found: Fit, columns: FloatArray, k: int, weight: FloatArray, library: Sequence[Effect]
) -> list[str]:
    """Causes that are not claimed and would change the residuals as the number does."""
    others = np.delete(columns, k, axis=1)
    own = orthogonal(others, columns[:, k])
    alike = []
    for effect in allowed(library, found.claims, problem.blocks):
        if not effect.named or effect.needs or len(effect.parameters) > 1:
            continue
        probe = Claim(effect, {one.name: one.neutral + 0.1 * one.span for one in effect.parameters})
        shown = orthogonal(others, (problem.residual((*found.claims, probe)) - found.residual) * weight)
        size = float(np.linalg.norm(shown) * np.linalg.norm(own))
        if size > 0.0 and abs(float(shown @ own)) > ALIKE * size:
            alike.append(effect.label)
    return alike


def _entry(
    bench: Bench, name: str, claim: Claim, bound: Interval, given: float | None, others: list[str], *, told: bool
) -> NumberEstimate:
    number = Bench.quantities()[name]
    parameter = pack([claim])[0][0].name
    value, low, high = (
        float(getattr(claim.effect.settled(bench, {parameter: one}), name))
        for one in (bound.value, bound.low, bound.high)
    )
    sure = told and bound.identifiable and not (number.low > 0.0 and high - low > 2.0 * VAGUE * abs(value))
    return NumberEstimate(
        name=name,
        value=value,
        unit=number.unit,
        ci95=[low, high] if sure else None,
        given=given,
        alike=[one for one in others if one != name],
        sentence=_sentence(name, f"{value:.5g} {number.unit}", f"{low:.5g} to {high:.5g}" if sure else "", others),
    )


def _sentence(name: str, value: str, interval: str, others: Sequence[str]) -> str:
    alike = " and ".join(one for one in others if one != name)
    if interval:
        said = f"{name} is estimated at {value} (95 % {interval})"
        return f"{said}, provided that there is none of what would look the same: {alike}." if alike else f"{said}."
    if alike:
        return f"{name} cannot be told from {alike} by these recordings: it is left open."
    return f"These recordings hold too little of {name} to tell it: it is left open."


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
    return Diagnosis(report, case.problem.bench, problem, assessment, found.outcome, found.models)


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


ORIGIN = (
    "dead_volume and spring_rest together look like a position that is not counted from the retracted end: if its zero "
    "is elsewhere, give the offset in --columns, for instance piston_position=x+0.04"
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
    zero = ORIGIN if {"dead_volume", "spring_rest"} <= {effect.id for effect in effects} else ""
    return tuple(note for note in (early, hidden, cut_short, beyond, found.withdrawn, distrust, zero, sure) if note)


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


NUMBERS = (
    "piston_area", "area_ratio", "spring_stiffness", "bulk_modulus", "dead_volume", "supply_pressure", "valve_gain",
)  # fmt: skip
"""Causes that are a number of the bench file times a ratio."""
CONFIRMED = 0.05
"""Share to which such a number must be known to be called confirmed."""


def confirmed(
    problem: Problem, found: Fit, bounds: Sequence[Interval], library: Sequence[Effect], hidden: str = ""
) -> str:
    """Note on the numbers of the bench file that the recordings show to be right, to first order; empty for none.

    Each is judged beside what was found, as if the others were exact, and never closer than the search would claim.
    `hidden`: of `undetectable_causes`; none of these is confirmed.
    """
    weight = np.sqrt(1.0 / residual_variances(problem, found.residual))[problem.layout.channel]
    columns, left = found.jacobian * weight[:, None], found.residual * weight
    inflation, said = max((one.inflation for one in bounds), default=1.0), []
    for effect in allowed(library, found.claims, problem.blocks):
        name = _plain(effect)
        if effect.id not in NUMBERS or f"{name} within" in hidden:
            continue
        (ratio,) = effect.parameters
        signature = (problem.residual((*found.claims, Claim(effect, {ratio.name: 1.01}))) - found.residual) * weight
        own = orthogonal(columns, signature)
        power = max(float(own @ own), 1e-300)
        off = 0.01 * (abs(float(own @ left)) / power + QUANTILE * inflation / power**0.5)
        if off < CONFIRMED:
            said.append(f"{name} within {100.0 * max(off, ratio.smallest):.2g} %")
    return f"confirmed of the bench file, each if the others hold: {', '.join(said)}" if said else ""


MUCH = 10.0
"""Multiple of its smallest size worth claiming that a cause may hide without being listed."""
_PROBES = 3
"""Values at which each cause is tried."""


def undetectable_causes(problem: Problem, found: Fit, library: Sequence[Effect], threshold: float) -> str | None:
    """Causes that could hide in missing rows, with the size from which they would show; None if none are missing.

    `threshold`: evidence in units of BIC that a claim needs beyond its parameters' price.
    """
    if problem.thinner is None:
        return None
    weight = np.sqrt(1.0 / residual_variances(problem, found.residual))[problem.layout.channel]
    change = problem.change(found.claims) * weight
    limits: dict[str, tuple[float, str]] = {}
    absent = set(MEASURED).difference(*(model.channels for model in problem.models))
    for effect in allowed(library, found.claims, problem.blocks):
        if not effect.named or effect.needs or absent & set(effect.options.values()):
            continue
        name = _plain(effect)
        price = threshold + len(effect.parameters) * float(np.log(len(weight)))
        tried = (_least(problem, found, effect, k, weight, change, price) for k in range(_PROBES))
        limit = min(tried, key=lambda one: one[0])
        limits[name] = min(limit, limits.get(name, limit), key=lambda one: one[0])
    hidden = [f"{name}{words}" for name, (_, words) in limits.items() if words]
    if not hidden:
        return None
    return "the recording has too few rows a second to show these causes, so they are not reported: " + ", ".join(
        hidden
    )


def _plain(effect: Effect) -> str:
    return " ".join(cause(effect)).replace("=", " ").replace("_", " ")


def _least(
    problem: Problem, found: Fit, effect: Effect, probe: int, weight: FloatArray, change: FloatArray, price: float
) -> tuple[float, str]:
    """Multiple of a probe from which it shows, and in words if that is much: ` under 0.4 kg`, or alone if never."""
    start = {one.name: one.probes[min(probe, len(one.probes) - 1)] for one in effect.parameters}
    signature = (problem.residual((*found.claims, Claim(effect, start))) - found.residual) * weight
    power = float(signature @ signature)
    if power <= 0.0:
        return np.inf, " at any size"
    share = max(2.0 * abs(float(signature @ change)), (price * power) ** 0.5) / power
    main = next((one for one in effect.parameters if one.smallest > 0.0), None)
    if main is None:
        return share, " at any size" if share > 1.0 else ""
    size = share * abs(start[main.name] - main.neutral)
    if size <= MUCH * main.smallest:
        return share, ""
    unit, factor = ("%", 100.0) if main.unit == "-" else display_unit(main.unit)
    return share, f" {'under' if main.neutral == 0.0 else 'within'} {size * factor:.2g} {unit}"
