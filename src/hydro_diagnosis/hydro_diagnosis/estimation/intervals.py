# SPDX-License-Identifier: Apache-2.0
"""Confidence intervals of parameters: 95 % by profile likelihood, widened by systematic errors.

A parameter is moved, all others are fitted again, and the deviance must rise by 3.84. Residuals are not quite
independent and not quite Gaussian, so the rise is scaled by the ratio of the scores' covariance over blocks of time to
the curvature (the sandwich), and by more where blocks are autocorrelated (slow noise, drift); where a remainder is left
unexplained that ratio grows by itself. The systematic part covers the residuals' own discretisation, a fraction of the
smallest size worth claiming, noise in a parameter's regressor, and missing rows. Where a claim's law may have another
form, the interval spans those of all forms that fit as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from hydro_diagnosis.effects.base import EffectHypothesis, FloatArray
from hydro_diagnosis.estimation.fit import Fit, by_claim, fit, pack, unpack
from hydro_diagnosis.report_json import ParameterEstimate
from hydro_diagnosis.significance import (
    CONFIDENCE,
    COVERAGE_FACTOR,
    FOLD_TIME,
    FOLDS,
    ITERATIONS,
    PRACTICAL_SHARE,
    QUANTILE,
    VERY_STRONG_EVIDENCE,
)

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem


def shifts(problem: Problem, found: Fit) -> list[FloatArray]:
    """Absolute first-order shift of each claim's parameters if half of the rows are left out; 0 if no row is missing.

    Returns
    -------
    One array per claim, in the parameters' units.
    """
    counts = [len(claim.effect.parameters) for claim in found.claims]
    if problem.half_rows is None or not counts:
        return [np.zeros(count) for count in counts]
    weight = problem.weight(found.residual)
    slopes, change = found.jacobian * weight[:, None], problem.half_rows_change(found.claims) * weight
    lengths = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    spans = np.array([parameter.span for parameter in pack(found.claims)[0]])
    moved = np.abs(np.linalg.lstsq(slopes / lengths, change, rcond=1e-10)[0]) / lengths * spans
    return np.split(moved, np.cumsum(counts)[:-1])


def is_significant(claim: EffectHypothesis) -> bool:
    """Return whether any of a claim's amplitudes exceeds its smallest size, and none is at a bound but neutral.

    An effect without amplitudes (bristles, by their stiffness) must differ from neutral by `PRACTICAL_SHARE`.
    """
    amplitudes = claim.effect.amplitudes
    for one in amplitudes:
        value, near = claim.values[one.name], 1e-3 * one.smallest_reported
        if any(abs(value - end) <= near < abs(end - one.neutral) for end in (one.low, one.high)):
            return False
    if not amplitudes:
        return any(
            abs(claim.values[one.name] - one.neutral) > PRACTICAL_SHARE * abs(one.neutral)
            for one in claim.effect.parameters
        )
    return any(abs(claim.values[one.name] - one.neutral) >= one.smallest_reported for one in amplitudes)


def all_significant(problem: Problem, found: Fit) -> bool:
    """Return whether every claim is significant, and exceeds its errors by a noisy regressor and by missing rows."""
    for claim in found.cause_claims:
        least, values = COVERAGE_FACTOR * problem.attenuation.get(claim.effect.id, 0.0), claim.values
        beyond = not least or any(abs(values[one.name] - one.neutral) >= least for one in claim.effect.parameters)
        if not is_significant(claim) or not beyond:
            return False
    for claim, shift in zip(found.claims, shifts(problem, found), strict=True):
        pairs = list(zip(claim.effect.parameters, shift, strict=True))
        telling = [(one, moved) for one, moved in pairs if one.smallest_reported > 0.0] or pairs[:1]
        beyond = any(abs(claim.values[one.name] - one.neutral) >= COVERAGE_FACTOR * moved for one, moved in telling)
        if not claim.effect.estimated and not beyond:
            return False
    return True


MIN_DEGREES_OF_FREEDOM = 3.0
"""Smallest number of degrees of freedom."""


@dataclass(frozen=True)
class Interval:
    """A parameter's value and its 95 % interval; `identifiable` is False at a bound or on a flat profile."""

    value: float
    low: float
    high: float
    identifiable: bool
    inflation: float = 1.0
    """Ratio of the parameter's robust standard deviation (sandwich) to that under independent residuals."""

    def estimate(self, unit: str) -> ParameterEstimate:
        """Return the entry of report.json: value, unit, and the interval if the parameter is identifiable."""
        ci95 = [self.low, self.high] if self.identifiable else None
        return ParameterEstimate(value=self.value, ci95=ci95, unit=unit)


def without_insignificant(problem: Problem, found: Fit) -> tuple[Fit, list[Interval]]:
    """Return the fit without claims whose intervals include the neutral values, and the intervals of its parameters.

    A ratio whose interval reaches the end of its range goes too: where nothing else tells the size of what it scales, a
    smaller ratio is a smaller residual.
    """
    while True:
        bounds = intervals(problem, found)
        standing = [
            claim for claim, own in by_claim(found.claims, bounds)
            if claim.effect.estimated or stands(claim, own)
        ]  # fmt: skip
        ids = {claim.effect.id for claim in standing}
        standing = [claim for claim in standing if set(claim.effect.needs) <= ids]
        if len(standing) == len(found.claims):
            return found, bounds
        found = fit(problem, standing)


def stands(claim: EffectHypothesis, bounds: Sequence[Interval]) -> bool:
    """Return whether a claim's intervals exclude its absence, and no ratio's reaches the end of its range."""
    return not (_includes_neutral(claim, bounds) or _at_limit(claim, bounds))


def _includes_neutral(claim: EffectHypothesis, bounds: Sequence[Interval]) -> bool:
    """Return whether the effect may be absent: so for each amplitude, or the first shape where there is none."""
    pairs = list(zip(claim.effect.parameters, bounds, strict=True))
    telling = [(one, bound) for one, bound in pairs if one.smallest_reported > 0.0] or pairs[:1]
    return all(bound.low <= one.neutral <= bound.high for one, bound in telling)


def _at_limit(claim: EffectHypothesis, bounds: Sequence[Interval]) -> bool:
    """Return whether the interval of a ratio, of which 1 is neutral, reaches the end of its range."""
    pairs = zip(claim.effect.parameters, bounds, strict=True)
    ratios = [(one, bound) for one, bound in pairs if one.unit == "-" and one.neutral == 1.0 and one.span > 0.0]
    return any(bound.low <= 1.001 * one.low or bound.high >= 0.999 * one.high for one, bound in ratios)


def intervals(problem: Problem, found: Fit) -> list[Interval]:
    """Return the 95 % interval of each parameter of the claims, in the order of `pack`."""
    owners = [claim for claim in found.claims for _ in claim.effect.parameters]
    bounds = _intervals(problem, found, range(len(owners)))
    for claim in found.claims:
        kin = [k for k, one in enumerate(owners) if one.effect.family == claim.effect.family]
        for form in claim.effect.other_forms:
            others = [replace(one, effect=form) if one is claim else one for one in found.claims]
            other = fit(problem, others)
            if other.deviance < found.deviance + VERY_STRONG_EVIDENCE:
                for k, bound in zip(kin, _intervals(problem, other, kin), strict=True):
                    low, high = min(bounds[k].low, bound.low), max(bounds[k].high, bound.high)
                    bounds[k] = replace(bounds[k], low=low, high=high)
    return bounds


def _intervals(problem: Problem, found: Fit, which: Sequence[int]) -> list[Interval]:
    """Intervals of `which` of the parameters, the form of every claim as it is."""
    parameters, values = pack(found.claims)
    if not len(values):
        return []
    owners = [claim.effect.id for claim in found.claims for _ in claim.effect.parameters]
    curvature, inflation = _uncertainty(problem, found)
    missing, bounds = np.concatenate(shifts(problem, found)), []
    for k in which:
        one, value, widened = parameters[k], float(values[k]), inflation[k]
        reach = QUANTILE * (curvature[k] * one.span) * widened
        sides = [_profiled(problem, found, k, value, sign * reach, widened) for sign in (-1.0, 1.0)]
        attenuation = hypot(problem.attenuation.get(owners[k], 0.0), missing[k])
        # of an amplitude a share of the smallest size worth claiming
        systematic = one.systematic * abs(value) if one.smallest_reported == 0.0 else 0.03 * one.smallest_reported
        low, high = (value + sign * hypot(side, systematic, attenuation)
                     for sign, side in zip((-1, 1), sides, strict=True))  # fmt: skip
        at_bound = min(value - one.low, one.high - value) <= 1e-3 * (one.high - one.low) * 1e-3
        flat = not np.isfinite(reach) or reach > 0.5 * (one.high - one.low)
        bounds.append(Interval(value, max(low, one.low), min(high, one.high), not (at_bound or flat), widened))
    return bounds


def _uncertainty(problem: Problem, found: Fit) -> tuple[FloatArray, FloatArray]:
    """Standard deviations by curvature, in spans, and the factors by which the sandwich's are larger."""
    layout = problem.layout
    weight = 1.0 / problem.variances(found.residual)[layout.channel]
    normal = found.jacobian.T @ (found.jacobian * weight[:, None])
    covariance = np.linalg.pinv(normal, hermitian=True)
    scores = found.jacobian * (found.residual * weight)[:, None]
    seconds = FOLD_TIME / FOLDS  # long beside the memory of any residual
    block = np.floor(layout.time / seconds).astype(np.int64) + 10**6 * layout.segment
    blocks, index = np.unique(block, return_inverse=True)
    summed = np.stack([np.bincount(index, scores[:, k]) for k in range(scores.shape[1])], axis=1)
    moves = np.asarray(summed @ covariance, dtype=np.float64)
    recurrence = _recurrence(moves, blocks)
    sandwich = np.sum(np.square(moves), axis=0) * recurrence
    plain = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    independent = np.maximum(len(blocks) / recurrence - len(plain), MIN_DEGREES_OF_FREEDOM)
    inflation = np.sqrt(sandwich) / np.maximum(plain, 1e-300) * stdtrit(independent, CONFIDENCE) / QUANTILE
    return plain, np.maximum(inflation, 1.0)


def _recurrence(moves: FloatArray, blocks: npt.NDArray[np.int64]) -> FloatArray:
    """Factor of the variance of sums over blocks by their autocorrelation, shape (k,).

    The larger of that of a first-order process (Andrews and Monahan 1992), which lasts, and of the sum of pairs of
    autocorrelations up to the first that chance would make (Geyer 1992), which may end at once: a stroke's own error.

    `moves`: shift of each parameter by each block, shape (blocks, k). `blocks`: index of each block in time; those of
    consecutive blocks differ by 1.
    """
    chance = QUANTILE / sqrt(max(len(blocks), 1))
    power = np.maximum(np.mean(np.square(moves), axis=0), 1e-300)

    def autocorrelation(lag: int) -> FloatArray:
        apart = blocks[lag:] - blocks[:-lag] == lag
        pairs = moves[lag:][apart] * moves[:-lag][apart]
        return np.asarray(np.sum(pairs, axis=0) / max(len(pairs), 1) / power)

    first = autocorrelation(1) if len(blocks) > 1 else np.zeros(moves.shape[1])
    most = (len(blocks) - MIN_DEGREES_OF_FREEDOM) / (
        len(blocks) + MIN_DEGREES_OF_FREEDOM
    )  # leaves `MIN_DEGREES_OF_FREEDOM` independent blocks
    first = np.clip(np.where(first > chance, first, 0.0), 0.0, max(most, 0.0))
    total, lasts = 1.0 + 2.0 * first, np.ones(moves.shape[1], bool)
    for lag in range(2, len(blocks) // 4, 2):
        pair = autocorrelation(lag) + autocorrelation(lag + 1)
        lasts &= pair > sqrt(2.0) * chance
        if not lasts.any():
            break
        total += 2.0 * np.where(lasts, pair, 0.0)
    return np.asarray(np.maximum((1.0 + first) / (1.0 - first), total))


def _profiled(problem: Problem, found: Fit, index: int, value: float, step: float, inflation: float) -> float:
    """Distance at which the profile has risen by QUANTILE^2 inflation^2, from one point on it near there.

    Where two shapes are nearly the same, the curvature at the fit says nothing of the distance: then the step is
    reduced. The profile ends at the parameter's bounds.
    """
    effects = [claim.effect for claim in found.claims]
    number = [parameter for effect in effects for parameter in effect.parameters][index]
    _, values = pack(found.claims)
    if not np.isfinite(step) or step == 0.0:
        return abs(step)
    wanted = (QUANTILE * inflation) ** 2
    for _ in range(ITERATIONS):
        step = float(np.clip(value + step, number.low, number.high)) - value
        if step == 0.0:
            break
        values[index] = value + step
        moved = fit(problem, unpack(effects, values), fixed=index, slopes=found.jacobian)
        rise = moved.deviance - found.deviance
        ratio = sqrt(wanted / rise) if rise > 0.0 else 2.0
        step *= float(np.clip(ratio, 0.5, 2.0))
        if ratio >= 0.5:
            break
    return abs(step)
