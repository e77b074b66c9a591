# SPDX-License-Identifier: Apache-2.0
"""Checks by simple physics, beside the fit: what the recordings say at steady speed and at rest, against the model.

::

    friction        force that friction takes, over the speed, while that is steady
    valve_flow      flow into chamber A, over the current, at steady speed
    leak_at_rest    flow into chamber A, over the pressure difference, while the piston stands

Measured flow: what the piston displaces and what the oil's compression stores.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hydro_diagnosis.effects.base import MOTION, PRESSURE, Claim, FloatArray
from hydro_diagnosis.estimation.noise import SLIDING
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.segment_model import SegmentModel

STEADY = 0.1
"""s for which a speed must be steady."""
STEADY_BY = 0.2
"""Share of itself by which a steady speed may vary within that time."""
SPEED_RATIO = 1.5
"""Ratio of neighbouring speeds, whose samples make one point."""
BINS = 10
"""Points of a curve over current or pressure difference."""
LEAST = 5
"""Stretches of `STEADY` that make a point."""
MISSED = 0.15
"""Share of the largest unexplained force at any steady speed by which claims may miss a point."""
SURE = 3.0
"""Standard errors of a point beyond which it is missed: of the means over its stretches."""

FRICTION, VALVE_FLOW, LEAK_AT_REST = "friction", "valve_flow", "leak_at_rest"


@dataclass(frozen=True, kw_only=True)
class Point:
    """A point of a curve that is read off the recordings, SI units."""

    at: float
    """Speed, current or pressure difference."""
    measured: float
    before: float
    """What the bench file says."""
    model: float
    """What the bench file and the claims say."""
    uncertainty: float
    """Standard error of the measured value."""


@dataclass(frozen=True)
class _Samples:
    """Samples of one curve: variable, measured, before, model and stretch of each, shape (n,) each."""

    at: FloatArray
    values: FloatArray
    """Shape (3, n)."""
    stretch: npt.NDArray[np.int64]


def curves(problem: Problem, claims: Sequence[Claim]) -> dict[str, list[Point]]:
    """Points of each curve that the recordings have samples of, by its name."""
    found = {}
    if MOTION in problem.blocks:
        found[FRICTION] = _points(_friction(problem, claims), by_ratio=True)
    if PRESSURE in problem.blocks:
        found[VALVE_FLOW] = _points(_flows(problem, claims, rest=False), by_ratio=False)
        found[LEAK_AT_REST] = _points(_flows(problem, claims, rest=True), by_ratio=False)
    return {name: points for name, points in found.items() if points}


def reproduced(problem: Problem, claims: Sequence[Claim]) -> float:
    """Share of the hydraulic force's variance in motion that the equation of motion reproduces; 1 where nothing moves.

    Not at rest: there dry friction is whatever the force needs.
    """
    if MOTION not in problem.blocks:
        return 1.0
    parts, everything = problem.parts(claims), (*problem.baseline, *claims)
    moving = [np.abs(model.kept(speed(model))) > SLIDING for model in problem.models]
    left = np.concatenate([parts["motion", k][there] for k, there in enumerate(moving)])
    forces = zip(problem.models, moving, strict=True)
    force = np.concatenate([model.measured_force(everything)[there] for model, there in forces])
    return float(1.0 - np.var(left) / max(np.var(force), 1e-300)) if len(left) else 1.0


def missed(points: Sequence[Point], noise: float = 0.0) -> list[Point]:
    """Points that the model misses by more than a share of the largest mismatch of the bench file, and by chance.

    `noise`: standard deviation of a residual [unit of the points]; what is smaller nobody reads off the points.
    """
    largest = max((abs(point.measured - point.before) for point in points), default=0.0)
    return [
        point for point in points
        if abs(point.measured - point.model) > max(MISSED * largest, SURE * point.uncertainty, noise)
    ]  # fmt: skip


def _friction(problem: Problem, claims: Sequence[Claim]) -> Iterator[_Samples]:
    before, after = problem.parts(()), problem.parts(claims)
    for k, model in enumerate(problem.models):
        sliding = model.kept(speed(model))
        left, remains = before["motion", k], after["motion", k]
        taken = model.bench(problem.baseline).viscous_friction * sliding
        yield _chosen(model, steady(model)[model.rows], sliding, left + taken, taken, left + taken - remains, k)


def _flows(problem: Problem, claims: Sequence[Claim], *, rest: bool) -> Iterator[_Samples]:
    for k, model in enumerate(problem.models):
        modelled = []
        for everything in ((*problem.baseline, *claims), problem.baseline):
            bench, oil = model.bench(everything), model.oil(everything)
            modelled.append(chambers.net_flows(bench, oil, everything, model.memory)[0])
        stiff = chambers.compliances(bench, oil, everything)[0]
        p_a, p_b = (model.smooth(model.channels["pressure_" + chamber]) for chamber in "ab")
        measured = bench.piston_area * model.v + np.gradient(p_a, model.step) / stiff
        over = p_a - p_b if rest else model.channels["valve_current"]
        there = at_rest(model) if rest else steady(model)
        at, one, before, after = (model.kept(_mean(model, each)) for each in (over, measured, *modelled[::-1]))
        yield _chosen(model, there[model.rows], at, one, before, after, k)


def speed(model: SegmentModel) -> FloatArray:
    """Velocity [m/s] in the mean over `STEADY` around each sample, shape (n,): an encoder's steps are not in it."""
    return _mean(model, model.v)


def _mean(model: SegmentModel, signal: FloatArray) -> FloatArray:
    """A signal in the mean over `STEADY` around each sample, shape (n,)."""
    return np.asarray(uniform_filter1d(signal, _count(model)))


def steady(model: SegmentModel) -> npt.NDArray[np.bool_]:
    """Samples around which the piston moves at a steady speed, shape (n,)."""
    here, reach = speed(model), _count(model) // 2
    change = np.abs(np.roll(here, -reach) - np.roll(here, reach))
    return np.asarray((np.abs(here) > SLIDING) & (change < STEADY_BY * np.abs(here)))


def at_rest(model: SegmentModel) -> npt.NDArray[np.bool_]:
    """Samples around which the piston all but stands, shape (n,)."""
    return np.asarray(maximum_filter1d(np.abs(speed(model)), _count(model)) < SLIDING)


def _count(model: SegmentModel) -> int:
    return max(round(STEADY / model.step), 3)


def _chosen(
    model: SegmentModel, there: npt.NDArray[np.bool_], at: FloatArray, measured: FloatArray, before: FloatArray,
    after: FloatArray, segment: int,
) -> _Samples:  # fmt: skip
    stretch = np.floor(model.kept_time() / STEADY).astype(np.int64) + segment * 10**7
    return _Samples(at[there], np.stack([measured, before, after])[:, there], stretch[there])


def _points(parts: Iterator[_Samples], *, by_ratio: bool) -> list[Point]:
    samples = list(parts)
    at = np.concatenate([one.at for one in samples])
    values = np.concatenate([one.values for one in samples], axis=1)
    stretch = np.concatenate([one.stretch for one in samples])
    if not len(at):
        return []
    if by_ratio:
        place = np.sign(at) * (100.0 + np.round(np.log(np.abs(at)) / np.log(SPEED_RATIO)))
    else:
        place = np.floor(BINS * (at - at.min()) / max(float(np.ptp(at)), 1e-300))
    points = []
    for one in np.unique(place):
        here = place == one
        _, index = np.unique(stretch[here], return_inverse=True)
        means = np.bincount(index, values[0][here] - values[2][here]) / np.bincount(index)
        if len(means) < LEAST:
            continue
        measured, before, after = (float(np.mean(part[here])) for part in values)
        error = float(np.std(means, ddof=1) / np.sqrt(len(means)))
        points.append(Point(at=float(np.mean(at[here])), measured=measured, before=before, model=after,
                            uncertainty=error))  # fmt: skip
    return sorted(points, key=lambda point: point.at)
