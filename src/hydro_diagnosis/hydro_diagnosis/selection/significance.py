# SPDX-License-Identifier: Apache-2.0
"""Significance of a claim: large enough, physically possible, and more than a form error of a related claim."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import Claim, FitParameter, FloatArray
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.estimation.unrecorded_rows import shifts
from hydro_diagnosis.selection.localisation import mean_squares, noticeable, remaining
from hydro_diagnosis.selection.outcome import MINOR

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
