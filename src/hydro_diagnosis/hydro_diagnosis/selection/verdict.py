# SPDX-License-Identifier: Apache-2.0
"""Verdict: the claims that hold, and whether an unnamed remainder is left.

A name is never forced. Where something remains, claims that explain little are dropped, as they may only mimic the
remainder; and if those that are left do not explain nearly all of the gap, or follow the state though they should be
constant, they are dropped too and the verdict is `unknown`. What the search found without a name is no claim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.fit import Fit, fit, orthogonal
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.selection.localisation import FreeForm, Place, free_forms, locate, locate_claims, variables
from hydro_diagnosis.selection.steady_motion import FRICTION, curves, missed

MOST = 0.5
"""Share of what remains that a claimed number may remove by varying."""


def without_varying(problem: Problem, found: Fit, judged: npt.NDArray[np.bool_], spared: frozenset[str]) -> Fit:
    """The fit without claims that explain most of what remains if their numbers vary.

    `judged`: residuals in which something remains, shape (n,). `spared`: ids that are not questioned.
    """
    remains = float(np.sum(np.square(found.residual[judged]))) - float(np.count_nonzero(judged))
    if not found.claims or remains <= 0.0:
        return found
    states = [_along(problem, name) for name in variables(problem)]
    steady = []
    for claim in found.claims:
        slopes = found.jacobian[:, found.columns(claim)]
        removed = (
            0.0
            if claim.effect.estimated or claim.effect.id in spared
            else max(_removed(found, slopes, one, judged) for one in states)
        )
        if removed <= MOST * remains:
            steady.append(claim)
    return found if len(steady) == len(found.claims) else fit(problem, steady)


def _removed(found: Fit, slopes: FloatArray, state: FloatArray, judged: npt.NDArray[np.bool_]) -> float:
    """Squares that go if a claim's numbers follow a variable, beyond what the claims' own values can take up."""
    columns = np.column_stack([found.jacobian, slopes * state[:, None]])[judged]
    left = found.residual[judged]
    return float(left @ left - np.sum(np.square(orthogonal(columns, left))))


def _along(problem: Problem, name: str) -> FloatArray:
    """A variable at every residual, of mean 0 and standard deviation 1, shape (n,)."""
    layout = problem.layout
    values = np.zeros(len(layout.time))
    for k, model in enumerate(problem.models):
        at = layout.segment == k
        values[at] = np.interp(layout.time[at], model.time, model.variable(name))
    centred: FloatArray = values - values.mean()
    return centred / max(float(values.std()), 1e-300)


MOST_OF_THE_GAP = 0.98
"""Share of the squared mismatch that names must explain where something remains."""
MINOR = 0.1
"""Share below which a claim is dropped where something remains."""
EVERYDAY = frozenset({"friction_coulomb", "friction_viscous", "force_offset", "moving_mass"})
"""Causes that every drive has: where names explain nearly all of the gap, these are believed beside a remainder."""
EVERYDAY_SHARE = 0.5
"""Share of the remainder that such a cause must explain."""


@dataclass(frozen=True)
class Assessment:
    """Assessment of a search's outcome."""

    verdict: str
    """no_mismatch, explained, modelled, partly_explained or unknown."""
    fit: Fit
    """The fit with the claims that hold."""
    places: tuple[Place, ...]
    """Location of the mismatch against the baseline."""
    remainder: tuple[Place, ...]
    """Where an unnamed remainder is left."""
    forms: tuple[FreeForm, ...]
    """Free-form inputs for what remains, the most informative first; empty if nothing remains."""
    dropped: tuple[Claim, ...]
    """Claims of the search that this assessment rejects."""


def assess(problem: Problem, found: Fit, nothing: Fit) -> Assessment:
    """Judge the fit that a search ended with against the fit without claims."""
    alike, unnamed = coincidence(found.judged), not all(claim.effect.named for claim in found.claims)
    if not problem.noticeable(found.residual) and not alike and not unnamed:
        verdict = "explained" if found.judged else "no_mismatch"
        return Assessment(verdict, found, tuple(locate_claims(problem, found, nothing.residual)), (), (), ())
    kept = nothing if alike else _named(problem, _trusted(problem, found, nothing))
    remainder, forms = unexplained(problem, kept)
    remainder = remainder or tuple(locate_claims(problem, found, nothing.residual))  # an unnamed cause may be small
    places = tuple(locate_claims(problem, kept, nothing.residual)) or remainder
    return Assessment(_verdict(kept), kept, places, remainder, forms, _dropped(found.claims, kept))


def refuted(problem: Problem, assessment: Assessment, kept: Fit) -> Assessment:
    """The judgement without those of its claims that fit and yet do not hold; `kept`: the fit of the others."""
    remainder, forms = unexplained(problem, kept)
    remainder = remainder or assessment.places
    places = assessment.places if kept.judged else remainder
    dropped = (*assessment.dropped, *_dropped(assessment.fit.judged, kept))
    return Assessment(_verdict(kept), kept, places, remainder, forms, dropped)


def unexplained(problem: Problem, kept: Fit) -> tuple[tuple[Place, ...], tuple[FreeForm, ...]]:
    """Where a fit leaves something, and free-form inputs for it, the most informative first."""
    forms = free_forms(problem, kept)
    return tuple(locate(problem, kept.residual, forms)), tuple(forms[:6])


def _dropped(claims: Sequence[Claim], kept: Fit) -> tuple[Claim, ...]:
    labels = {claim.effect.label for claim in kept.claims}
    return tuple(claim for claim in claims if claim.effect.label not in labels)


def _verdict(kept: Fit) -> str:
    return "partly_explained" if kept.judged else "unknown"


def _named(problem: Problem, found: Fit) -> Fit:
    """The fit without what has no name; the others keep the values that they have beside it."""
    named = tuple(claim for claim in found.claims if claim.effect.named)
    return found if len(named) == len(found.claims) else fit(problem, named, iterations=0)


def _trusted(problem: Problem, found: Fit, nothing: Fit) -> Fit:
    """The fit without those claims that act where something remains and do not explain nearly all of it.

    Claims that show in other channels, in which nothing remains, are not in question.
    """
    suspects = _suspects(problem, found)
    fewer, everyday = _without_minor(problem, found, nothing, suspects)
    left = [claim for claim in fewer.claims if claim.effect.label in suspects]
    if left and explained_share(problem, fewer, nothing) >= MOST_OF_THE_GAP and (everyday or not _crowded(left)):
        return without_varying(problem, fewer, _judged(problem, fewer), EVERYDAY)
    kept = tuple(claim for claim in fewer.claims if claim.effect.label not in suspects)
    if problem.unseen_ringing:
        kept = (*kept, *seen_at_steady_speed(problem, kept, found))
    return fit(problem, kept)


def seen_at_steady_speed(problem: Problem, kept: Sequence[Claim], found: Fit) -> tuple[Claim, ...]:
    """Everyday causes of `found` that `kept` misses at steady speed, where no ringing is: with them it misses none."""
    steady = EVERYDAY - {"moving_mass"}
    everyday = tuple(one for one in found.judged if one.effect.id in steady and one not in kept)
    misses = [missed(curves(problem, claims).get(FRICTION, ())) for claims in (kept, (*kept, *everyday))]
    return everyday if misses[0] and not misses[1] else ()


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


def _without_minor(problem: Problem, found: Fit, nothing: Fit, suspects: set[str]) -> tuple[Fit, bool]:
    """Drop, one after the other, suspects without which hardly more remains; those of `EVERYDAY` have it easier.

    Returned beside the fit: whether all suspects that are left are everyday causes that explain enough.
    """
    judged = _judged(problem, found)
    gap = float(np.sum(np.square(nothing.residual[judged])) - np.sum(np.square(found.residual[judged])))
    current = found
    while True:
        open_ = [one for one in current.removable if one.effect.label in suspects]
        if not open_ or len(current.judged) == 1:
            return current, False
        smaller = [fit(problem, current.but(claim)) for claim in open_]
        remains = float(np.sum(np.square(current.residual[judged])))
        losses = [float(np.sum(np.square(one.residual[judged]))) - remains for one in smaller]
        enough = EVERYDAY_SHARE * (remains - float(np.count_nonzero(judged)))
        nearly_all = explained_share(problem, current, nothing) >= MOST_OF_THE_GAP
        everyday = [
            nearly_all and claim.effect.id in EVERYDAY and loss > enough
            for claim, loss in zip(open_, losses, strict=True)
        ]
        minor = [k for k in range(len(open_)) if losses[k] <= MINOR * gap and not everyday[k]]
        if not minor:
            return current, all(everyday)
        current = smaller[min(minor, key=lambda k: losses[k])]


def coincidence(claims: Sequence[Claim]) -> bool:
    """Return whether both dead volumes are off alike: two errors do not agree, so it is another cause (soft hoses)."""
    ratios = [claim.values["ratio"] for claim in claims if claim.effect.id == "dead_volume"]
    return len(ratios) == 2 and abs(ratios[0] - ratios[1]) < 0.05 * abs(ratios[0] - 1.0)


def _crowded(claims: Sequence[Claim]) -> bool:
    """Return whether two names of one family share a mismatch that they do not explain."""
    families = [claim.effect.family or claim.effect.label for claim in claims if not claim.effect.needs]
    return len(set(families)) < len(families)
