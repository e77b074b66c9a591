# SPDX-License-Identifier: Apache-2.0
"""Named causes as parametric shapes of the missing-force curve, and their sizes.

Chosen is the simplest shape that misses no point, with at most half as many parameters as points. If there is none,
terms are added as long as the points' evidence (BIC, their discrepancy estimated) supports them. A point is missed by
more than two standard errors and more than `PRACTICAL_SHARE` of what the force varies by, weights left out. Where few
points allow for one parameter alone, and it misses one grossly, dry friction and a constant force are fitted: one
parameter per direction.

Sizes are by robust weighted least squares on the points; their intervals include the errors between strokes and a
discrepancy of the shape, estimated from its residuals and correlated between neighbouring speeds (Kennedy and O'Hagan
2001).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit

from hydro_core.signals import FloatArray
from hydro_diagnosis.curves import middle_force
from hydro_diagnosis.significance import CONFIDENCE, COVERAGE_FACTOR, ITERATIONS, PRACTICAL_SHARE

if TYPE_CHECKING:
    from hydro_diagnosis.curves import ForceCurve, Point

STRIBECK_VELOCITY_RATIOS = (0.05, 0.1, 0.2, 0.4, 0.6)
"""Candidate Stribeck velocities, over the top speed."""
SLOPE_SPEED_RATIO = 1.4
"""Ratio of speeds from which friction that follows the speed is told from dry friction: two knots of the curve."""
PROFILE_FACTORS = np.geomspace(0.25, 4.0, 33)
"""Factors of a parameter's estimate at which its profile is evaluated for an interval."""
MIN_OPPOSING_SHARE = 0.9
"""Least share of samples or strokes in which friction must oppose the motion; recordings of tanks have 76 %."""


@dataclass(frozen=True)
class Shape:
    """Sum of elementary forces: `dry`, `viscous` (one coefficient, or one per direction), `constant`, `stribeck`."""

    dry: bool = False
    viscous: int = 0
    constant: bool = False
    stribeck: float = 0.0
    """Stribeck velocity [m/s], over which the rise of friction fades; 0: no rise."""

    def columns(self, speed: FloatArray, direction: FloatArray | None = None) -> FloatArray:
        """Return the design matrix at velocities `speed` [m/s], (n, k); `direction`: -1 to 1, after its memory."""
        sign = np.sign(speed) if direction is None else direction
        found = [
            *([sign] if self.dry else []),
            *([speed] if self.viscous == 1 else []),
            *([np.maximum(speed, 0.0), np.minimum(speed, 0.0)] if self.viscous == 2 else []),
            *([np.ones_like(speed)] if self.constant else []),
            *([sign * np.exp(-np.square(speed / self.stribeck))] if self.stribeck else []),
        ]
        return np.column_stack(found) if found else np.zeros((len(speed), 0))

    @property
    def names(self) -> list[str]:
        """Name of each column: dry, viscous, constant or stribeck."""
        return [
            *(["dry"] if self.dry else []), *["", "viscous", "viscous viscous"][self.viscous].split(),
            *(["constant"] if self.constant else []), *(["stribeck"] if self.stribeck else []),
        ]  # fmt: skip

    @property
    def parameter_count(self) -> int:
        """Number of its parameters, including the speed over which a rise fades."""
        return len(self.names) + bool(self.stribeck)

    def without(self, name: str) -> Shape:
        """Return the shape without a term (`dry`: nor `stribeck`); of two viscous coefficients, with one."""
        if name == "viscous":
            return replace(self, viscous=self.viscous - 1)
        if name == "constant":
            return replace(self, constant=False)
        return replace(self, dry=self.dry and name != "dry", stribeck=0.0)

    def richer(self, top: float) -> Iterator[Shape]:
        """Yield the shapes with one term more, the most usual first."""
        if not self.dry:
            yield replace(self, dry=True)
        if self.viscous < 2:
            yield replace(self, viscous=self.viscous + 1)
        if not self.constant:
            yield replace(self, constant=True)
        if self.dry and not self.stribeck:
            yield from (replace(self, stribeck=share * top) for share in STRIBECK_VELOCITY_RATIOS)


@dataclass(frozen=True, kw_only=True)
class FittedShape:
    """Shape with fitted coefficients and their intervals."""

    shape: Shape
    values: FloatArray
    half_width: FloatArray
    """Half-width of each 95 % interval given this shape, discrepancy included."""
    low: FloatArray
    high: FloatArray
    """Bounds of the 95 % intervals, which span all shapes that may hold."""
    squares: float
    """Weighted sum of the squared residuals at the points, with Huber's loss for outliers."""
    missed_points: int
    largest_miss: float
    """Largest residual at a point, over its uncertainty or the practically relevant force, whichever is larger."""

    def force(self, speed: FloatArray, direction: FloatArray | None = None) -> FloatArray:
        """Return the force [N] at velocities `speed` [m/s] and directions after their memory, shape (n,)."""
        return np.asarray(self.shape.columns(speed, direction) @ self.values)

    def coefficient_intervals(self, name: str, factor: float = 1.0) -> list[tuple[float, float, float]]:
        """Return value and bounds of the 95 % interval of each coefficient of a term, times a `factor` of -1 or 1."""
        rows = [k for k, one in enumerate(self.shape.names) if one == name]
        found = [(self.values[k], self.low[k], self.high[k]) for k in rows]
        return [(factor * value, *sorted((factor * low, factor * high))) for value, low, high in found]

    def without(self, name: str) -> FittedShape:
        """Return the fitted shape with the coefficients of a term set to 0."""
        kept = np.where([one == name for one in self.shape.names], 0.0, self.values)
        return replace(self, values=kept)


def fit_shape(points: Sequence[Point], shape: Shape, top: float) -> FittedShape:
    """Return a shape with its coefficients fitted to the points; `top`: top speed [m/s]."""
    speed, force, error = (np.array([getattr(one, name) for one in points]) for name in ("velocity", "force", "error"))
    matters = PRACTICAL_SHARE * max(float(np.max(np.abs(force - middle_force(points)))), 1e-30)
    columns, plain = shape.columns(speed), 1.0 / np.hypot(error, 0.5 * matters)
    weight = plain
    for _ in range(ITERATIONS):
        scale = np.maximum(np.linalg.norm(columns * weight[:, None], axis=0), 1e-300)
        inverse = np.linalg.pinv(columns * weight[:, None] / scale, rcond=1e-9) / scale[:, None]
        values = inverse @ (force * weight)
        off = force - columns @ values
        far = np.maximum(np.abs(off) * plain / COVERAGE_FACTOR, 1.0)
        weight = plain / np.sqrt(far)
    free = max(len(points) - columns.shape[1], 0)
    level = (float(np.sum(np.square(off) / far)) + (0.5 * matters) ** 2) / (free + 1.0)
    alike = np.exp(-np.abs(speed[:, None] - speed) / (0.5 * top)) * (np.sign(speed[:, None]) == np.sign(speed))
    covariance = np.diag(np.square(error)) + level * alike
    moves = inverse * weight
    errors = np.sqrt(np.maximum(np.diag(moves @ covariance @ moves.T), 0.0))
    half_width = errors * float(stdtrit(max(free, 1), CONFIDENCE))
    missing = np.abs(off) / np.maximum(matters, COVERAGE_FACTOR * error)
    return FittedShape(
        shape=shape,
        values=values,
        half_width=half_width,
        low=values - half_width,
        high=values + half_width,
        squares=float(np.sum(np.where(far > 1.0, COVERAGE_FACTOR**2 * (2.0 * far - 1.0), np.square(off * plain)))),
        missed_points=int(np.count_nonzero(missing > 1.0)),
        largest_miss=float(np.max(missing)),
    )


def simplest_shape(
    points: Sequence[Point], top: float, viscous: float = 0.0, allowed: frozenset[str] = frozenset()
) -> FittedShape:
    """Return the simplest shape that misses no point, or else one to which the evidence supports no further term.

    `viscous`: friction [N s/m] of the bench file, whose sum with that of the shape must not be negative; `allowed`:
    names of terms, and `directional` for viscous friction of two coefficients.
    """
    room = max(len(points) // 2, 1)

    def possible(one: FittedShape) -> bool:
        if not set(one.shape.names) <= allowed or (one.shape.viscous == 2 and "directional" not in allowed):
            return False
        value = dict(zip(one.shape.names, one.values, strict=True))
        drags = [size for name, size in zip(one.shape.names, one.values, strict=True) if name == "viscous"]
        dry, rise = value.get("dry", 0.0), value.get("stribeck", 0.0)
        return dry >= 0.0 and min(drags, default=0.0) >= -viscous and 0.0 <= rise <= 2.0 * dry

    shapes = [
        Shape(dry, drag, constant, share * top)
        for dry, drag, constant in product((False, True), range(3), (False, True))
        for share in ((0.0, *STRIBECK_VELOCITY_RATIOS) if dry else (0.0,))
    ]
    whole = [fit_shape(points, shape, top) for shape in shapes if shape.parameter_count <= room]
    whole = [one for one in whole if not one.missed_points and possible(one)]
    if whole:
        return min(whole, key=lambda one: (one.shape.parameter_count, one.squares))
    current = fit_shape(points, Shape(), top)
    while True:
        tried = [fit_shape(points, shape, top) for shape in current.shape.richer(top)]
        best = min((one for one in tried if len(one.values) <= room and possible(one)),
                   key=lambda one: one.squares, default=current)  # fmt: skip
        price = (len(best.values) - len(current.values)) * np.log(len(points))
        if best is current or len(points) * np.log(best.squares / current.squares) > -price:
            break
        current = best
    either_way = fit_shape(points, Shape(dry=True, constant=True), top)
    alone = current.largest_miss > COVERAGE_FACTOR and room == 1 and len(points) > 2
    return either_way if alone and not either_way.missed_points and possible(either_way) else current


def drop_uncertain(points: Sequence[Point], found: FittedShape, top: float) -> FittedShape:
    """Return the shape without terms that may be absent, the least evident dropped first; intervals span both fits."""
    while len(found.values):
        unsure = {name for name, value, reach in zip(found.shape.names, found.values, found.half_width, strict=True)
                  if abs(value) <= reach}  # fmt: skip
        if not unsure:
            break
        fewer = [fit_shape(points, found.shape.without(name), top) for name in sorted(unsure)]
        fewer = [one for one in fewer if found.missed_points or one.largest_miss < COVERAGE_FACTOR]
        if not fewer:  # without them a point is missed grossly: they are needed, and their intervals end at 0
            low = np.where(found.values > 0.0, np.maximum(found.low, 0.0), found.low)
            return replace(found, low=low, high=np.where(found.values < 0.0, np.minimum(found.high, 0.0), found.high))
        fewest = min(fewer, key=lambda one: one.squares)
        low, high = fewest.low.copy(), fewest.high.copy()
        for k, name in enumerate(fewest.shape.names):
            for j, other in enumerate(found.shape.names):
                if other == name:
                    low[k], high[k] = min(low[k], found.low[j]), max(high[k], found.high[j])
        found = replace(fewest, low=low, high=high)
    return found


def curve_shape(curve: ForceCurve, viscous: float, allowed: frozenset[str]) -> FittedShape | None:
    """Return the shape fitted to a curve, or None if the curve lacks a sign of friction (`missing_indication`)."""
    if missing_indication(curve):
        return None
    if is_unidirectional(curve):
        allowed = allowed - {"constant"}  # not distinguishable from dry friction
    if not spans_speeds(curve):
        allowed = allowed - {"viscous", "stribeck"}  # neither are these
    found = simplest_shape(curve.points, curve.top_speed, viscous, allowed)
    return drop_uncertain(curve.points, found, curve.top_speed)


def is_unidirectional(curve: ForceCurve) -> bool:
    """Return whether all points are of one direction: dry friction cannot be told from a constant force."""
    speeds = [one.velocity for one in curve.points]
    return min(speeds) > 0.0 or max(speeds) < 0.0


def spans_speeds(curve: ForceCurve) -> bool:
    """Return whether speeds held in one direction differ by `SLOPE_SPEED_RATIO`, so that a slope can be told."""
    speeds = np.array([one.velocity for one in curve.points])
    sides = [np.abs(speeds[speeds * side > 0.0]) for side in (1.0, -1.0)]
    return any(len(one) > 1 and float(one.max()) >= SLOPE_SPEED_RATIO * float(one.min()) for one in sides)


def stribeck_velocity_interval(points: Sequence[Point], found: FittedShape, top: float) -> tuple[float, float]:
    """Return the 95 % interval of the Stribeck velocity [m/s] by the profile of the squared residuals."""
    tried = found.shape.stribeck * PROFILE_FACTORS
    squares = [fit_shape(points, replace(found.shape, stribeck=float(one)), top).squares for one in tried]
    rise = len(points) * np.log(np.maximum(squares, 1e-12) / max(found.squares, 1e-12))
    inside = tried[rise < stdtrit(max(len(points) - len(found.values) - 1, 1), CONFIDENCE) ** 2]
    return float(min([*inside, found.shape.stribeck])), float(max([*inside, found.shape.stribeck]))


def missing_indication(curve: ForceCurve) -> str:
    """Return, in words, the indication of friction that a curve lacks; empty if it lacks none."""
    if len(curve.points) < 2:
        return "hardly a speed is held"
    if is_unidirectional(curve):  # the force must vary relevantly with the speed, and always oppose the motion
        force = np.array([one.force * np.sign(one.velocity) for one in curve.points])
        follows = force.min() > 0.0 and np.ptp(force) > PRACTICAL_SHARE * force.max()
        return "" if follows else "all motion is one way, and the force does not follow the speed"
    if curve.opposing_share < MIN_OPPOSING_SHARE:
        return f"the force opposes only {100.0 * curve.opposing_share:.0f} % of the motion"
    return ""
