# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the residual by each parameter, kept where terms without a name are fitted.

Such fits differ by a term or two, and terms that add to an equation add their own response whatever stands beside them:
so most columns that a fit needs have been computed for an earlier one, at the very same values.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_diagnosis.effects.base import Claim, FitParameter, FloatArray
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.addition import Key, acts, apart, between, shapes, written
from hydro_diagnosis.estimation.parameters import pack, unpack
from hydro_diagnosis.estimation.problem import Problem

STEP = 1e-3
"""Step of the differences, in `FitParameter.span`s."""


def jacobian(problem: Problem, claims: Sequence[Claim], residual: FloatArray, first: int = 0) -> FloatArray:
    """One-sided differences, towards the neutral value's far side unless a bound stands there.

    `residual`: at these claims. `first`: parameter from which on columns are computed.
    """
    parameters, values = pack(claims)
    effects = [claim.effect for claim in claims]
    owners = [claim for claim in claims for _ in claim.effect.parameters]
    keeping = any(isinstance(effect, Closure) for effect in effects)
    columns = np.empty((len(residual), len(values) - first))
    for k, parameter in enumerate(parameters[first:], first):
        step = STEP * parameter.span
        if values[k] + step > parameter.high:
            step = -step
        key = _key(problem, claims, owners[k], parameter) if keeping else ()
        known = problem.columns.get(key) if keeping else None
        if known is None:
            moved = values.copy()
            moved[k] += step
            known = (problem.residual(unpack(effects, moved)) - residual) * (parameter.span / step)
            if keeping:
                problem.columns.put(key, known, known.nbytes)
        else:
            problem.evaluations += 1  # a search's effort is the same, however it is spared
        columns[:, k - first] = known
    return columns


def _key(problem: Problem, claims: Sequence[Claim], claim: Claim, parameter: FitParameter) -> Key:
    """All that a column depends on: beside the doubt the values of the claims that reach its equations.

    Of terms that add, their own amplitudes and other such terms do not count; nor do terms without amplitude.
    """
    adding, others = apart((*problem.baseline, *claims, _present(claim)))
    adds = any(one.effect is claim.effect for one in adding)
    beside = between(claim, others) if adds else [
        one for one in claims if one is not claim and acts(one) and one.effect.touches & claim.effect.touches
    ]  # fmt: skip
    own = shapes(claim) if adds and parameter.smallest > 0.0 else [*claim.values.values()]
    rounded = tuple(one.effect.label for one in claims if one.effect.rounds)
    limits = getattr(claim.effect, "limits", ())
    return problem.doubted, claim.effect.label, parameter.name, limits, *own, rounded, written(beside)


def _present(claim: Claim) -> Claim:
    """A claim with amplitudes that act."""
    sizes = {one.name: one.span for one in claim.effect.parameters if one.smallest > 0.0}
    return Claim(claim.effect, {**claim.values, **sizes})
