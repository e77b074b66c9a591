# SPDX-License-Identifier: Apache-2.0
"""Judgement of the search: retained claims and verdict, decided once, from a few scores that a user can read.

A claim is retained if its interval excludes its absence, if it is physically possible, and if it does not increase the
held-out errors. Where the names leave more than noise, those that act there may only mimic what is missing: they are
retained if together they account for nearly all of it, and each removes more than what remains; single edges of the
valve, which together take any form, are not. The remaining share is reported. Viscous friction is not retained where
the pressures are not explained: hoses between taps and chambers drop as much.

`accounted` of an equation is 1 - (rms of the residual) / (rms of what the bench file misses) on held-out recordings,
the noise subtracted from both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hydro_diagnosis.effects.base import BLOCKS, PRESSURE, EffectHypothesis
from hydro_diagnosis.estimation.fit import Fit, by_claim, fit, remove_claim
from hydro_diagnosis.estimation.intervals import Interval, intervals, stands, without_insignificant
from hydro_diagnosis.selection.localisation import FreeForm, MismatchLocation, free_forms, locate, locate_claims
from hydro_diagnosis.significance import CLAIM_THRESHOLD, EXCESS_THRESHOLD, ITERATIONS, PRACTICAL_SHARE

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem

MIN_EXPLAINED_SHARE = 0.98
"""Least share of the squared mismatch that retained causes explain if something remains: six sevenths of its RMS."""
ExplainedShares = dict[str, dict[str, float]]
"""Shares explained by the `named` claims and by `all` terms, by equation."""
_EQUATION_NAMES = {"hydraulic": "sensor"}


@dataclass(frozen=True)
class Assessment:
    """Result of the judgement: verdict, retained claims and remaining mismatch."""

    verdict: str
    """no_mismatch, explained, modelled, partly_explained or unknown."""
    fit: Fit
    """Fit with the retained claims."""
    locations: tuple[MismatchLocation, ...]
    """Location of the mismatch against the baseline."""
    remainder: tuple[MismatchLocation, ...]
    """Locations of the remaining mismatch."""
    forms: tuple[FreeForm, ...]
    """Free-form inputs for the remaining mismatch, the most informative first; empty if there is none."""
    dropped: tuple[EffectHypothesis, ...]
    """Claims of the search that are not retained."""


def retain_claims(problem: Problem, holdout: Problem, found: Fit, baseline_fit: Fit) -> tuple[Fit, list[Interval]]:
    """Return the fit with the retained claims, and the intervals of its parameters.

    `holdout`: held-out recordings; `found`: fit of the search; `baseline_fit`: fit without claims.
    """
    while True:
        count = len(found.claims)
        if problem.has_excess(found.residual):
            noisy = problem.excess_channels(found.residual)
            suspects = [claim for claim in found.cause_claims if _main_channel(problem, found, claim) in noisy]
            if explained_share(problem, found, baseline_fit) >= MIN_EXPLAINED_SHARE:
                edges = [claim for claim in suspects if claim.effect.physics.edge]  # take any form of a valve's flow
                suspects = edges or _smaller_than_the_rest(problem, found, suspects)
            labels = {claim.effect.label for claim in suspects}
            trusted = tuple(claim for claim in found.claims if claim.effect.label not in labels)
            found = fit(problem, trusted) if suspects else found
        found, bounds = without_insignificant(problem, found)
        named = [one for one in found.claims if one.effect.named]
        ids = {one.effect.id for one in named}
        named = [one for one in named if set(one.effect.needs) <= ids]
        if len(named) < len(found.claims):
            remains = problem.has_excess(found.residual) or any(not one.effect.named for one in found.claims)
            found = fit(problem, named, iterations=0 if remains else ITERATIONS)
        elif worst := unsupported(problem, holdout, found, bounds) or _drop_of_hoses(problem, found):
            found = fit(problem, found.claims_without(worst))
        if len(found.claims) == count:
            return found, bounds


def _drop_of_hoses(problem: Problem, found: Fit) -> EffectHypothesis | None:
    """Return the viscous friction of a fit whose names explain less than half of what both pressures miss; else None.

    Hoses between the pressures' taps and the chambers take as large a force, in proportion to the same velocity.
    """
    friction = next((claim for claim in found.cause_claims if claim.effect.id == "friction_viscous"), None)
    named = [claim for claim in found.claims if claim.effect.named]
    if friction is None or PRESSURE not in problem.blocks:
        return None
    before, after = (
        problem.mean_squares(problem.residual(some))
        for some in ([claim for claim in found.claims if claim.effect.estimated], named)
    )
    excess = problem.noise_thresholds
    unexplained = (
        after[name] > excess[name] and 2.0 * (after[name] - 1.0) > before[name] - 1.0 for name in BLOCKS[PRESSURE]
    )
    return friction if all(unexplained) else None


def _main_channel(problem: Problem, found: Fit, claim: EffectHypothesis) -> str:
    """Return the channel in which a claim changes the residual most."""
    shown = problem.mean_squares(problem.residual(found.claims_without(claim)) - found.residual)
    return max(shown, key=lambda name: shown[name])


def _smaller_than_the_rest(
    problem: Problem, found: Fit, suspects: Sequence[EffectHypothesis]
) -> list[EffectHypothesis]:
    """Return that one of the suspects which removes least, if in each channel more than that remains; else none.

    It may then be part of what is missing, in another form.
    """
    left = problem.mean_squares(found.residual)
    gains: list[tuple[float, EffectHypothesis]] = []
    for claim in suspects:
        if claim in found.removable and len(found.cause_claims) > 1:
            without = problem.mean_squares(remove_claim(problem, found, claim).residual)
            gain = max((without[name] - one) / max(one - 1.0, EXCESS_THRESHOLD) for name, one in left.items())
            gains.append((gain, claim))
    gains.sort(key=lambda one: one[0])
    return [claim for gain, claim in gains[:1] if gain < 1.0]


def unsupported(problem: Problem, holdout: Problem, found: Fit, bounds: Sequence[Interval]) -> EffectHypothesis | None:
    """Return the claim that the held-out recordings support least; None if all are supported.

    A claim may increase the held-out deviance by `CLAIM_THRESHOLD`; one without any interval must reduce it by as much.
    """
    unseen = holdout.reweighted(found.claims)
    before = unseen.deviance(unseen.residual(found.claims))
    sized = {one.effect.label for one, own in by_claim(found.claims, bounds) if any(each.identifiable for each in own)}
    harm = {
        before
        - unseen.deviance(unseen.residual(remove_claim(problem, found, claim).claims))
        + (0.0 if claim.effect.label in sized else 2.0 * CLAIM_THRESHOLD): claim
        for claim in found.removable
    }
    worst = max(harm, default=0.0)
    return harm[worst] if worst > CLAIM_THRESHOLD else None


def supported_names(problem: Problem, holdout: Problem, found: Fit, base: Fit) -> tuple[Fit, list[Interval]]:
    """Return the fit with those of its names that `base` has not only if they stand; and the intervals of its claims.

    As of `retain_claims`: such a name's interval excludes its absence, the held-out recordings support it, and leave no
    more than noise where it acts.
    """
    known = {claim.effect.label for claim in base.claims}
    while True:
        bounds = intervals(problem, found)
        shown = by_claim(found.claims, bounds)
        harmful = unsupported(problem, holdout, found, bounds), _drop_of_hoses(problem, found)
        unseen = holdout.reweighted(found.claims)
        noisy = unseen.excess_channels(unseen.residual(found.claims))
        refused = [
            claim for claim, own in shown
            if claim.effect.named and claim.effect.label not in known
            and (claim in harmful or not stands(claim, own) or _main_channel(problem, found, claim) in noisy)
        ]  # fmt: skip
        if not refused:
            return found, bounds
        found = fit(problem, [claim for claim in found.claims if claim not in refused])


def least_evident(problem: Problem, found: Fit) -> EffectHypothesis:
    """Return the claim without which the score of a fit rises least."""
    return min(found.removable, key=lambda claim: remove_claim(problem, found, claim).score)


def explained_share(problem: Problem, found: Fit, baseline_fit: Fit) -> float:
    """Return the share of the excess over the noise that a fit accounts for.

    That of the channel with the smallest share among those in which it leaves more than noise; 1 if there are none.
    """
    before, after = problem.mean_squares(baseline_fit.residual), problem.mean_squares(found.residual)
    limit = problem.noise_thresholds
    gaps = {name: max(square - 1.0, 0.0) for name, square in before.items() if max(square, after[name]) > limit[name]}
    left = {name: max(after[name] - 1.0, 0.0) for name in gaps}
    shares = [1.0 - left[name] / gaps[name] for name in gaps if gaps[name] > 0.0 and after[name] > limit[name]]
    return float(min(shares, default=1.0))


def assess(
    problem: Problem, found: Fit, kept: Fit, baseline_fit: Fit, holdout: Problem,
    accounted: Mapping[str, Mapping[str, float]], simulated: Mapping[str, Any],
) -> Assessment:  # fmt: skip
    """Return the verdict, with the locations of the mismatch and of what remains of it.

    Parameters
    ----------
    found, kept, baseline_fit
        Fits of the search, with the retained claims, and without claims.
    accounted
        `accounted_shares` of the held-out recordings.
    simulated
        `validation.holdout_errors` of the held-out recordings: names and terms with which the simulation of a channel
        becomes worse by more than a fifth do not explain all, whatever they account for.
    """
    terms = any(not one.effect.named for one in kept.cause_claims)
    names = any(one.effect.named for one in kept.cause_claims)
    labels = {claim.effect.label for claim in kept.claims}
    dropped = tuple(claim for claim in found.claims if claim.effect.label not in labels)
    left = (
        problem.has_excess(kept.residual)
        or any(not one.effect.named for one in dropped)
        or any(
            name in accounted and accounted[name]["all"] < 1.0 - PRACTICAL_SHARE
            for name in _remaining_equations(holdout, kept)
        )
        or (not kept.cause_claims and bool(_remaining_equations(holdout, kept)))
    )
    if not left:
        verdict = ("modelled" if terms else "explained") if kept.cause_claims else "no_mismatch"
        locations = tuple(locate_claims(problem, kept, baseline_fit.residual))
        return Assessment(verdict, kept, locations, (), (), dropped)
    forms = free_forms(problem, kept)
    remainder = tuple(locate(problem, kept.residual, forms))
    if not remainder:  # an unnamed term may be small, and the held-out recordings may have more
        remainder = tuple(locate(holdout, holdout.residual(kept.claims))) or tuple(
            locate_claims(problem, found, baseline_fit.residual)
        )
        nowhere = tuple(() for _ in problem.models)  # in the fitted recordings
        remainder = tuple(replace(one, windows=nowhere) for one in remainder)
    locations = tuple(locate_claims(problem, kept, baseline_fit.residual)) or remainder
    runs = [*simulated["holdout"].values(), *(one for one in simulated["free_run"].values() if isinstance(one, dict))]
    worse = any(not one["rmse_after"] <= 1.2 * one["rmse_before"] for one in runs)
    whole = all(one["all"] >= 1.0 - PRACTICAL_SHARE for one in accounted.values()) and bool(accounted) and not worse
    if kept.cause_claims and whole:
        verdict = "modelled" if terms else "explained"
    else:
        verdict = "partly_explained" if names else "unknown"
    return Assessment(verdict, kept, locations, remainder, tuple(forms[:6]), dropped)


def _remaining_equations(holdout: Problem, kept: Fit) -> list[str]:
    """Return the equations in which a fit leaves more than noise in the held-out recordings."""
    unseen = holdout.reweighted(kept.claims)
    return [_EQUATION_NAMES.get(name, name) for name in unseen.excess_channels(unseen.residual(kept.claims))]


def accounted_shares(
    errors: Mapping[str, Mapping[str, Any]], named: Mapping[str, Mapping[str, Any]]
) -> ExplainedShares:
    """Return the shares that all terms, and that the named ones, account for, by equation.

    `errors`, `named`: `validation.equation_errors` with all terms and with the named ones. Equations in which the bench
    file misses nothing but noise are left out.
    """
    found: ExplainedShares = {}
    for name, one in errors.items():
        floor = one["noise_floor"] ** 2
        missing = one["rmse_before"] ** 2 - floor
        if missing > EXCESS_THRESHOLD * floor:
            left = {"named": named[name]["rmse_after"], "all": one["rmse_after"]}
            found[_EQUATION_NAMES.get(name, name)] = {
                key: 1.0 - float(np.sqrt(max(after**2 - floor, 0.0) / missing)) for key, after in left.items()
            }
    return found
