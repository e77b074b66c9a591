# SPDX-License-Identifier: Apache-2.0
"""Summary of each claim for the report: values with intervals, evidence, rivals with their distance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.fit import Fit, by_claim, fit, holdout_gain, noticeable
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.score_test import cause
from hydro_diagnosis.report_json import EffectReport, Location, LookAlike, Rival
from hydro_diagnosis.selection.localisation import Place, locate
from hydro_diagnosis.selection.outcome import CLOSE, Outcome
from hydro_diagnosis.selection.verdict import Assessment


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
    if not noticeable(holdout, residual):
        return ""
    places = ", ".join(dict.fromkeys(place.equation for place in locate(holdout, residual, {})))
    return (
        f"the held-out recordings hold more than noise ({places}), which those that were fitted do not show: the "
        "model that is handed back does not predict them; fit recordings of all that the bench does"
    )
