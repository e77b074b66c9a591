# SPDX-License-Identifier: Apache-2.0
"""Maximum-likelihood fit of effects' parameters: least squares with each channel weighted by its residual variance.

A channel's standard deviation is at least that of the measured noise, and larger where the effects leave a residual: a
channel that no effect explains does not outweigh the evidence of the others (diagnosis.md, "Evidence").

A claim, here and in the names below, is an effect with parameter values (`EffectHypothesis`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.effects.base import Effect, EffectHypothesis, FitParameter, FloatArray
from hydro_diagnosis.significance import FOLDS, ITERATIONS
from hydro_sim.identification.least_squares import damped_step

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem

Part = TypeVar("Part")


def pack(claims: Sequence[EffectHypothesis]) -> tuple[list[FitParameter], FloatArray]:
    """Return the parameters of all effects and their values, shape (k,), effect by effect."""
    parameters = [parameter for claim in claims for parameter in claim.effect.parameters]
    values = [claim.values[parameter.name] for claim in claims for parameter in claim.effect.parameters]
    return parameters, np.array(values, dtype=np.float64)


def by_claim(
    claims: Sequence[EffectHypothesis], values: Sequence[Part]
) -> Iterator[tuple[EffectHypothesis, Sequence[Part]]]:
    """Yield each effect hypothesis with its part of `values`: one entry per parameter, in the order of `pack`."""
    at = 0
    for claim in claims:
        yield claim, values[at : at + len(claim.effect.parameters)]
        at += len(claim.effect.parameters)


def unpack(effects: Sequence[Effect], values: FloatArray) -> tuple[EffectHypothesis, ...]:
    """Return effects with parameter values from a vector in the order of `pack`, shape (k,)."""
    claims, k = [], 0
    for effect in effects:
        names = [parameter.name for parameter in effect.parameters]
        claims.append(EffectHypothesis(effect, dict(zip(names, map(float, values[k : k + len(names)]), strict=True))))
        k += len(names)
    return tuple(claims)


def jacobian(problem: Problem, claims: Sequence[EffectHypothesis], residual: FloatArray, first: int = 0) -> FloatArray:
    """Jacobian of the residual by one-sided differences over 1/1000 of a span, upwards unless a bound is closer.

    In residuals per `FitParameter.span`, shape (n, k - first). `residual`: at these values. `first`: index of the first
    parameter of which a column is computed. Zeros for a parameter at whose step the model runs away.
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
    columns[:, ~np.isfinite(columns).all(axis=0)] = 0.0
    return columns


FORM_ERROR_SHARE = 0.035
"""Form error of an effect as a share of its signature in the residual: another of its family must explain more."""
MIN_APART = 1e-3
"""Least squared sine between the signatures of two candidates that are tried as a pair."""
MIN_COLUMN_LENGTH = 1e-100
"""Lower bound of the length of a column, or of its square, in divisions: small, but its square does not underflow."""


@dataclass(frozen=True)
class Fit:
    """Maximum-likelihood fit of a set of effects: parameter values, with the residual, Jacobian and deviance there."""

    claims: tuple[EffectHypothesis, ...]
    residual: FloatArray
    jacobian: FloatArray
    """Columns: derivative of the residual by each parameter, in `FitParameter.span`s; shape (n, k)."""
    deviance: float
    """-2 log likelihood up to a constant."""

    @property
    def cause_claims(self) -> tuple[EffectHypothesis, ...]:
        """Fitted causes: all effects but the bench parameters that every fit estimates."""
        return tuple(claim for claim in self.claims if not claim.effect.estimated)

    @property
    def removable(self) -> tuple[EffectHypothesis, ...]:
        """Fitted causes that may be removed: no other effect of the fit needs them (`Effect.needs`)."""
        needed = {name for claim in self.claims for name in claim.effect.needs}
        return tuple(claim for claim in self.cause_claims if claim.effect.id not in needed)

    def claims_without(self, claim: EffectHypothesis) -> tuple[EffectHypothesis, ...]:
        """Return all effects of the fit, with their values, except one."""
        return tuple(one for one in self.claims if one is not claim)

    def columns(self, claim: EffectHypothesis) -> slice:
        """Return the slice of the Jacobian's columns that belong to an effect's parameters."""
        at = sum(len(one.effect.parameters) for one in self.claims[: self.claims.index(claim)])
        return slice(at, at + len(claim.effect.parameters))

    @property
    def parameter_count(self) -> int:
        """Number of fitted parameters."""
        return self.jacobian.shape[1]

    @property
    def score(self) -> float:
        """Bayesian information criterion: deviance plus ln(n) per parameter; lower is better."""
        return self.deviance + self.parameter_count * float(np.log(len(self.residual)))


def fit(
    problem: Problem,
    claims: Sequence[EffectHypothesis],
    *,
    iterations: int = ITERATIONS,
    tolerance: float = 0.1,
    fixed: int | None = None,
    slopes: FloatArray | None = None,
) -> Fit:
    """Fit effects by Levenberg-Marquardt from initial values, in bounds, until a step gains less than `tolerance`.

    Bench parameters that the problem estimates are fitted too; their columns come first. `tolerance`: in deviance.
    `fixed`: index of a parameter that is held constant. `slopes`: initial Jacobian; it is then updated by secants
    (Broyden 1965), with one residual a step, instead of being computed at each; ignored if bench parameters are
    estimated.
    """
    among = {claim.effect.label for claim in claims if claim.effect.estimated}
    claims = (*(one for one in problem.estimated if one.effect.label not in among), *claims)
    effects = [claim.effect for claim in claims]
    values = pack(claims)[1]
    span = np.array([parameter.span for parameter in pack(claims)[0]])
    residual = problem.residual(claims)
    best = problem.deviance(residual)
    slopes = None if problem.estimated else slopes  # these start far from their estimates: too far for secants
    damping, secant = 1e-4, slopes is not None
    slopes = jacobian(problem, claims, residual) if slopes is None else slopes
    for _ in range(iterations if len(values) else 0):
        weight = 1.0 / problem.variances(residual)[problem.layout.channel]
        found = _stepped(problem, effects, values, residual, best, slopes, weight, damping, fixed)
        if found is None:
            break
        (trial, outcome), reached, damping = found
        gained, best = best - reached, reached
        if secant:
            step = (trial - values) / span
            missed = outcome - residual - slopes @ step
            slopes = slopes + np.outer(missed, step / max(float(step @ step), 1e-300))
        values, residual = trial, outcome
        if not secant:
            slopes = jacobian(problem, unpack(effects, values), residual)
        if gained < tolerance:
            break
    return Fit(unpack(effects, values), residual, slopes, best)


def _stepped(problem: Problem, effects: Sequence[Effect], values: FloatArray, residual: FloatArray, best: float,
             slopes: FloatArray, weight: FloatArray, damping: float, fixed: int | None,
             ) -> tuple[tuple[FloatArray, FloatArray], float, float] | None:  # fmt: skip
    """Values and residual, deviance and next damping after a step that gains; None where none does."""
    parameters = [parameter for effect in effects for parameter in effect.parameters]
    low, high, span = (np.array([getattr(one, name) for one in parameters]) for name in ("low", "high", "span"))
    normal = slopes.T @ (slopes * weight[:, None])
    force = slopes.T @ (residual * weight)
    if fixed is not None:
        normal[fixed, :] = normal[:, fixed] = force[fixed] = 0.0
        normal[fixed, fixed] = 1.0

    def attempt(change: FloatArray) -> tuple[tuple[FloatArray, FloatArray], float]:
        trial = np.clip(values + change * span, low, high)
        outcome = problem.residual(unpack(effects, trial))
        return (trial, outcome), problem.deviance(outcome)

    return damped_step(normal, force, best, attempt, damping)


def cross_validated_deviance(
    products: FloatArray, weight: FloatArray, count: FloatArray, size: float = 1.0
) -> FloatArray:
    """Return the held-out deviance of each set of columns by cross-validation over blocks of time, shape (sets,).

    -2 log likelihood up to a constant. Residuals are linear in a term's parameters to first order. So cross-validation
    of any set of columns needs no further residual: each fold's products of all columns are summed once, by channel,
    and every set is solved from them.

    Parameters
    ----------
    products
        Inner products of a residual (the first) and the columns, by fold and channel, for sets of columns: shape
        (folds, channels, columns, columns, sets).
    weight, count
        Of each channel: inverse variance and number of residuals.
    size
        Squared length of the residual, if the products are those of a normalised one.
    """
    length = np.sqrt(np.maximum(np.einsum("fciim->im", products), MIN_COLUMN_LENGTH))
    length[0] = 1.0
    scaled = np.moveaxis(products / (length[:, None] * length), -1, 0)  # sets, folds, channels, columns, columns
    weighted = np.einsum("mfcij,c->mfij", scaled, weight)
    fitted = weighted.sum(axis=1, keepdims=True) - weighted
    theta = -np.linalg.pinv(fitted[..., 1:, 1:], rcond=1e-10, hermitian=True) @ fitted[..., 1:, :1]
    full = np.concatenate([np.ones((*theta.shape[:2], 1)), theta[..., 0]], axis=-1)
    squares = size * np.einsum("mfi,mfcij,mfj->mc", full, scaled, full, optimize=True)
    variance = np.maximum(squares / np.maximum(count, 1.0), 1.0)
    return np.asarray(np.sum(count * np.log(variance) + squares / variance, axis=-1))


def held_out_deviance(problem: Problem, found: Fit) -> float:
    """Return the cross-validated deviance of a fit: -2 log likelihood, up to a constant, of held-out blocks of time."""
    layout, channels = problem.layout, len(problem.layout.count)
    everything = np.column_stack([found.residual, found.jacobian])
    group = layout.channel * FOLDS + layout.folds()
    sorted_rows = everything[np.argsort(group, kind="stable")]
    parts = np.split(sorted_rows, np.cumsum(np.bincount(group, minlength=channels * FOLDS))[:-1])
    products = np.stack([one.T @ one for one in parts]).reshape(channels, FOLDS, *[everything.shape[1]] * 2)
    weight = 1.0 / problem.variances(found.residual)
    return float(cross_validated_deviance(products.swapaxes(0, 1)[..., None], weight, layout.count)[0])


def orthogonal(columns: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the component of a vector, shape (n,), orthogonal to columns, shape (n, k)."""
    if columns.shape[1] == 0:
        return vector
    lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(vector - columns @ (np.linalg.lstsq(columns / lengths, vector, rcond=1e-10)[0] / lengths))


def add_claim(problem: Problem, found: Fit, claim: EffectHypothesis, *, tolerance: float = 0.1) -> Fit:
    """Refit with one more effect.

    The initial Jacobian is that of the fit `found` with the new effect's columns appended; computed anew if the problem
    estimates bench parameters.
    """
    claims = (*found.claims, claim)
    if problem.estimated:
        return fit(problem, claims, tolerance=tolerance)  # bench parameters: no secants
    own = jacobian(problem, claims, problem.residual(claims), found.parameter_count)
    return fit(problem, claims, tolerance=tolerance, slopes=np.column_stack([found.jacobian, own]))


def remove_claim(problem: Problem, found: Fit, claim: EffectHypothesis, *, tolerance: float = 0.1) -> Fit:
    """Refit without one of the effects.

    The initial Jacobian is that of the fit `found` without the effect's columns; computed anew if the problem estimates
    bench parameters.
    """
    at = found.claims.index(claim)
    slopes = np.delete(found.jacobian, found.columns(claim), axis=1)
    others = (*found.claims[:at], *found.claims[at + 1 :])
    return fit(problem, others, tolerance=tolerance, slopes=slopes)


def holdout_gain(held: Problem, without: Fit, found: Fit) -> float:
    """Return an effect's share of a fit's reduction of the held-out squared residual; below 0: an increase.

    `without`: the fit without the effect.
    """
    squares = [float(np.sum(np.square(held.residual(claims)))) for claims in ((), without.claims, found.claims)]
    nothing, fewer, everything = squares
    return (fewer - everything) / max(nothing - everything, 1e-12)


@dataclass(frozen=True)
class Candidate:
    """Candidate effect at start values, with its first-order gain in deviance."""

    claim: EffectHypothesis
    gain: float


def eligible_effects(
    library: Sequence[Effect], claims: Sequence[EffectHypothesis], blocks: Sequence[str]
) -> Iterator[Effect]:
    """Yield the effects that may be added to a fit: of other causes, with no need that is absent, in these blocks."""
    taken = {cause_key(claim.effect) for claim in claims}
    ids = {claim.effect.id for claim in claims}
    for effect in library:
        if cause_key(effect) not in taken and set(effect.needs) <= ids and effect.blocks & set(blocks):
            yield effect


def cause_key(effect: Effect) -> tuple[str, ...]:
    """Return the key that all functional forms of a cause share: the effect's id and its options without `form`.

    A closure (a term without a name) keeps its form.
    """
    telling = {key: value for key, value in effect.options.items() if key != "form" or not effect.named}
    return (effect.id, *(f"{key}={value}" for key, value in telling.items()))


Signatures = dict[tuple[object, ...], npt.NDArray[np.float32]]
"""Changes of the residual by candidates at their start values (physical unit), cached by label and values.

They depend little on the other effects, so that outdated ones suffice to rank candidates, not to fit them.
"""


def rank_candidates(
    problem: Problem, found: Fit, library: Sequence[Effect], signatures: Signatures | None = None
) -> list[Candidate]:
    """Return the candidates that may be added to a fit, ranked by first-order gain; `signatures`: cache, extended."""
    weight, basis, left = _unexplained(problem, found)
    known = {} if signatures is None else signatures
    candidates = []
    for effect in eligible_effects(library, found.claims, problem.blocks):
        names, looks = [parameter.name for parameter in effect.parameters], []
        for values in product(*(parameter.start_values for parameter in effect.parameters)):
            claim, key = EffectHypothesis(effect, dict(zip(names, values, strict=True))), (effect.label, *values)
            if key in known:
                signature = known[key] / problem.deviations
            else:
                signature = problem.residual((*found.claims, claim)) - found.residual
                known[key] = (signature * problem.deviations).astype(np.float32)
            direction = signature * weight
            looks.append(_start_values(problem, claim, direction - basis @ (basis.T @ direction), weight, left))
        candidates.append(max(looks, key=lambda candidate: candidate.gain))
    return sorted(candidates, key=lambda candidate: -candidate.gain)


def rank_pairs(problem: Problem, found: Fit, candidates: Sequence[Candidate]) -> list[tuple[EffectHypothesis, ...]]:
    """Return pairs of candidates at start values, ranked by their joint first-order gain.

    Two may explain together what neither does alone, a valve's null and its gain say.
    """
    weight, basis, left = _unexplained(problem, found)
    claims, lengths, units = list[EffectHypothesis](), list[float](), list[FloatArray]()
    for claim in (one.claim for one in candidates if one.gain > 0.0):
        direction = (problem.residual((*found.claims, claim)) - found.residual) * weight
        direction -= basis @ (basis.T @ direction)
        length = float(np.linalg.norm(direction))
        if MIN_COLUMN_LENGTH < length < np.inf:  # else it shows nothing here, or its response runs away
            claims.append(claim)
            lengths.append(length)
            units.append((direction / length).astype(np.float32))
    if len(claims) < 2:
        return []
    directions = np.array(units)
    cosine, force = directions @ directions.T, -(directions @ left)
    ranked = []
    for one, other in combinations(range(len(claims)), 2):
        apart = 1.0 - cosine[one, other] ** 2
        if cause_key(claims[one].effect) == cause_key(claims[other].effect) or apart < MIN_APART:
            continue
        amounts = (force[[one, other]] - cosine[one, other] * force[[other, one]]) / apart
        pair = (_scaled(claims[k], amount / lengths[k]) for k, amount in zip((one, other), amounts, strict=True))
        ranked.append((float(amounts @ force[[one, other]]), tuple(pair)))
    return [pair for _, pair in sorted(ranked, key=lambda each: -each[0])]


def _unexplained(problem: Problem, found: Fit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights, an orthonormal basis of a fit's weighted Jacobian, and the weighted residual orthogonal to it."""
    weight = problem.weight(found.residual)
    basis = found.jacobian * weight[:, None]
    if basis.shape[1]:
        basis = np.linalg.qr(basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300))[0]
    left = found.residual * weight
    return weight, basis, left - basis @ (basis.T @ left)


def _start_values(
    problem: Problem, claim: EffectHypothesis, direction: FloatArray, weight: FloatArray, left: FloatArray
) -> Candidate:
    """Start values: first-order estimates of amplitudes, 2 % of the range or more off bounds; shapes as probed."""
    effect, power = claim.effect, float(direction @ direction)
    if power <= 1e-12:
        return Candidate(claim, 0.0)
    amount, main = -float(direction @ left) / power, effect.parameters[0]
    if len(main.start_values) > 1:
        amount = min(amount, 3.0)
    if amount <= 0.0 and main.neutral in (main.low, main.high):
        return Candidate(claim, 0.0)
    reached = problem.deviance((left + amount * direction) / weight)
    return Candidate(_scaled(claim, amount), problem.deviance(left / weight) - reached)


def _scaled(claim: EffectHypothesis, amount: float) -> EffectHypothesis:
    """Claim with `amount` times its amplitudes, 2 % of the range or more off bounds."""
    moved = dict(claim.values)
    for one in claim.effect.amplitudes:
        scaled = one.neutral + amount * (moved[one.name] - one.neutral)
        low, high = (end + 0.02 * (one.neutral - end) for end in (one.low, one.high))
        moved[one.name] = float(np.clip(scaled, low, high))
    return EffectHypothesis(claim.effect, moved)
