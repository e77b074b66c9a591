# SPDX-License-Identifier: Apache-2.0
"""Settings and outcome of a search, the score that it minimises, and the significance of a claim.

A claim is significant if it is large enough, physically possible, and more than a form error of a related claim.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from hydro_bridge.settings import quantity
from hydro_diagnosis.effects.base import Claim, FitParameter, FloatArray
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.estimation.intervals import shifts
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.selection.localisation import mean_squares, noticeable, remaining


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """Effort of a search, and its thresholds of a claim."""

    threshold: Annotated[float, quantity("-", 0.0, 1000.0)] = 20.0
    """Evidence in units of BIC that a claim needs beyond its parameters' price: a choice, held against recordings
    with nothing missing (`benchmarks.null_simulations`).
    """
    most: Annotated[int, quantity("-", 0, 100)] = 6
    """Claims at most."""
    patience: Annotated[int, quantity("-", 1, 100)] = 100
    """Claims one after the other that may remove less than `MINOR` of what remains where they act: more is mimicry."""
    shortlist: Annotated[int, quantity("-", 1, 1000)] = 7
    """Prospects that are fitted in full at each step."""
    form_error: Annotated[float, quantity("-", 0.0, 1.0)] = 0.035
    """Share of a claim's signature that its form may be off by: another of its family must explain more."""
    restarts: Annotated[int, quantity("-", 1, 10)] = 3
    """First claims that are tried, one search each, as long as something remains unexplained."""
    effort: Annotated[int, quantity("-", 100, 1000000)] = 9000
    """Evaluations of all residuals after which no further claim is looked for, and a third of which may go before
    the search begins again: some 3 ms each for 60 s of data.
    """


NAMES = SearchSettings(most=12, patience=2)
"""Of a search among names alone: where nothing remains, or what remains has no name, it ends by itself."""
MINOR = 0.1
"""Share of what remains in a channel below which a claim says little about it."""


@dataclass(frozen=True)
class Step:
    """One step of the search, for the plot of how evidence converged."""

    action: str
    label: str
    score: float


@dataclass
class Outcome:
    """Outcome of a search."""

    problem: Problem
    """The problem with the weights of the fit."""
    fit: Fit
    nothing: Fit
    steps: list[Step] = field(default_factory=list)
    rivals: dict[str, list[Fit]] = field(default_factory=dict)
    """By a claim's label: fits in which another cause stands in its place, best first."""
    cut_short: str = ""
    """Why the search ended before nothing paid, in words; empty if it did not."""


def score(problem: Problem, found: Fit) -> float:
    """Deviance plus price: lower is better."""
    return found.deviance + found.free * float(np.log(len(found.residual)))


ABSENT = 0.05
"""Share of a shape's neutral value within which an effect without amplitudes is absent."""
ATTENUATIONS = 2.0
"""Multiple of `Problem.attenuation`, and of the change by half of the rows, that a claim must exceed."""


def is_significant(claim: Claim) -> bool:
    """Return whether any of a claim's amplitudes is beyond its smallest size, and none where physics ends.

    An effect that has shapes alone (bristles, by their stiffness) must not stand where it is none.
    """
    amplitudes = [one for one in claim.effect.parameters if one.smallest > 0.0]
    if any(_at_its_end(one, claim.values[one.name]) for one in amplitudes):
        return False
    if not amplitudes:
        return any(
            abs(claim.values[one.name] - one.neutral) > ABSENT * abs(one.neutral) for one in claim.effect.parameters
        )
    return any(abs(claim.values[one.name] - one.neutral) >= one.smallest for one in amplitudes)


def all_significant(problem: Problem, found: Fit) -> bool:
    """Return whether every claim is significant, and beyond the error of noise in its signal and of missing rows."""
    if not all(is_significant(claim) and _beyond_attenuation(problem, claim) for claim in found.judged):
        return False
    moved = zip(found.claims, shifts(problem, found), strict=True)
    return all(claim.effect.estimated or _beyond(claim, shift) for claim, shift in moved)


def _beyond(claim: Claim, shift: FloatArray) -> bool:
    """Return whether any of a claim's amplitudes (or its first shape, if it has none) is beyond its shift."""
    pairs = list(zip(claim.effect.parameters, shift, strict=True))
    amplitudes = [(one, moved) for one, moved in pairs if one.smallest > 0.0] or pairs[:1]
    return any(abs(claim.values[one.name] - one.neutral) >= ATTENUATIONS * moved for one, moved in amplitudes)


def _beyond_attenuation(problem: Problem, claim: Claim) -> bool:
    least = ATTENUATIONS * problem.attenuation.get(claim.effect.id, 0.0)
    return not least or any(abs(claim.values[one.name] - one.neutral) >= least for one in claim.effect.parameters)


def _at_its_end(parameter: FitParameter, value: float) -> bool:
    """Return whether a value stands at a bound that is not its neutral value."""
    near = 1e-3 * parameter.smallest
    return any(abs(value - end) <= near < abs(end - parameter.neutral) for end in (parameter.low, parameter.high))


def form_error(problem: Problem, base: Fit, found: Fit, share: float) -> bool:
    """Return whether the newest claim explains no more than an error in the form of its kin would.

    Never so where something remains without it and nothing with it: a form that is off leaves something with any name.

    `share`: of a claim's signature that its form may be off by.
    """
    if noticeable(problem, base.residual) and not noticeable(problem, found.residual):
        return False
    newest = found.claims[-1].effect
    kin = [claim for claim in base.judged if newest.family and claim.effect.family == newest.family]
    for claim in kin:
        if claim.effect.id in newest.needs:
            continue
        without = problem.residual(tuple(one for one in found.claims[:-1] if one.effect is not claim.effect))
        signature = float(np.sum(np.square(without - problem.residual(found.claims[:-1]))))
        added = float(np.sum(np.square(base.residual)) - np.sum(np.square(found.residual)))
        if added < share**2 * signature:
            return True
    return False


def nibbles(problem: Problem, base: Fit, found: Fit) -> bool:
    """Return whether the newest claim removes little of what remains in the channel in which it removes most."""
    before, after = (mean_squares(problem, one.residual) for one in (base, found))
    counts = dict(zip(CHANNELS, problem.layout.count(), strict=True))
    channel = max(before, key=lambda name: (before[name] - after[name]) * counts[name])
    excess = remaining(problem, found.residual).get(channel, 1.0) - 1.0
    return before[channel] - after[channel] < MINOR * excess
