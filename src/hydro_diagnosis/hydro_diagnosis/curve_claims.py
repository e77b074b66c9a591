# SPDX-License-Identifier: Apache-2.0
"""Claims from the curve of the missing force: named causes, the force over the position, and the explained shares."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hydro_core.signals import FloatArray
from hydro_diagnosis.curves import ForceCurve
from hydro_diagnosis.effects.base import MOTION, Effect, EffectHypothesis
from hydro_diagnosis.effects.closure import closure
from hydro_diagnosis.estimation.intervals import Interval
from hydro_diagnosis.report_json import ClosureReport, ParameterEstimate, Rival
from hydro_diagnosis.shapes import (
    PROFILE_FACTORS,
    FittedShape,
    curve_shape,
    drop_uncertain,
    fit_shape,
    is_unidirectional,
    missing_indication,
    spans_speeds,
    stribeck_velocity_interval,
)
from hydro_diagnosis.significance import PRACTICAL_SHARE, QUANTILE
from hydro_sim.model import grammar
from hydro_sim.model.effects.base import plain

if TYPE_CHECKING:
    from hydro_diagnosis.curves import Motion, Terms
    from hydro_diagnosis.estimation.problem import Problem

EFFECT_LABELS = {
    "dry": "friction_coulomb", "viscous": "friction_viscous", "constant": "force_offset",
    "stribeck": "friction_stribeck",
}  # fmt: skip
"""Labels of the effects that the terms of a shape represent."""
DIRECTIONAL_FRICTION, MOVING_MASS, PRESLIDING, LOAD_CELL_LAG = (
    "friction_viscous:directional", "moving_mass", "friction_presliding", "sensor_lag:hydraulic_force",
)  # fmt: skip
OPERATOR_EFFECTS = frozenset({MOVING_MASS, PRESLIDING, "sensor_lag"})
"""Ids of the effects by operators, not by the shape: moving mass, presliding, sensor lag."""
NO_SHARES = {"named": 0.0, "all": 0.0}
"""Explained shares where nothing is claimed."""


@dataclass(frozen=True, kw_only=True)
class CurveClaims:
    """Claims that the curve of the missing force supports."""

    shape: FittedShape | None = None
    claims: tuple[EffectHypothesis, ...] = ()
    bounds: Sequence[Interval] = ()
    """Intervals of all parameters of the claims, in their order."""
    evidence: Mapping[str, dict[str, float]] = field(default_factory=dict)
    """Evidence by label of the effect, as in report.json."""
    rivals: Sequence[Rival] = ()
    """Causes that explain the recordings as well as a claimed one."""
    closures: Sequence[ClosureReport] = ()
    accounted: Mapping[str, float] = field(default_factory=lambda: NO_SHARES)
    """Explained shares of the held-out missing force, its mean subtracted: by `named` claims, and by `all` terms."""
    why: str = ""
    """Reason in words if no shape is claimed; else empty."""


def claims_from_curve(
    curve: ForceCurve, held_out: Sequence[Motion], problem: Problem, library: Sequence[Effect]
) -> CurveClaims:
    """Return the claims of a curve; `held_out`: held-out motions; `library`: causes that may be named."""
    effects = {effect.label: effect for effect in library if effect.named}
    allowed = frozenset(
        name for name, label in {**EFFECT_LABELS, "directional": DIRECTIONAL_FRICTION}.items() if label in effects
    )
    share, found, terms = partial(_share, curve, held_out), _Claims(effects), curve.terms
    shape = _holding(curve, curve_shape(curve, problem.bench.viscous_friction, allowed), share)
    if shape is not None:
        for name in dict.fromkeys(shape.shape.names):
            estimates = shape.coefficient_intervals(name, -1.0 if name == "constant" else 1.0)
            label = DIRECTIONAL_FRICTION if len(estimates) > 1 else EFFECT_LABELS[name]
            if name == "stribeck":
                estimates.append(
                    (shape.shape.stribeck, *stribeck_velocity_interval(curve.points, shape, curve.top_speed))
                )
            gain = share(shape, terms, whole=name == "constant") - share(
                shape.without(name), terms, whole=name == "constant"
            )
            found.add(label, estimates, _evidence(curve, shape, name), gain)
    dry = shape.coefficient_intervals("dry") if shape is not None else []
    operators = {"mass": (MOVING_MASS, replace(terms, mass=False)),
                 "presliding_distance": (PRESLIDING, replace(terms, presliding_distance=0.0)),
                 "cell_bandwidth": (LOAD_CELL_LAG, replace(terms, cell_bandwidth=0.0))}  # fmt: skip
    for name, (label, less) in operators.items():
        if shape is None or not getattr(terms, name) or (label == PRESLIDING and not dry):
            continue
        strokes = len(np.unique(curve.sliding.stroke))
        evidence = 2.0 * strokes * float(np.log(curve.held_out_rms(less) / curve.held_out_rms(terms))) - float(
            np.log(strokes)
        )
        found.add(label, _size(curve, name, dry), evidence, share(shape, terms) - share(shape, less))
    accounted = {"named": share(shape, replace(terms, position="")), "all": share(shape, terms)}
    if shape is not None and accounted["all"] <= PRACTICAL_SHARE:
        return CurveClaims(why="what the curve would be named after does not hold on what was held out")
    closures = []
    if terms.position and accounted["all"] > accounted["named"]:
        closures.append(_law(curve, problem, found, accounted))
    return CurveClaims(
        shape=shape, claims=tuple(found.claims), bounds=found.bounds, evidence=found.evidence,
        rivals=_rivals(curve) if found.claims else [],
        closures=closures, accounted=accounted if found.claims else NO_SHARES, why=missing_indication(curve),
    )  # fmt: skip


@dataclass
class _Claims:
    """Collection of claims with their intervals and evidence."""

    effects: Mapping[str, Effect]
    claims: list[EffectHypothesis] = field(default_factory=list)
    bounds: list[Interval] = field(default_factory=list)
    evidence: dict[str, dict[str, float]] = field(default_factory=dict)

    def add(self, label: str, estimates: Sequence[tuple[float, float, float]], delta_bic: float, gain: float) -> None:
        """Add a claim, if its effect is allowed, with `estimates`: value and interval of its first parameters."""
        effect = self.effects.get(label)
        if effect is None:
            return
        values = {one.name: one.neutral for one in effect.parameters}
        for parameter, (value, low, high) in zip(effect.parameters, estimates, strict=False):
            at, least, most = (float(np.clip(one, parameter.low, parameter.high)) for one in (value, low, high))
            values[parameter.name] = at
            self.bounds.append(Interval(at, least, most, identifiable=at == value))
        for parameter in effect.parameters[len(estimates) :]:
            self.bounds.append(Interval(parameter.neutral, parameter.low, parameter.high, identifiable=False))
        self.claims.append(EffectHypothesis(effect, values))
        self.evidence[label] = {"delta_bic": delta_bic, "holdout_gain": gain}


def _holding(
    curve: ForceCurve, shape: FittedShape | None, share: Callable[[FittedShape, Terms], float]
) -> FittedShape | None:
    """Return the shape without the terms that make the held-out recordings worse, the worst first."""
    while shape is not None:
        whole = share(shape, curve.terms)
        gains = {
            name: whole - share(fit_shape(curve.points, shape.shape.without(name), curve.top_speed), curve.terms)
            for name in shape.shape.names
            if name != "constant"
        }
        worst = min(gains, key=lambda name: gains[name], default="")
        if not worst or gains[worst] >= 0.0:
            return shape
        shape = drop_uncertain(
            curve.points, fit_shape(curve.points, shape.shape.without(worst), curve.top_speed), curve.top_speed
        )
    return None


def _share(
    curve: ForceCurve, held_out: Sequence[Motion], shape: FittedShape | None, terms: Terms, *, whole: bool = False
) -> float:
    """Return the share of the missing force that claims account for in held-out recordings.

    1 - (rms of the residual) / (rms of the missing force), noise subtracted; and means too, unless `whole`.
    """
    left, missing, noise = list[FloatArray](), list[FloatArray](), list[float]()
    for one in held_out:
        force, there = curve.missing_force(one)
        missing.append(force[there])
        made = curve.predicted(one, shape.force if shape else lambda speed, _direction: np.zeros_like(speed), terms)
        left.append((force - made)[there])
        noise.append(one.noise)
    if not sum(map(len, missing)):
        return 0.0
    before, after = (
        float(np.mean(np.square(one)) if whole else np.var(one)) for one in map(np.concatenate, (missing, left))
    )
    floor = float(np.mean(np.square(noise)))
    return 1.0 - float(np.sqrt(max(after - floor, 0.0) / max(before - floor, 1e-300)))


def _evidence(curve: ForceCurve, shape: FittedShape, name: str) -> float:
    """Evidence [BIC] of the points for a term of the shape."""
    without = shape.shape.without(name)
    while name in without.names:
        without = without.without(name)
    fewer, count = fit_shape(curve.points, without, curve.top_speed), len(curve.points)
    parameter_count = len(shape.values) - len(fewer.values)
    return float(count * np.log(max(fewer.squares, 1e-9) / max(shape.squares, 1e-9)) - parameter_count * np.log(count))


def _size(curve: ForceCurve, name: str, dry: Sequence[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """Return an operator's parameter and interval: within it the held-out RMS rises by `PRACTICAL_SHARE` at most."""
    if name == "mass":
        value, error = curve.mass
        return [(value, value - QUANTILE * error, value + QUANTILE * error)]
    value = getattr(curve.terms, name)
    least = curve.held_out_rms(curve.terms)
    most, low, high = (1.0 + PRACTICAL_SHARE) * least, value, value
    for factors in (PROFILE_FACTORS[::2], PROFILE_FACTORS[::2] ** 0.1):  # finer if it is narrower than their spacing
        if low == high:
            tried = (value * factors).tolist()
            flat = [one for one in tried if curve.held_out_rms(replace(curve.terms, **{name: one})) < most]
            low, high = min([*flat, value]), max([*flat, value])
    return (
        [(value, low, high)] if name == "cell_bandwidth" else [(dry[0][0] / value, dry[0][0] / high, dry[0][0] / low)]
    )


def _rivals(curve: ForceCurve) -> list[Rival]:
    found = []
    if is_unidirectional(curve):
        why = "a constant force explains these recordings as well as dry friction: all motion is one way"
        found.append(Rival(id="force_offset", delta_bic=0.0, distinguishable=False, why=why))
    if not spans_speeds(curve):
        why = "viscous friction explains these recordings as well as dry friction: hardly more than one speed is held"
        found.append(Rival(id="friction_viscous", delta_bic=0.0, distinguishable=False, why=why))
    for terms in curve.rivals:
        for name, label in (
            ("mass", MOVING_MASS),
            ("presliding_distance", PRESLIDING),
            ("cell_bandwidth", LOAD_CELL_LAG.partition(":")[0]),
        ):
            if getattr(terms, name) and not getattr(curve.terms, name):
                why = f"{label.replace('_', ' ')} explains these recordings as well: another recording must tell"
                found.append(Rival(id=label, delta_bic=0.0, distinguishable=False, why=why))
    return found


def _law(curve: ForceCurve, problem: Problem, found: _Claims, accounted: Mapping[str, float]) -> ClosureReport:
    """Add the force over the position to the claims, as a closure, and return its report."""
    effect = closure(grammar.FORMS[MOTION, "table over position"], problem.bench, curve.limits)
    values = dict(zip((one.name for one in effect.parameters), curve.over_position.tolist(), strict=True))
    found.claims.append(EffectHypothesis(effect, values))
    found.bounds += [Interval(one, one, one, identifiable=False) for one in values.values()]
    slope = (curve.over_position[-2] - curve.over_position[1]) / (curve.limits[1] - curve.limits[0])
    straight, mass = curve.terms.position == "straight", ""
    if like := next((one for one in curve.rivals if one.mass and not curve.terms.mass), None):
        more = ForceCurve(curve.motions, like).mass[0]
        mass = f" In this motion {more:.3g} kg more of moving mass does the same: another frequency tells them apart."
    return ClosureReport(
        equation=MOTION,
        form="smooth",
        expression=plain(f"{slope:.4g} N/m * (position - {0.5 * sum(curve.limits):.4g} m)")
        if straight
        else "f(position), a sum of cubic B-splines of mean 0",
        terms={name: ParameterEstimate(value=value, ci95=None, unit="N") for name, value in values.items()},
        range=list(curve.limits),
        sentence=plain(
            f"A force that {'rises' if slope > 0.0 else 'falls'} with the position by {abs(slope):.3g} N/m in the "
            "mean: like that of a spring that the bench file does not hold." + mass
        ),
        share_closed=float(np.clip(accounted["all"] - accounted["named"], 0.0, 1.0)),
    )
