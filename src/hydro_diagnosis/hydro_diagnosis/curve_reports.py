# SPDX-License-Identifier: Apache-2.0
"""Curves of report.json: missing force and flow over their arguments, with the part that the claims explain.

::

    motion        force over speed, rests and turns left out; over position if the model has that term
    pressure_a    flow into chamber A, over the current at steady speed, and over the pressure difference at rest

The measured flow is the displacement of the piston plus the compression of the oil.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.special import stdtrit

from hydro_core.signals import FloatArray
from hydro_diagnosis.curves import STANDSTILL_SHARE, ForceCurve, centred_splines, spline_basis
from hydro_diagnosis.effects.base import MOTION, PRESSURE, EffectHypothesis
from hydro_diagnosis.model import chambers
from hydro_diagnosis.report_json import CurveReport
from hydro_diagnosis.significance import CONFIDENCE
from hydro_sim.model.tables import KNOTS

if TYPE_CHECKING:
    from hydro_diagnosis.curve_claims import CurveClaims
    from hydro_diagnosis.estimation.problem import Problem


def curve_reports(
    problem: Problem, claims: Sequence[EffectHypothesis], curve: ForceCurve | None, by_curve: CurveClaims | None
) -> list[CurveReport]:
    """Return the curves with points in the recordings; `by_curve`: the claims, where they are shapes of the curve."""
    found = []
    if curve is not None and curve.points:
        points = curve.points
        at, force, error, strokes = (
            np.array([getattr(one, name) for one in points]) for name in ("velocity", "force", "error", "strokes")
        )
        if by_curve is not None:
            made = by_curve.shape.force(at) if by_curve.shape is not None else np.zeros_like(at)
        else:
            made = np.array(curve.point_means([one.force_of(problem.baseline, claims) for one in curve.motions]))
        found.append(_report(MOTION, "velocity", "m/s", "N", at, force, error, strokes, made))
        if curve.terms.position:
            found.append(_over_position(curve, by_curve))
    if PRESSURE in problem.blocks:
        for rest, over, unit in ((False, "current", "A"), (True, "pressure_difference", "Pa")):
            if flows := _flows(problem, claims, rest=rest):
                found.append(_report("pressure_a", over, unit, "m3/s", *map(np.array, zip(*flows, strict=True))))
    return found


def _over_position(curve: ForceCurve, by_curve: CurveClaims | None) -> CurveReport:
    share = np.asarray(np.arange(2 * KNOTS) / (2.0 * KNOTS - 1.0), dtype=np.float64)
    rows = centred_splines(share)
    first, count = 2 * len(curve.knots), len(share)
    errors = np.zeros(count)
    for k in range(count):
        row = np.zeros(len(curve.values))
        if curve.terms.position == "straight":
            row[first] = share[k] - 0.5
        else:
            row[first : first + KNOTS - 1] = rows[k, 1:]
        errors[k] = curve.error(row)
    force = spline_basis(share) @ curve.over_position
    made = force if by_curve is not None and by_curve.closures else np.zeros(count)
    at = np.asarray(curve.limits[0] + share * (curve.limits[1] - curve.limits[0]), dtype=np.float64)
    strokes = np.full(count, len(np.unique(curve.sliding.stroke)))
    return _report(MOTION, "position", "m", "N", at, force, errors, strokes, made)


def _report(
    equation: str, over: str, unit_x: str, unit_y: str, at: FloatArray, missing: FloatArray, error: FloatArray,
    count: npt.NDArray[Any], made: FloatArray,
) -> CurveReport:  # fmt: skip
    reach = error * stdtrit(np.maximum(count - 1.0, 1.0), CONFIDENCE)
    return CurveReport(
        equation=equation, over=over, unit_x=unit_x, unit_y=unit_y, x=at.tolist(), y=missing.tolist(),
        low=(missing - reach).tolist(), high=(missing + reach).tolist(), named=made.tolist(),
    )  # fmt: skip


def _flows(
    problem: Problem, claims: Sequence[EffectHypothesis], *, rest: bool
) -> list[tuple[float, float, float, float, float]]:
    """Argument, missing flow, its standard error, number of stretches (five or more), explained flow: ten points.

    Of samples around which the piston is at rest (`rest`), else of those around which its speed is steady for 0.1 s:
    means over that time, which average out an encoder's steps.
    """
    steady_for = 0.1
    top = max(float(np.percentile(np.abs(model.v), 95)) for model in problem.models)
    parts = []
    for k, model in enumerate(problem.models):
        modelled = []
        for everything in ((*problem.baseline, *claims), problem.baseline):
            bench, oil = model.bench(everything), model.oil(everything)
            modelled.append(chambers.net_flows(bench, oil, everything, model.memory)[0])
        stiff = chambers.chamber_stiffnesses(bench, oil, everything)[0]
        p_a, p_b = (model.smooth(model.channels["pressure_" + chamber]) for chamber in "ab")
        measured = bench.piston_area * model.v + np.gradient(p_a, model.step) / stiff
        over = p_a - p_b if rest else model.channels["valve_current"]
        count = max(round(steady_for / model.step), 3)
        speed, reach = np.asarray(uniform_filter1d(model.v, count)), count // 2
        if rest:
            there = maximum_filter1d(np.abs(speed), count) < STANDSTILL_SHARE * top
        else:
            change = np.abs(np.roll(speed, -reach) - np.roll(speed, reach))
            there = (np.abs(speed) > STANDSTILL_SHARE * top) & (change < 0.2 * np.abs(speed))
        there = there[model.rows]
        smoothed = (np.asarray(uniform_filter1d(each, count)) for each in (over, measured, *modelled))
        at, one, after, before = (model.at_evaluated(each)[there] for each in smoothed)
        stretch = np.floor(model.evaluated_time()[there] / steady_for).astype(np.int64) + k * 10**7
        parts.append((at, one - before, after - before, stretch))
    at, missing, made, stretch = (np.concatenate(one) for one in zip(*parts, strict=True))
    points: list[tuple[float, float, float, float, float]] = []
    if not len(at):
        return points
    place = np.floor(10 * (at - at.min()) / max(float(np.ptp(at)), 1e-300))
    for one in np.unique(place):
        here = place == one
        _, index = np.unique(stretch[here], return_inverse=True)
        means = np.bincount(index, missing[here]) / np.bincount(index)
        if len(means) >= 5:
            error = float(np.std(means, ddof=1) / np.sqrt(len(means)))
            mean, named = float(missing[here].mean()), float(made[here].mean())
            points.append((float(at[here].mean()), mean, error, float(len(means)), named))
    return points
