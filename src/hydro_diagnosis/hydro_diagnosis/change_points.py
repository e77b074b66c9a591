# SPDX-License-Identifier: Apache-2.0
"""Change points and trend of one parameter over many recordings, from its estimates and their standard deviations.

The model is piecewise linear, fitted by weighted least squares. Candidate partitions are optimal ones (PELT: Killick,
Fearnhead and Eckley 2012, library `ruptures`), for several correlation times of the scatter; the likelihood selects
among them, and with them the long-run variance of means. A change needs `VERY_STRONG_EVIDENCE` evidence by the BIC.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import inf, log, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike
from ruptures import Pelt
from ruptures.base import BaseCost
from ruptures.exceptions import BadSegmentationParameters
from scipy.ndimage import median_filter
from scipy.optimize import brentq
from scipy.stats import chi2

from hydro_core.signals import FloatArray
from hydro_diagnosis.significance import CONFIDENCE, OUTLIER_FACTOR, QUANTILE, VERY_STRONG_EVIDENCE

MIN_RECORDINGS = 14
"""Smallest number of recordings to be judged: the scatter between fewer is unknown."""
_PARAMETERS_PER_CHANGE = 3
"""Parameters that a change adds: its time, a level and a slope."""
MIN_SPACING = _PARAMETERS_PER_CHANGE + 1
"""Smallest number of recordings between two changes."""
_VARIANCE_RATIOS = (0.0, 0.25, 0.5, 0.71, 1.0, 1.41, 2.0, 4.0)
"""Trial variances of the correlated scatter, relative to the variance by `scatter_between`."""


@dataclass(frozen=True)
class Line:
    """Line fitted to values over time [days] by weighted least squares."""

    begin: float
    middle: float
    end: float
    level: float
    """Value at `middle`."""
    slope: float
    """Per day."""
    level_sd: float
    slope_sd: float

    def at(self, time: ArrayLike) -> Any:
        """Value of the line at times [days]."""
        return self.level + self.slope * (np.asarray(time) - self.middle)

    def sd(self, time: ArrayLike) -> Any:
        """Standard deviation of the line's value at times [days]."""
        return np.hypot(self.level_sd, self.slope_sd * (np.asarray(time) - self.middle))

    def time_to_limit(self, limit: float, upwards: bool) -> tuple[float, float, float]:
        """Days after `end` at which the line passes a limit, with 95 % interval; inf if not within ten years."""
        ahead = np.arange(0.0, 3651.0)
        value, spread, sign = self.at(self.end + ahead), QUANTILE * self.sd(self.end + ahead), 1.0 if upwards else -1.0
        past = [sign * (value + shift - limit) >= 0.0 for shift in (0.0, sign * spread, -sign * spread)]
        days = [float(ahead[np.argmax(one)]) if one.any() else inf for one in past]
        return days[0], days[1], days[2]


@dataclass(frozen=True)
class Change:
    """Change point between two recordings; all times in days."""

    time: float
    """Time of the first recording after the change."""
    earliest: float
    latest: float
    """End of the 95 % interval of `time`, from `earliest`, by the profile likelihood."""
    evidence: float
    """Increase of the BIC without the change."""


@dataclass(frozen=True)
class PiecewiseTrend:
    """Piecewise linear course of a parameter: change points and the lines between them."""

    changes: list[Change]
    lines: list[Line]
    has_slope: bool
    """Whether the slope since the last change is significant."""

    @property
    def finding_count(self) -> int:
        """Number of changes; without any, 1 if the slope is significant, else 0."""
        return len(self.changes) or int(self.has_slope)


class _Lines(BaseCost):  # user-defined cost function of `ruptures`
    """Weighted sum of squares about a line, from sums over the rows (time, value, weight) of the signal."""

    model = "weighted lines"
    min_size = MIN_SPACING

    def fit(self, signal: FloatArray) -> _Lines:
        self.signal = signal
        time, value, weight = signal.T
        rows = np.stack([weight * one for one in (np.ones_like(time), time, value, time**2, time * value, value**2)])
        self._sums = [tuple(row) for row in np.concatenate([np.zeros((1, 6)), np.cumsum(rows.T, axis=0)]).tolist()]
        return self

    def error(self, start: int, end: int) -> float:
        """Weighted sum of squares of rows start to end."""
        w, t, y, tt, ty, yy = (b - a for a, b in zip(self._sums[start], self._sums[end], strict=True))
        across, along = tt - t * t / w, ty - t * y / w
        return max(yy - y * y / w - (along * along / across if across > 0.0 else 0.0), 0.0)

    def bends(self, places: npt.NDArray[np.int64]) -> FloatArray:
        """Weighted sum of squares of all rows about two lines that meet at a row, for each of these rows."""
        sums, time = np.array(self._sums), self.signal[places, 0]
        w, t, y, tt, ty, yy = sums[-1]
        w2, t2, y2, tt2, ty2, _ = (sums[-1] - sums[places]).T
        late, along, squares = t2 - time * w2, tt2 - time * t2, tt2 - 2.0 * time * t2 + time**2 * w2
        ones = np.ones_like(time)
        rows = ((w * ones, t * ones, late), (t * ones, tt * ones, along), (late, along, squares))
        right = np.stack((y * ones, ty * ones, ty2 - time * y2), axis=1)
        solved = np.linalg.solve(np.moveaxis(np.array(rows), 2, 0), right[:, :, None])[:, :, 0]
        return np.asarray(yy - np.sum(right * solved, axis=1))


def fit_trend(time: FloatArray, value: FloatArray, sd: FloatArray, bound: ArrayLike = 0.0) -> PiecewiseTrend | None:
    """Fit the trend of a parameter: change points and lines; None for fewer recordings than `MIN_RECORDINGS`.

    `time`: days, ascending; `value` and its standard deviation `sd` by the diagnosis, shape (n,). `bound`: half-width
    of the interval of a value that was not named, else 0; used for the dates of changes only.
    """
    if len(time) < MIN_RECORDINGS:
        return None
    between = scatter_between(value, sd)
    own = np.hypot(sd, between)
    away = np.abs(value - median_filter(value, 7))
    noise = _Noise(time, value, own * np.maximum(1.0, away / (OUTLIER_FACTOR * own)), sd, between)
    edges, evidence, long = noise.partition()
    signal = np.column_stack([time, value, 1.0 / (long**2 + 0.5 * np.square(bound))])
    changes = [_change(signal[a:c], each) for a, c, each in zip(edges, edges[2:], evidence, strict=False)]
    lines = [line(time[a:b], value[a:b], long[a:b]) for a, b in pairwise(edges)]
    sure = (lines[-1].slope / lines[-1].slope_sd) ** 2 - log(edges[-1] - edges[-2])
    return PiecewiseTrend(changes, lines, bool(sure > VERY_STRONG_EVIDENCE))


class _Noise:
    """Noise model: Ornstein-Uhlenbeck scatter between recordings, plus white noise of each recording."""

    def __init__(self, time: FloatArray, value: FloatArray, own: FloatArray, sd: FloatArray, between: float) -> None:
        self._time, self._value, self._weight = time - time.mean(), value - np.median(value), own**-2.0
        self._white = np.maximum(own**2 - between**2, sd**2)
        gap, base = np.diff(time), max(between**2, 0.1 * float(np.median(self._white)))
        spacing = float(np.median(gap)) or 1.0
        lasting = (0.0, 1.0, 2.0, 4.0, 8.0)  # correlation times, in median spacings of the recordings; 0: white
        grid = [(one, size) for one in lasting for size in _VARIANCE_RATIOS]
        keep = np.exp(-1.0 / np.maximum([one for one, _ in grid], 1e-3))
        self._variance = base * np.array([size for _, size in grid]) / (1.0 - keep)
        self._keep = keep ** (gap[:, None] / spacing)
        self._lasts = (1.0 + keep) / (1.0 - keep)

    def long_run_sd(self, k: int) -> FloatArray:
        """Long-run standard deviation of each value, shape (n,), as it counts in means; `k`: index into the grid."""
        return np.sqrt(self._white + self._variance[k] * self._lasts[k])

    def partition(self) -> tuple[list[int], list[float], FloatArray]:
        """Edges of the partition, evidence of each change, and each value's long-run standard deviation."""
        count = len(self._time)
        found, price = [[0, count]], _PARAMETERS_PER_CHANGE * log(count)
        for k in range(_VARIANCE_RATIOS.index(1.0), len(self._lasts), len(_VARIANCE_RATIOS)):
            edges = self._searched(self.long_run_sd(k), price)
            if edges not in found:
                found.append(edges)
            elif k < len(_VARIANCE_RATIOS):
                break

        def sure(edges: list[int]) -> float:
            """Small-sample factor of a likelihood ratio for the number of estimated parameters (Sims 1980)."""
            return max(0.0, 1.0 - (_PARAMETERS_PER_CHANGE * (len(edges) - 1) + 1) / count)

        deviance, best = self.deviance(found)
        gain = [
            sure(one) * (deviance[0] - each) - (VERY_STRONG_EVIDENCE + price) * (len(one) - 2)
            for one, each in zip(found, deviance, strict=True)
        ]
        at = int(np.argmax(gain))
        edges, least, kind = found[at], deviance[at], int(best[at])
        evidence: list[float] = []
        while len(edges) > 2:
            fewer = [edges[:k] + edges[k + 1 :] for k in range(1, len(edges) - 1)]
            deviance, best = self.deviance(fewer)
            evidence = [sure(edges) * float(one - least) - price for one in deviance]
            worst = int(np.argmin(evidence))
            if evidence[worst] >= VERY_STRONG_EVIDENCE:
                break
            edges, least, kind, evidence = fewer[worst], deviance[worst], int(best[worst]), []
        return edges, evidence, self.long_run_sd(kind)

    def _searched(self, long: FloatArray, price: float) -> list[int]:
        middle, count = np.median(long), len(long)
        cost = _Lines().fit(np.column_stack([self._time, self._value / middle, (middle / long) ** 2]))
        step = min(1 + count // 50, 3)  # on a coarse grid first: nine times as fast at every third place
        try:
            found = (
                Pelt(custom_cost=cost, min_size=MIN_SPACING, jump=step)
                .fit(cost.signal)
                .predict(pen=VERY_STRONG_EVIDENCE + price)
            )
        except BadSegmentationParameters:  # too few for two parts
            found = [count]
        edges = [0, *found]
        for k in range(1, len(found)):
            low, at, high = edges[k - 1 : k + 2]
            near = range(max(low + MIN_SPACING, at - step), min(high - MIN_SPACING, at + step) + 1)
            edges[k] = min(near, key=lambda one: cost.error(low, one) + cost.error(one, high), default=at)
        return edges

    def deviance(self, partitions: list[list[int]]) -> tuple[FloatArray, FloatArray]:
        """Least -2 log likelihood of each partition's lines over the grid, and its grid index, by a Kalman filter."""
        left = np.empty((len(partitions), len(self._time), 1))
        for k, edges in enumerate(partitions):
            for a, b in pairwise(edges):
                time, value, weight = self._time[a:b], self._value[a:b], self._weight[a:b]
                left[k, a:b, 0] = value - line(time, value, weight**-0.5).at(time)
        ahead, sure, total = np.zeros((len(left), len(self._variance))), self._variance, np.zeros(1)
        for k in range(left.shape[1]):
            off, spread = left[:, k] - ahead, sure + self._white[k]
            total = total + off**2 / spread + np.log(spread)
            if k < len(self._keep):
                keep, share = self._keep[k], sure / spread
                ahead = keep * (ahead + share * off)
                sure = keep**2 * sure * (1.0 - share) + self._variance * (1.0 - keep**2)
        return total.min(axis=1), total.argmin(axis=1)


def _change(signal: FloatArray, evidence: float) -> Change:
    """Change point, dated as a jump or as the kink between two lines, whichever has the lower BIC.

    `signal`: time, value, weight of the values between the changes before and after it.
    """
    time, count = signal[:, 0], len(signal)
    places = np.arange(MIN_SPACING, count - MIN_SPACING + 1)
    cost = _Lines().fit(signal - [time.mean(), np.median(signal[:, 1]), 0.0])
    jump = np.array([cost.error(0, one) + cost.error(one, count) for one in places.tolist()])
    bend = cost.bends(places)
    errors, numbers = (bend, 4) if bend.min() + log(count) < jump.min() else (jump, 5)
    errors = errors / max(1.0, float(errors.min()) / max(count - numbers, 1))
    dated = -2.0 * log(1.0 - sqrt(2.0 * CONFIDENCE - 1.0))  # 95 % of its likelihood ratio (Bai 1997; Eo, Morley 2015)
    near = places[errors <= errors.min() + dated]
    at = places[int(np.argmin(errors))]
    return Change(float(time[at]), float(time[near[0]]), float(time[near[-1]]), evidence)


def scatter_between(value: FloatArray, sd: FloatArray) -> float:
    """Standard deviation of the scatter beyond `sd`, by the median squared difference of neighbouring values."""
    steps, own = np.diff(value) ** 2, sd[1:] ** 2 + sd[:-1] ** 2
    scale, median = float(steps.max()), float(chi2.ppf(0.5, 1))

    def excess(share: float) -> float:
        return float(np.median(steps / (own + 2.0 * share * scale))) - median

    return sqrt(scale * brentq(excess, 0.0, 10.0)) if scale > 0.0 and excess(0.0) > 0.0 else 0.0


def line(time: FloatArray, value: FloatArray, sd: FloatArray) -> Line:
    """Fit a line by weighted least squares; its standard deviations are inflated if the scatter exceeds `sd`."""
    weight = 1.0 / sd**2
    middle = float(np.average(time, weights=weight))
    off = time - middle
    across = float(np.sum(weight * off**2))
    level, slope = float(np.average(value, weights=weight)), float(np.sum(weight * off * value)) / across
    spread = sqrt(max(1.0, float(np.sum(weight * (value - level - slope * off) ** 2)) / max(len(time) - 2, 1)))
    return Line(
        float(time[0]), middle, float(time[-1]), level, slope, spread / sqrt(weight.sum()), spread / sqrt(across)
    )
