# SPDX-License-Identifier: Apache-2.0
"""The judge: which names stand, and the verdict. Decided once, from a few scores that a user can read.

A name stands where its interval excludes its absence, where physics allows it, and where it does not make what was held
out worse. Where names leave more than noise, those that act there may only mimic what is missing: then they stand
if together they account for nearly all of it. What remains is a share that is said.

`accounted` of an equation is 1 - (rms left) / (rms missing) on what was held out, the noise taken off both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.fit import Fit, fit, without_one
from hydro_diagnosis.estimation.intervals import Interval, without_insignificant
from hydro_diagnosis.estimation.problem import NOTICEABLE, Problem
from hydro_diagnosis.selection.localisation import FreeForm, Place, free_forms, locate, locate_claims
from hydro_diagnosis.significance import CLAIMED, ITERATIONS, MATTERS

NEARLY_ALL = 0.98
"""Share of the squared mismatch that names explain where something remains beside them: six sevenths of it."""
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
        count = len(found.claims)
        if problem.noticeable(found.residual) and explained_share(problem, found, nothing) < NEARLY_ALL:
            suspects, noisy = set(), problem.remaining(found.residual)
            for claim in found.judged:  # that shows mainly in channels in which something remains
                shown = problem.mean_squares(problem.residual(found.but(claim)) - found.residual)
                if max(shown, key=lambda name: shown[name]) in noisy:
                    suspects.add(claim.effect.label)
            trusted = tuple(claim for claim in found.claims if claim.effect.label not in suspects)
            found = fit(problem, trusted) if suspects else found
        found, bounds = without_insignificant(problem, found)
        named = [one for one in found.claims if one.effect.named]
        ids = {one.effect.id for one in named}
        named = [one for one in named if set(one.effect.needs) <= ids]
        if len(named) < len(found.claims):
            remains = problem.noticeable(found.residual) or any(not one.effect.named for one in found.claims)
            found = fit(problem, named, iterations=0 if remains else ITERATIONS)
        elif worst := _most_harmful(problem, holdout, found):
            found = fit(problem, found.but(worst))
        if len(found.claims) == count:
            return found, bounds


def _most_harmful(problem: Problem, holdout: Problem, found: Fit) -> Claim | None:
    """The name that makes what was held out worse by most, where that is more than its claim needed to gain."""
    unseen = holdout.weighed(found.claims)
    before = unseen.deviance(unseen.residual(found.claims))
    harm = {
        before - unseen.deviance(unseen.residual(without_one(problem, found, claim).claims)): claim
        for claim in found.removable
    }
    worst = max(harm, default=0.0)
    return harm[worst] if worst > CLAIMED else None


def explained_share(problem: Problem, found: Fit, nothing: Fit) -> float:
    """Share of the excess over the noise, summed over channels that have any, that a fit accounts for."""
    before, after = problem.mean_squares(nothing.residual), problem.mean_squares(found.residual)
    limit = problem.noise_thresholds
    gaps = {name: max(square - 1.0, 0.0) for name, square in before.items() if max(square, after[name]) > limit[name]}
    left = {name: max(after[name] - 1.0, 0.0) for name in gaps}
    shares = [1.0 - left[name] / gaps[name] for name in gaps if gaps[name] > 0.0 and after[name] > limit[name]]
    return float(min(shares, default=1.0))


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
        or any(name in accounted and accounted[name]["all"] < 1.0 - MATTERS for name in _left(holdout, kept))
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
    whole = all(one["all"] >= 1.0 - MATTERS for one in accounted.values()) and bool(accounted)
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
