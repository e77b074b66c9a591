# SPDX-License-Identifier: Apache-2.0
"""Interval arithmetic of numbers and affine sets of matrices, which enclose rounding errors.

::

    Interval    [low, high]                         every operation rounds outward by `math.nextafter`
    Affine      C + sum_i s_i G_i + E               |s_i| <= 1, |E| <= R entry by entry

An affine set keeps its first-order dependence on each symbol s_i: a convex condition is checked at the symbols'
vertices. Second-order terms and rounding go into R. Source: de Figueiredo and Stolfi 2004; Rump 2010, section 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, nextafter, sqrt

import numpy as np

from hydro_core.signals import FloatArray

EPS = 2.0**-52


@dataclass(frozen=True)
class Interval:
    """Closed interval with outward-rounded arithmetic; operands may be plain numbers."""

    low: float
    high: float

    @property
    def midpoint(self) -> float:
        """Midpoint, rounded to nearest."""
        return 0.5 * (self.low + self.high)

    @property
    def radius(self) -> float:
        """Distance from `midpoint` that covers both ends."""
        return nextafter(max(self.high - self.midpoint, self.midpoint - self.low), inf)

    @property
    def magnitude(self) -> float:
        """Largest magnitude in the interval."""
        return max(abs(self.low), abs(self.high))

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __add__(self, other: Interval | float) -> Interval:
        other = interval(other)
        return Interval(nextafter(self.low + other.low, -inf), nextafter(self.high + other.high, inf))

    __radd__ = __add__

    def __sub__(self, other: Interval | float) -> Interval:
        return self + (-interval(other))

    def __rsub__(self, other: float) -> Interval:
        return interval(other) + (-self)

    def __mul__(self, other: Interval | float) -> Interval:
        other = interval(other)
        ends = [a * b for a, b in product((self.low, self.high), (other.low, other.high))]
        return Interval(nextafter(min(ends), -inf), nextafter(max(ends), inf))

    __rmul__ = __mul__

    def __truediv__(self, other: Interval | float) -> Interval:
        other = interval(other)
        if other.low <= 0.0 <= other.high:
            raise ValueError("division by an interval with zero in it")
        return self * Interval(nextafter(1.0 / other.high, -inf), nextafter(1.0 / other.low, inf))

    def __rtruediv__(self, other: float) -> Interval:
        return interval(other) / self

    def sqrt(self) -> Interval:
        """Return the square root; raises ValueError if a part is negative."""
        if self.low < 0.0:
            raise ValueError("a pressure of the box is beyond the supply or the tank")
        return Interval(max(nextafter(sqrt(self.low), -inf), 0.0), nextafter(sqrt(self.high), inf))


def interval(value: Interval | float | Sequence[float]) -> Interval:
    """Return the interval of a number, or of a pair of ends."""
    if isinstance(value, Interval):
        return value
    if isinstance(value, (int, float)):
        return Interval(float(value), float(value))
    return Interval(float(value[0]), float(value[1]))


def symmetric(size: float) -> Interval:
    """Return the interval [-size, size]."""
    return Interval(-size, size)


@dataclass(frozen=True)
class AffineSet:
    """Set of matrices C + sum_i s_i G_i + E, |s_i| <= 1, |E| <= R."""

    center: FloatArray
    """C, shape (n, m)."""
    slopes: FloatArray
    """G, shape (symbols, n, m)."""
    radius: FloatArray
    """R, shape (n, m), 0 or more."""

    @property
    def magnitude(self) -> FloatArray:
        """Largest magnitude of each entry."""
        return (np.abs(self.center) + np.abs(self.slopes).sum(axis=0)) * (1.0 + 1e-13) + self.radius

    def __add__(self, other: AffineSet) -> AffineSet:
        center, slopes = self.center + other.center, self.slopes + other.slopes
        rounding = EPS * (len(slopes) + 2) * (self.magnitude + other.magnitude)
        return AffineSet(center, slopes, (self.radius + other.radius + rounding) * (1.0 + 1e-12))

    def __matmul__(self, other: AffineSet) -> AffineSet:
        spread, others = np.abs(self.slopes).sum(axis=0), np.abs(other.slopes).sum(axis=0)
        radius = (
            self.magnitude @ other.radius
            + self.radius @ (np.abs(other.center) + others)
            + spread @ others
            + EPS * (self.center.shape[1] + len(self.slopes) + 4) * self.magnitude @ other.magnitude
        ) * (1.0 + 1e-12)
        return AffineSet(self.center @ other.center, self.slopes @ other.center + self.center @ other.slopes, radius)

    def __mul__(self, factor: float) -> AffineSet:
        size = abs(factor)
        return AffineSet(
            self.center * factor, self.slopes * factor, (self.radius * size + EPS * 2.0 * self.magnitude * size)
        )

    def submatrix(self, rows: slice | Sequence[int], columns: slice | Sequence[int]) -> AffineSet:
        """Return the set of submatrices with these rows and columns."""
        return AffineSet(
            self.center[rows][:, columns], self.slopes[:, rows][:, :, columns], self.radius[rows][:, columns]
        )
