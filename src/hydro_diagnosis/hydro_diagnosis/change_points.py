# SPDX-License-Identifier: Apache-2.0
"""One number over many recordings: when it changed, and how it runs since, with the interval of each value.

Between changes it runs along a line, by weighted least squares. Where it changes is found by the optimal partition of
Killick, Fearnhead and Eckley (2012), of the library `ruptures`; a change needs `NEEDED` of evidence by the BIC.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import inf, log, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ruptures import Pelt
from ruptures.base import BaseCost
from ruptures.exceptions import BadSegmentationParameters
from scipy.ndimage import median_filter
from scipy.optimize import brentq
from scipy.stats import chi2

from hydro_bridge.signals import FloatArray

NEEDED = 10.0
"""Evidence [BIC] of a change: very strong by Kass and Raftery (1995), table in section 3.2."""
FEWEST = 14
"""Recordings below which nothing is judged: the scatter between them is not known."""
SHORTEST = 4
"""Recordings between two changes."""
COARSEST = 3
"""Recordings from one place to the next at which a long history is first searched: nine times as fast."""
_PER_CHANGE = 3
"""Numbers that a change adds: its time, a level and a slope."""
_OUTLYING = 3.0
"""Standard deviations from the running median of 7 beyond which a value counts for less (Huber 1964)."""
_NORMAL = 1.96
_MEDIAN = float(chi2.ppf(0.5, 1))
_BLOCK = 7
"""Recordings over whose means a scatter that lasts (oil, weather) is measured."""
HORIZON = 3650.0
"""Days ahead beyond which no date is told."""


@dataclass(frozen=True)
class Line:
    """A weighted line through values over time [days]."""

    begin: float
    middle: float
    end: float
    level: float
    """At `middle`."""
    slope: float
    """Per day."""
    level_sd: float
    slope_sd: float

    def at(self, time: ArrayLike) -> Any:
        """Value at times [days]."""
        return self.level + self.slope * (np.asarray(time) - self.middle)

    def sd(self, time: ArrayLike) -> Any:
        """Its standard deviation there."""
        return np.hypot(self.level_sd, self.slope_sd * (np.asarray(time) - self.middle))

    def runs(self, count: int) -> bool:
        """Whether there is evidence for its slope, by so many values."""
        return bool((self.slope / self.slope_sd) ** 2 - log(count) > NEEDED)

    def reaches(self, limit: float, upwards: bool) -> tuple[float, float, float]:
        """Days after `end` at which it passes a limit, and their 95 % interval; inf where it does not in ten years."""
        ahead = np.arange(0.0, HORIZON + 1.0)
        value, spread, sign = self.at(self.end + ahead), _NORMAL * self.sd(self.end + ahead), 1.0 if upwards else -1.0
        past = [sign * (value + shift - limit) >= 0.0 for shift in (0.0, sign * spread, -sign * spread)]
        days = [float(ahead[np.argmax(one)]) if one.any() else inf for one in past]
        return days[0], days[1], days[2]


@dataclass(frozen=True)
class Change:
    """A change between two recordings; all times in days."""

    time: float
    """Of the first recording after it."""
    earliest: float
    latest: float
    """95 % interval of that time, by the profile of the likelihood."""
    evidence: float
    """BIC that is lost without it."""


@dataclass(frozen=True)
class Course:
    """A number's course."""

    changes: list[Change]
    lines: list[Line]
    scatter: float
    """Standard deviation between recordings on top of their own intervals."""

    @property
    def findings(self) -> int:
        """Changes; 1 where there is none and the line runs up or down all the time."""
        return len(self.changes) or int(self.running)

    running: bool
    """Whether there is evidence for a slope since the last change."""


class _Lines(BaseCost):  # a cost function of the user's own, as the library documents it
    """Weighted sum of squares about a line, from sums over the rows (time, value, weight) of the signal."""

    model = "weighted lines"
    min_size = SHORTEST

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


def course(time: FloatArray, value: FloatArray, sd: FloatArray) -> Course | None:
    """Changes of a number and lines between them; None for fewer recordings than `FEWEST`.

    `time`: days, ascending; `value` and its standard deviation by the diagnosis, shape (n,).
    """
    count = len(time)
    if count < FEWEST:
        return None
    scatter = scatter_between(value, sd)
    own = np.hypot(sd, scatter)
    away = np.abs(value - median_filter(value, 7))
    own = own * np.maximum(1.0, away / (_OUTLYING * own))
    own = own * _slow(value, own)
    middle, scale = float(np.median(value)), float(np.median(own))
    signal = np.column_stack([time - time.mean(), (value - middle) / scale, (scale / own) ** 2])
    cost, price = _Lines().fit(signal), _PER_CHANGE * log(count)
    coarse = min(1 + count // 150, COARSEST)
    try:
        found = Pelt(custom_cost=cost, min_size=SHORTEST, jump=coarse).fit(signal).predict(pen=NEEDED + price)
    except BadSegmentationParameters:  # too few for two parts
        found = [count]
    edges, changes = [0, *found], []
    for k in range(1, len(found)):
        edges[k], change = _change(cost, time, edges[k - 1], edges[k + 1], price)
        changes.append(change)
    lines = [line(time[a:b], value[a:b], own[a:b]) for a, b in pairwise(edges)]
    return Course(changes, lines, scatter, lines[-1].runs(edges[-1] - edges[-2]))


def _change(cost: _Lines, time: FloatArray, begin: int, end: int, price: float) -> tuple[int, Change]:
    """The best place of a change between its neighbours, and the change."""
    places = range(begin + SHORTEST, end - SHORTEST + 1)
    errors = np.array([cost.error(begin, one) + cost.error(one, end) for one in places])
    near = np.flatnonzero(errors <= errors.min() + chi2.ppf(0.95, 1)) + places[0]
    at, evidence = places[int(np.argmin(errors))], cost.error(begin, end) - float(errors.min()) - price
    return at, Change(float(time[at]), float(time[near[0]]), float(time[near[-1]]), evidence)


def scatter_between(value: FloatArray, sd: FloatArray) -> float:
    """Standard deviation between neighbours beyond their own `sd`: the median of their squared differences."""
    steps, own = np.diff(value) ** 2, sd[1:] ** 2 + sd[:-1] ** 2
    scale = float(steps.max())

    def excess(share: float) -> float:
        return float(np.median(steps / (own + 2.0 * share * scale))) - _MEDIAN

    return sqrt(scale * brentq(excess, 0.0, 10.0)) if scale > 0.0 and excess(0.0) > 0.0 else 0.0


def _slow(value: FloatArray, sd: FloatArray) -> float:
    """Factor on `sd` by which means over `_BLOCK` recordings scatter more than independent values would."""
    if len(value) < 20 * _BLOCK:  # a step is in three blocks
        return 1.0
    ones, weight = np.ones(_BLOCK), 1.0 / sd**2
    total = np.convolve(weight, ones, "valid")
    mean = np.convolve(weight * (value - value[0]), ones, "valid") / total
    before, at, after = (slice(k * _BLOCK, len(total) - (2 - k) * _BLOCK) for k in range(3))
    bent = (mean[before] - 2.0 * mean[at] + mean[after]) ** 2
    expected = 1.0 / total[before] + 4.0 / total[at] + 1.0 / total[after]
    return max(1.0, sqrt(float(np.median(bent / expected)) / _MEDIAN))


def line(time: FloatArray, value: FloatArray, sd: FloatArray) -> Line:
    """Weighted least squares; its standard deviations grow where the values scatter more than `sd` says."""
    weight = 1.0 / sd**2
    middle = float(np.average(time, weights=weight))
    off = time - middle
    across = float(np.sum(weight * off**2))
    level, slope = float(np.average(value, weights=weight)), float(np.sum(weight * off * value)) / across
    spread = sqrt(max(1.0, float(np.sum(weight * (value - level - slope * off) ** 2)) / max(len(time) - 2, 1)))
    return Line(
        float(time[0]), middle, float(time[-1]), level, slope, spread / sqrt(weight.sum()), spread / sqrt(across)
    )
