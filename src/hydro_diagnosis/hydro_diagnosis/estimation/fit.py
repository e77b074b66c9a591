# SPDX-License-Identifier: Apache-2.0
"""Least squares over the parameters of some claims, with each channel weighed by what it leaves unexplained.

A channel's deviation is never taken below the measured noise, and above it where the claims leave a remainder: so a
channel that nobody can explain does not drown the evidence of the others (diagnosis.md, "Evidence").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect, FitParameter, FloatArray
from hydro_diagnosis.estimation.problem import Problem


@dataclass(frozen=True)
class Fit:
    """Claims at their best values."""

    claims: tuple[Claim, ...]
    residual: FloatArray
    jacobian: FloatArray
    """Columns: derivative of the residual by each parameter, in `FitParameter.span`s; shape (n, k)."""
    deviance: float
    """-2 log likelihood up to a constant."""

    @property
    def judged(self) -> tuple[Claim, ...]:
        """Claims, without the numbers that are estimated in any case."""
        return tuple(claim for claim in self.claims if not claim.effect.estimated)

    @property
    def free(self) -> int:
        """Number of fitted parameters."""
        return self.jacobian.shape[1]


def spreads(problem: Problem, residual: FloatArray) -> FloatArray:
    """Mean square of each channel's residual, at least 1 (the noise), shape (5,)."""
    layout = problem.layout
    count = np.maximum(layout.count(), 1.0)
    return np.maximum(layout.squares(residual) / count, 1.0)


def deviance(problem: Problem, residual: FloatArray) -> float:
    """-2 log likelihood up to a constant, with a channel's variance at its most likely value of 1 or more."""
    layout = problem.layout
    squares = layout.squares(residual)
    variance = np.maximum(squares / np.maximum(layout.count(), 1.0), 1.0)
    return float(np.sum(layout.count() * np.log(variance) + squares / variance))


def pack(claims: Sequence[Claim]) -> tuple[list[FitParameter], FloatArray]:
    """Parameters and their values, claim after claim."""
    parameters = [parameter for claim in claims for parameter in claim.effect.parameters]
    values = [claim.values[parameter.name] for claim in claims for parameter in claim.effect.parameters]
    return parameters, np.array(values, dtype=np.float64)


def unpack(effects: Sequence[Effect], values: FloatArray) -> tuple[Claim, ...]:
    """Claims from values."""
    claims, k = [], 0
    for effect in effects:
        names = [parameter.name for parameter in effect.parameters]
        claims.append(Claim(effect, dict(zip(names, map(float, values[k : k + len(names)]), strict=True))))
        k += len(names)
    return tuple(claims)


def jacobian(problem: Problem, claims: Sequence[Claim], residual: FloatArray, first: int = 0) -> FloatArray:
    """One-sided differences, towards the neutral value's far side unless a bound stands there.

    `first`: parameter from which on columns are computed.
    """
    parameters, values = pack(claims)
    effects = [claim.effect for claim in claims]
    columns = np.empty((len(residual), len(values) - first))
    for k, parameter in enumerate(parameters[first:], first):
        step = 1e-3 * parameter.span
        if values[k] + step > parameter.high:
            step = -step
        moved = values.copy()
        moved[k] += step
        columns[:, k - first] = (problem.residual(unpack(effects, moved)) - residual) * (parameter.span / step)
    return columns


def fit(
    problem: Problem,
    claims: Sequence[Claim],
    *,
    iterations: int = 8,
    tolerance: float = 0.1,
    fixed: int | None = None,
    slopes: FloatArray | None = None,
) -> Fit:
    """Levenberg-Marquardt from the claims' values, within their bounds, until the deviance gains less than `tolerance`.

    Numbers that the problem estimates are fitted too, before the claims. `fixed`: index of a parameter that stays where
    it is. `slopes`: the Jacobian nearby; it is then followed by secants (Broyden 1965), one residual a step, instead of
    being computed at each.
    """
    claims = problem.with_estimated(claims)
    effects = [claim.effect for claim in claims]
    parameters, values = pack(claims)
    low = np.array([parameter.low for parameter in parameters])
    high = np.array([parameter.high for parameter in parameters])
    span = np.array([parameter.span for parameter in parameters])
    residual = problem.residual(claims)
    best = deviance(problem, residual)
    slopes = None if problem.estimated else slopes  # numbers begin far from where they end: too far for secants
    damping, secant = 1e-4, slopes is not None
    slopes = jacobian(problem, claims, residual) if slopes is None else slopes
    for _ in range(iterations if len(values) else 0):
        weight = 1.0 / spreads(problem, residual)[problem.layout.channel]
        normal = slopes.T @ (slopes * weight[:, None])
        force = slopes.T @ (residual * weight)
        if fixed is not None:
            normal[fixed, :] = normal[:, fixed] = force[fixed] = 0.0
            normal[fixed, fixed] = 1.0
        improved = False
        for _ in range(4):
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12 * np.trace(normal) + 1e-300)
            move = -np.linalg.lstsq(damped, force, rcond=None)[0] * span
            trial = np.clip(values + move, low, high)
            outcome = problem.residual(unpack(effects, trial))
            reached = deviance(problem, outcome)
            if reached < best:
                improved = True
                break
            damping *= 20.0
        if not improved:
            break
        gained, best = best - reached, reached
        step = (trial - values) / span
        if secant:
            slopes = slopes + np.outer(outcome - residual - slopes @ step, step / max(float(step @ step), 1e-300))
        values, residual, damping = trial, outcome, damping * 0.1
        if not secant:
            slopes = jacobian(problem, unpack(effects, values), residual)
        if gained < tolerance:
            break
    return Fit(unpack(effects, values), residual, slopes, best)


def with_one_more(problem: Problem, found: Fit, claim: Claim, *, tolerance: float = 0.1) -> Fit:
    """The fit with another claim, the slopes of its parameters computed and those of `found` taken over."""
    claims = (*found.claims, claim)
    own = jacobian(problem, claims, problem.residual(claims), found.free)
    return fit(problem, claims, tolerance=tolerance, slopes=np.column_stack([found.jacobian, own]))


def without_one(problem: Problem, found: Fit, claim: Claim, *, tolerance: float = 0.1) -> Fit:
    """The fit without a claim, by the slopes of `found`."""
    counts = [len(one.effect.parameters) for one in found.claims]
    at = found.claims.index(claim)
    begin = sum(counts[:at])
    slopes = np.delete(found.jacobian, range(begin, begin + counts[at]), axis=1)
    others = (*found.claims[:at], *found.claims[at + 1 :])
    return fit(problem, others, tolerance=tolerance, slopes=slopes)
