# SPDX-License-Identifier: Apache-2.0
"""The judge: which names stand, and the verdict. Decided once, from a few scores that a user can read.

A name stands where its interval excludes its absence, where physics allows it, and where it does not make what was held
out worse. Where names leave more than noise, those that act there may only mimic what is missing: then they stand
if together they account for nearly all of it, and each for more than a tenth. What remains is a share that is said.

`accounted` of an equation is 1 - (rms left) / (rms missing) on what was held out, the noise taken off both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.fit import Fit, fit, without_one
from hydro_diagnosis.estimation.intervals import Interval, is_significant, without_insignificant
from hydro_diagnosis.estimation.problem import CHANNELS, NOTICEABLE, Problem
from hydro_diagnosis.selection.localisation import FreeForm, Place, free_forms, locate, locate_claims

EXPLAINED = 0.95
"""Share that must be accounted for where a verdict says that everything is: five in a hundred matter to a person."""
NEARLY_ALL = 0.98
"""Share of the squared mismatch that names explain where something remains beside them: six sevenths of it."""
MINOR = 0.1
"""Share of that below which a name is dropped where something remains."""
CHANCE = 20.0
"""Deviance by which a name may make what was held out worse: that which its claim needs on what was fitted."""

Accounted = dict[str, dict[str, float]]
"""By equation: shares that the `named` claims, and `all` terms, account for."""
_EQUATION = {"hydraulic": "sensor"}


@dataclass(frozen=True)
class Assessment:
    """What stands."""

    verdict: str
    """no_mismatch, explained, modelled, partly_explained or unknown."""
    fit: Fit
    """The fit with the claims that stand."""
    places: tuple[Place, ...]
    """Location of the mismatch against the baseline."""
    remainder: tuple[Place, ...]
    """Where something is left."""
    forms: tuple[FreeForm, ...]
    """Free-form inputs for what is left, the most informative first; empty if nothing is."""
    dropped: tuple[Claim, ...]
    """Claims of the search that do not stand."""


def judged(problem: Problem, holdout: Problem, found: Fit, nothing: Fit) -> tuple[Fit, list[Interval]]:
    """The fit with the claims that stand, and their intervals.

    `holdout`: what was held out; `found`: the search's fit; `nothing`: that without claims.
    """
    while True:
        if problem.noticeable(found.residual) and explained_share(problem, found, nothing) < NEARLY_ALL:
            found = _but(problem, found, _suspects(problem, found))  # fewer claims explain no more
        kept, bounds = without_insignificant(problem, found)
        kept = _standing(problem, holdout, kept, nothing)
        if len(kept.claims) == len(found.claims):
            return kept, bounds
        found = kept


def _standing(problem: Problem, holdout: Problem, found: Fit, nothing: Fit) -> Fit:
    """The fit without what has no name, is not physical, is harmful, or mimics what remains."""
    named = tuple(one for one in found.claims if one.effect.named and (one.effect.estimated or is_significant(one)))
    ids = {one.effect.id for one in named}
    named = tuple(one for one in named if set(one.effect.needs) <= ids)
    if coincidence(found.judged):
        return nothing
    if len(named) < len(found.claims):
        remains = problem.noticeable(found.residual) or any(not one.effect.named for one in found.claims)
        return _trusted(problem, fit(problem, named, iterations=0 if remains else 8), nothing)
    if problem.noticeable(found.residual):
        found = _trusted(problem, found, nothing)
    return _harmless(problem, holdout, found)


def _harmless(problem: Problem, holdout: Problem, found: Fit) -> Fit:
    """The fit without the name that makes what was held out worse by most, beyond chance."""
    unseen = holdout.weighed(found.claims)
    before = unseen.deviance(unseen.residual(found.claims))
    others = [without_one(problem, found, claim) for claim in found.removable]
    harm = [before - unseen.deviance(unseen.residual(fewer.claims)) for fewer in others]
    return fit(problem, others[int(np.argmax(harm))].claims) if max(harm, default=0.0) > CHANCE else found


def coincidence(claims: Sequence[Claim]) -> bool:
    """Return whether both dead volumes are off alike: two errors do not agree, so it is another cause (soft hoses)."""
    ratios = [claim.values["ratio"] for claim in claims if claim.effect.id == "dead_volume"]
    return len(ratios) == 2 and abs(ratios[0] - ratios[1]) < 0.05 * abs(ratios[0] - 1.0)


def _trusted(problem: Problem, found: Fit, nothing: Fit) -> Fit:
    """The fit without those claims that act where something remains and do not explain nearly all of it.

    Claims that show in other channels, in which nothing remains, are not in question.
    """
    suspects = _suspects(problem, found)
    fewer = _without_minor(problem, found, nothing, suspects)
    left = any(claim.effect.label in suspects for claim in fewer.claims)
    if left and explained_share(problem, fewer, nothing) >= NEARLY_ALL:
        return fewer
    return _but(problem, fewer, suspects)


def _but(problem: Problem, found: Fit, labels: set[str]) -> Fit:
    """The fit without claims of these labels."""
    kept = tuple(claim for claim in found.claims if claim.effect.label not in labels)
    return fit(problem, kept) if len(kept) < len(found.claims) else found


def _suspects(problem: Problem, found: Fit) -> set[str]:
    """Labels of claims that show mainly in channels in which something remains."""
    noisy = problem.remaining(found.residual)
    suspects = set()
    for claim in found.judged:
        without = problem.residual(found.but(claim))
        shown = problem.mean_squares(without - found.residual)
        if max(shown, key=lambda name: shown[name]) in noisy:
            suspects.add(claim.effect.label)
    return suspects


def explained_share(problem: Problem, found: Fit, nothing: Fit) -> float:
    """Share of the excess over the noise, summed over channels that have any, that a fit accounts for."""
    before, after = problem.mean_squares(nothing.residual), problem.mean_squares(found.residual)
    limit = problem.noise_thresholds
    gaps = {name: max(square - 1.0, 0.0) for name, square in before.items() if max(square, after[name]) > limit[name]}
    left = {name: max(after[name] - 1.0, 0.0) for name in gaps}
    shares = [1.0 - left[name] / gaps[name] for name in gaps if gaps[name] > 0.0 and after[name] > limit[name]]
    return float(min(shares, default=1.0))


def _judged(problem: Problem, found: Fit) -> npt.NDArray[np.bool_]:
    """Residuals of the channels in which something remains."""
    noisy = [CHANNELS.index(name) for name in problem.remaining(found.residual)]
    return np.isin(problem.layout.channel, noisy)


def _without_minor(problem: Problem, found: Fit, nothing: Fit, suspects: set[str]) -> Fit:
    """Drop, one after the other, suspects without which hardly more remains."""
    rows = _judged(problem, found)
    gap = float(np.sum(np.square(nothing.residual[rows])) - np.sum(np.square(found.residual[rows])))
    current = found
    while True:
        open_ = [one for one in current.removable if one.effect.label in suspects]
        if not open_ or len(current.judged) == 1:
            return current
        smaller = [without_one(problem, current, claim) for claim in open_]
        remains = float(np.sum(np.square(current.residual[rows])))
        losses = [float(np.sum(np.square(one.residual[rows]))) - remains for one in smaller]
        if min(losses) > MINOR * gap:
            return current
        current = fit(problem, smaller[int(np.argmin(losses))].claims)


def assessed(
    problem: Problem, found: Fit, kept: Fit, nothing: Fit, holdout: Problem,
    accounted: Mapping[str, Mapping[str, float]],
) -> Assessment:  # fmt: skip
    """What stands, and the verdict.

    Parameters
    ----------
    found, kept, nothing
        Fits of the search, of what stands, and without claims.
    accounted
        Of what was held out (`shares`).
    """
    terms = any(not one.effect.named for one in kept.judged)
    names = any(one.effect.named for one in kept.judged)
    labels = {claim.effect.label for claim in kept.claims}
    dropped = tuple(claim for claim in found.claims if claim.effect.label not in labels)
    left = (
        problem.noticeable(kept.residual)
        or any(not one.effect.named for one in dropped)
        or any(name in accounted and accounted[name]["all"] < EXPLAINED for name in _left(holdout, kept))
        or (not kept.judged and bool(_left(holdout, kept)))
    )
    if not left:
        verdict = ("modelled" if terms else "explained") if kept.judged else "no_mismatch"
        places = tuple(locate_claims(problem, kept, nothing.residual))
        return Assessment(verdict, kept, places, (), (), dropped)
    forms = free_forms(problem, kept)
    remainder = tuple(locate(problem, kept.residual, forms))
    if not remainder:  # a term without a name may be small, and what was held out may hold more
        remainder = tuple(locate(holdout, holdout.residual(kept.claims))) or tuple(
            locate_claims(problem, found, nothing.residual)
        )
        nowhere = tuple(() for _ in problem.models)  # of what was fitted
        remainder = tuple(replace(one, windows=nowhere) for one in remainder)
    places = tuple(locate_claims(problem, kept, nothing.residual)) or remainder
    whole = all(one["all"] >= EXPLAINED for one in accounted.values()) and bool(accounted)
    if kept.judged and whole:
        verdict = "modelled" if terms else "explained"
    else:
        verdict = "partly_explained" if names else "unknown"
    return Assessment(verdict, kept, places, remainder, tuple(forms[:6]), dropped)


def _left(holdout: Problem, kept: Fit) -> list[str]:
    """Equations in which a fit leaves more than noise of what was held out."""
    unseen = holdout.weighed(kept.claims)
    return [_EQUATION.get(name, name) for name in unseen.remaining(unseen.residual(kept.claims))]


def shares(errors: Mapping[str, Mapping[str, Any]], named: Mapping[str, Mapping[str, Any]]) -> Accounted:
    """What all terms, and the named ones, account for: `validation.equation_errors` of both.

    Without equations in which the bench file misses nothing but noise.
    """
    found: Accounted = {}
    for name, one in errors.items():
        floor = one["noise_floor"] ** 2
        missing = one["rmse_before"] ** 2 - floor
        if missing > NOTICEABLE * floor:
            left = {"named": named[name]["rmse_after"], "all": one["rmse_after"]}
            found[_EQUATION.get(name, name)] = {
                key: 1.0 - float(np.sqrt(max(after**2 - floor, 0.0) / missing)) for key, after in left.items()
            }
    return found
