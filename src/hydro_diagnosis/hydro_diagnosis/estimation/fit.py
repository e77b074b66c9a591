# SPDX-License-Identifier: Apache-2.0
"""Least squares over the parameters of some claims, with each channel weighed by what it leaves unexplained.

A channel's deviation is never taken below the measured noise, and above it where the claims leave a remainder: so a
channel that nobody can explain does not drown the evidence of the others (diagnosis.md, "Evidence").

Columns of the Jacobian are cached where terms without a name are fitted: such fits differ by a term or two, and an
additive term has the same response whatever stands beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hydro_diagnosis.effects.base import Claim, Effect, FitParameter, FloatArray, values_key
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.estimation.equation_residuals import Key, intervening, is_active, shapes, split_additive
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_sim.model.tables import Table

Part = TypeVar("Part")


def pack(claims: Sequence[Claim]) -> tuple[list[FitParameter], FloatArray]:
    """Parameters and their values, claim after claim."""
    parameters = [parameter for claim in claims for parameter in claim.effect.parameters]
    values = [claim.values[parameter.name] for claim in claims for parameter in claim.effect.parameters]
    return parameters, np.array(values, dtype=np.float64)


def by_claim(claims: Sequence[Claim], values: Sequence[Part]) -> Iterator[tuple[Claim, Sequence[Part]]]:
    """Each claim with its part of `values`, which have one entry per parameter in the order of `pack`."""
    at = 0
    for claim in claims:
        yield claim, values[at : at + len(claim.effect.parameters)]
        at += len(claim.effect.parameters)


def unpack(effects: Sequence[Effect], values: FloatArray) -> tuple[Claim, ...]:
    """Claims from values."""
    claims, k = [], 0
    for effect in effects:
        names = [parameter.name for parameter in effect.parameters]
        claims.append(Claim(effect, dict(zip(names, map(float, values[k : k + len(names)]), strict=True))))
        k += len(names)
    return tuple(claims)


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
            problem.count(1)
        columns[:, k - first] = known
    return columns


def _key(problem: Problem, claims: Sequence[Claim], claim: Claim, parameter: FitParameter) -> Key:
    """All that a column depends on: beside the doubt the values of the claims that reach its equations.

    Of terms that add, their own amplitudes and other such terms do not count; nor do terms without amplitude.
    """
    adding, others = split_additive((*problem.baseline, *claims, _present(claim)))
    adds = any(one.effect is claim.effect for one in adding)
    beside = intervening(claim, others) if adds else [
        one for one in claims if one is not claim and is_active(one) and one.effect.blocks & claim.effect.blocks
    ]  # fmt: skip
    own = shapes(claim) if adds and parameter.smallest > 0.0 else [*claim.values.values()]
    rounded = tuple(one.effect.label for one in claims if one.effect.lagged)
    limits = getattr(claim.effect, "limits", ())
    return problem.uncertainty, claim.effect.label, parameter.name, limits, *own, rounded, values_key(beside)


def _present(claim: Claim) -> Claim:
    """A claim with amplitudes that act."""
    sizes = {one.name: one.span for one in claim.effect.parameters if one.smallest > 0.0}
    return Claim(claim.effect, {**claim.values, **sizes})


STRAIGHT = 0.05
"""Share of a step's effect that slopes may have missed and still hold at its end."""
QUANTILE = 1.96
NOTICEABLE = 0.35
"""Mean square over the noise's, beyond 1, from which a channel holds more than noise: how well the noise is known."""
CHANCE = 4.0
"""Standard deviations of the mean of n squares of white noise, sqrt(2 / n), that it must exceed 1 by too."""
FORM_ERROR = 0.035
"""Share of a claim's signature that its form may be off by: another of its family must explain more."""
SHORTEST = 1e-100
"""Length of a column below which it counts as nothing: its square still is a number."""


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
    def removable(self) -> tuple[Claim, ...]:
        """Judged claims that no other needs."""
        needed = {name for claim in self.claims for name in claim.effect.needs}
        return tuple(claim for claim in self.judged if claim.effect.id not in needed)

    def but(self, claim: Claim) -> tuple[Claim, ...]:
        """All claims but this one."""
        return tuple(one for one in self.claims if one is not claim)

    def columns(self, claim: Claim) -> slice:
        """Columns of the Jacobian that are a claim's."""
        at = sum(len(one.effect.parameters) for one in self.claims[: self.claims.index(claim)])
        return slice(at, at + len(claim.effect.parameters))

    @property
    def free(self) -> int:
        """Number of fitted parameters."""
        return self.jacobian.shape[1]

    @property
    def score(self) -> float:
        """Deviance plus price: lower is better."""
        return self.deviance + self.free * float(np.log(len(self.residual)))


def residual_variances(problem: Problem, residual: FloatArray) -> FloatArray:
    """Mean square of each channel's residual, at least 1 (the noise), shape (5,)."""
    layout = problem.layout
    count = np.maximum(layout.count, 1.0)
    return np.maximum(layout.squares(residual) / count, 1.0)


def deviance(problem: Problem, residual: FloatArray) -> float:
    """-2 log likelihood up to a constant, with a channel's variance at its most likely value of 1 or more."""
    layout = problem.layout
    squares = layout.squares(residual)
    variance = np.maximum(squares / np.maximum(layout.count, 1.0), 1.0)
    return float(np.sum(layout.count * np.log(variance) + squares / variance))


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
    being computed at each. Beside tables that do not just add, a Jacobian that predicted a step serves for the next
    one too; what is reached by it is confirmed by a fresh one.
    """
    claims = problem.with_estimated(claims)
    effects = [claim.effect for claim in claims]
    values = pack(claims)[1]
    span = np.array([parameter.span for parameter in pack(claims)[0]])
    residual = problem.residual(claims)
    best = deviance(problem, residual)
    slopes = None if problem.estimated else slopes  # numbers begin far from where they end: too far for secants
    damping, secant = 1e-4, slopes is not None
    slopes = jacobian(problem, claims, residual) if slopes is None else slopes
    lasting = not secant and any(_many(effect) for effect in effects)
    old = False
    for _ in range(iterations if len(values) else 0):
        weight = 1.0 / residual_variances(problem, residual)[problem.layout.channel]
        found = _stepped(problem, effects, values, residual, best, slopes, weight, damping, fixed)
        if found is None and not old:
            break
        gained = 0.0
        if found is not None:
            trial, outcome, reached, damping = found
            gained, best = best - reached, reached
            step, damping = (trial - values) / span, damping * 0.1
            predicted = slopes @ step
            missed = outcome - residual - predicted
            if secant:
                slopes = slopes + np.outer(missed, step / max(float(step @ step), 1e-300))
            values, residual = trial, outcome
        ends = gained < tolerance and not old
        if not secant and not (ends and lasting):
            # a step that gained next to nothing tells nothing about the slopes
            old = lasting and gained >= tolerance and _share(missed, predicted, weight) < STRAIGHT
            slopes = slopes if old else jacobian(problem, unpack(effects, values), residual)
            problem.count(len(values) if old else 0)
        if ends:
            break
    if old:
        slopes = jacobian(problem, unpack(effects, values), residual)
    return Fit(unpack(effects, values), residual, slopes, best)


def _stepped(problem: Problem, effects: Sequence[Effect], values: FloatArray, residual: FloatArray, best: float,
             slopes: FloatArray, weight: FloatArray, damping: float, fixed: int | None,
             ) -> tuple[FloatArray, FloatArray, float, float] | None:  # fmt: skip
    """Values, residual, deviance and damping after a step that gains; None where none does."""
    parameters = [parameter for effect in effects for parameter in effect.parameters]
    low, high, span = (np.array([getattr(one, name) for one in parameters]) for name in ("low", "high", "span"))
    normal = slopes.T @ (slopes * weight[:, None])
    force = slopes.T @ (residual * weight)
    if fixed is not None:
        normal[fixed, :] = normal[:, fixed] = force[fixed] = 0.0
        normal[fixed, fixed] = 1.0
    for _ in range(4):
        damped = normal + damping * np.diag(np.diag(normal) + 1e-12 * np.trace(normal) + 1e-300)
        trial = np.clip(values - np.linalg.lstsq(damped, force, rcond=None)[0] * span, low, high)
        outcome = problem.residual(unpack(effects, trial))
        reached = deviance(problem, outcome)
        if reached < best:
            return trial, outcome, reached, damping
        damping *= 20.0
    return None


def _many(effect: Effect) -> bool:
    return isinstance(effect, Closure) and isinstance(effect.law, Table) and not effect.additive


def _share(missed: FloatArray, predicted: FloatArray, weight: FloatArray) -> float:
    """Weighted size of what slopes missed of a step's effect, over what they predicted."""
    return float(np.sqrt(missed**2 @ weight / max(float(predicted**2 @ weight), 1e-300)))


def orthogonal(columns: FloatArray, vector: FloatArray) -> FloatArray:
    """Part of a vector that is orthogonal to columns."""
    if columns.shape[1] == 0:
        return vector
    lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(vector - columns @ (np.linalg.lstsq(columns / lengths, vector, rcond=1e-10)[0] / lengths))


def with_one_more(problem: Problem, found: Fit, claim: Claim, *, tolerance: float = 0.1) -> Fit:
    """The fit with another claim, the slopes of its parameters computed and those of `found` taken over."""
    claims = (*found.claims, claim)
    own = jacobian(problem, claims, problem.residual(claims), found.free)
    return fit(problem, claims, tolerance=tolerance, slopes=np.column_stack([found.jacobian, own]))


def without_one(problem: Problem, found: Fit, claim: Claim, *, tolerance: float = 0.1) -> Fit:
    """The fit without a claim, by the slopes of `found`."""
    at = found.claims.index(claim)
    slopes = np.delete(found.jacobian, found.columns(claim), axis=1)
    others = (*found.claims[:at], *found.claims[at + 1 :])
    return fit(problem, others, tolerance=tolerance, slopes=slopes)


def mean_squares(problem: Problem, residual: FloatArray) -> dict[str, float]:
    """Each channel's mean square over the noise's."""
    layout = problem.layout
    squares = np.bincount(layout.channel, np.square(residual), len(CHANNELS))
    count = layout.count
    return {name: float(squares[k] / count[k]) for k, name in enumerate(CHANNELS) if count[k]}


def noise_thresholds(problem: Problem) -> dict[str, float]:
    """Each channel's mean square over the noise's above which it holds more than noise.

    The residuals are all but independent, so the mean of n squares has variance 2 / n (chi-square).
    """
    count = problem.layout.count
    return {
        name: 1.0 + max(NOTICEABLE, CHANCE * float(np.sqrt(2.0 / count[k])))
        for k, name in enumerate(CHANNELS)
        if count[k]
    }


def remaining(problem: Problem, residual: FloatArray) -> dict[str, float]:
    """Mean square over the noise's of those channels that hold more than noise."""
    limit = noise_thresholds(problem)
    return {name: square for name, square in mean_squares(problem, residual).items() if square > limit[name]}


def noticeable(problem: Problem, residual: FloatArray) -> bool:
    """Return whether any channel holds more than noise."""
    return bool(remaining(problem, residual))


def holdout_gain(held: Problem, without: Fit, found: Fit) -> float:
    """Share of the held-out squared residual, beyond that of all claims, that a claim removes; below 0: it adds."""
    squares = [float(np.sum(np.square(held.residual(claims)))) for claims in ((), without.claims, found.claims)]
    nothing, fewer, everything = squares
    return (fewer - everything) / max(nothing - everything, 1e-12)
