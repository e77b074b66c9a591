# SPDX-License-Identifier: Apache-2.0
"""Localisation of a mismatch: by equation, by time, and by region of the state space.

Channels alone do not locate it: a wrong load model also affects the motion residual, and a wrong valve model both
chambers. So an excess is attributed to the one equation whose hidden input explains the channels jointly.

Free-form hidden inputs tell in which equation, and as a function of which variable, an unnamed quantity would have to
act. For each equation and variable a piecewise linear function with many knots is propagated to the residuals
(observer, test function, sensors) and fitted by linear least squares. It competes with the named causes at the same
price per parameter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d

from hydro_core.signals import FloatArray
from hydro_diagnosis.effects.base import CHANNELS
from hydro_diagnosis.estimation.fit import Fit
from hydro_diagnosis.model.responses import ChannelResponses, Responses
from hydro_diagnosis.significance import FOLD_TIME

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem

KNOTS = 24
"""Number of knots of each free-form function; of functions of time, per segment."""


@dataclass(frozen=True)
class FreeForm:
    """Free-form hidden input: a piecewise linear function of one variable that acts in one equation."""

    equation: str
    variable: str
    gain: float
    """Evidence [BIC]: gain in deviance less ln(n) per knot."""


_INPUTS = (
    ("pressure_a", ""),
    ("pressure_b", ""),
    ("actuation", ""),
    ("motion", ""),
    ("load", ""),
    ("sensor", "hydraulic_force"),
    ("sensor", "load_force"),
    ("sensor", "pressure_a"),
    ("sensor", "pressure_b"),
)
"""Equation, and sensor."""


def free_forms(problem: Problem, found: Fit) -> list[FreeForm]:
    """Return the free-form inputs, each fitted jointly with a fit's claims, in descending order of evidence."""
    weight = problem.weight(found.residual)
    named = found.jacobian * weight[:, None]
    left = found.residual * weight
    base = problem.deviance(left / weight)
    forms = []
    ways = [Responses(model, problem.blocks, (*problem.baseline, *found.claims)) for model in problem.models]
    inputs = [one for one in _INPUTS if _visible(problem, *one)]
    have = set.intersection(*(set(model.channels) for model in problem.models))
    variables = ["time", "position", "velocity"]
    variables += ["current"] if "valve_current" in have else []
    variables += ["pressure_a", "pressure_b", "pressure_difference"] if {"pressure_a", "pressure_b"} <= have else []
    for variable in variables:
        hats = _hats(problem, variable)
        for equation, sensor in inputs:
            shown = [_response(way, equation, sensor, own) for way, own in zip(ways, hats, strict=True)]
            inputs_shown = np.zeros((len(left), len(hats[0])))
            for channel, responses in problem.join_responses(shown, len(hats[0])).items():
                inputs_shown[problem.layout.channel == channel] = responses.T
            columns = np.column_stack([inputs_shown * weight[:, None], named])
            if not np.isfinite(columns).all():  # a response that runs away is no evidence
                continue
            lengths = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            scaled = columns / lengths  # normal equations: many rows by few columns
            amounts = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10, hermitian=True) @ (scaled.T @ -left) / lengths
            reached = problem.deviance((left + columns @ amounts) / weight)
            gain = base - reached - len(hats[0]) * float(np.log(len(left)))
            forms.append(FreeForm(equation, variable, gain))
    return sorted(forms, key=lambda form: -form.gain)


def _visible(problem: Problem, equation: str, sensor: str) -> bool:
    """Whether the recordings have the channels whose residuals depend on an input."""
    if equation == "sensor":
        return sensor in problem.sensor_noise and any(block != "motion" for block in problem.blocks)
    return (equation if equation in ("motion", "load") else "pressure") in problem.blocks


def _response(way: Responses, equation: str, sensor: str, hidden: FloatArray) -> ChannelResponses:
    """Responses to inputs, shape (functions, n): N, A, m3/s into a chamber, or additive errors of a sensor."""
    model, zeros = way.model, np.zeros_like(hidden)
    if equation == "motion":
        return way.to_force(hidden)
    if equation == "load":
        return way.to_load(hidden, hidden)
    if equation == "actuation":
        return way.to_spool(hidden)
    if equation != "sensor":
        return way.to_flows(*((hidden, zeros) if equation == "pressure_a" else (zeros, hidden)))
    if sensor == "load_force":
        return way.restrict_to_blocks({"load": way.smooth(hidden)})
    means = np.stack([model.means(one) for one in hidden])
    if sensor == "hydraulic_force":
        return way.restrict_to_blocks({"motion": way.smooth(hidden), "hydraulic": means})
    passed = np.stack([way.observer_innovations(one, zeros[0]) for one in hidden])
    area = -way.bench.piston_area * (1.0 if sensor == "pressure_a" else -way.bench.area_ratio)
    return way.restrict_to_blocks({sensor: way.smooth(passed), "hydraulic": area * means})


def _hats(problem: Problem, variable: str) -> list[FloatArray]:
    """Basis functions along each segment, shape (functions, n); those of time act in one segment each."""
    values = np.concatenate([model.variable(variable)[model.settle :] for model in problem.models])
    if variable in ("velocity", "current"):  # denser around zero, where friction and valve are most nonlinear
        knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, KNOTS)))
    else:
        knots = np.linspace(values.min(), values.max(), KNOTS)
    found = []
    for k, model in enumerate(problem.models):
        own = np.stack([np.interp(model.variable(variable), knots, peak) for peak in np.eye(len(knots))])
        if variable == "time":
            own = np.concatenate([own * (at == k) for at in range(len(problem.models))])
        found.append(own)
    return found


@dataclass(frozen=True)
class MismatchLocation:
    """Location of a mismatch: its equation and share, and where it is large in time and in state space."""

    equation: str
    share: float
    windows: tuple[tuple[tuple[float, float], ...], ...]
    """Intervals [s, s] in which it is large, of each segment."""
    region: dict[str, tuple[float, float]]
    """Range of each variable over these intervals: 10th and 90th percentile, SI units."""
    sentence: str
    channel: str
    """Channel of the residuals in which it is largest."""


def locate(problem: Problem, residual: FloatArray, forms: Sequence[FreeForm] = ()) -> list[MismatchLocation]:
    """Return the locations, by equation, of residuals that are more than noise, the largest share first.

    `forms`: free-form inputs in descending order of evidence.
    """
    gains = {form.equation: form.gain for form in reversed(forms)}
    excess = {name: square - 1.0 for name, square in problem.excess_channels(residual).items()}
    counts = dict(zip(CHANNELS, problem.layout.count, strict=True))
    weights: dict[str, float] = {}
    channel_of: dict[str, str] = {}
    for name in excess:
        equation = _equation(problem, residual, name, excess, gains)
        weights[equation] = weights.get(equation, 0.0) + excess[name] * counts[name]
        if equation not in channel_of or excess[name] > excess[channel_of[equation]]:
            channel_of[equation] = name
    total = sum(weights.values())
    ranked = sorted(weights, key=lambda equation: -weights[equation])
    return [_place(problem, residual, equation, channel_of[equation], weights[equation] / total) for equation in ranked]


def locate_claims(problem: Problem, found: Fit, baseline_residual: FloatArray) -> list[MismatchLocation]:
    """Return the locations where claimed effects act, by descending power of their signatures in the residuals."""
    layout = problem.layout
    power: dict[tuple[str, str], float] = {}
    for claim in found.cause_claims:
        without = problem.residual(found.claims_without(claim))
        signature = np.bincount(layout.channel, np.square(without - found.residual), len(CHANNELS))
        shown = {name: float(signature[k]) for k, name in enumerate(CHANNELS)}
        several, most = len(claim.effect.equations) > 1, max(shown, key=lambda name: shown[name])
        for equation in claim.effect.equations:
            channel = equation if several and equation in shown else most
            size = shown[channel] if several else sum(shown.values())
            key = (equation, channel)
            power[key] = power.get(key, 0.0) + size
    total = sum(power.values()) or 1.0
    ranked = sorted(power, key=lambda key: -power[key])
    return [
        _place(problem, baseline_residual, equation, channel, power[equation, channel] / total)
        for equation, channel in ranked
    ]


def _equation(
    problem: Problem, residual: FloatArray, channel: str, excess: dict[str, float], gains: Mapping[str, float]
) -> str:
    if channel in ("pressure_a", "pressure_b"):
        if _follows_supply(problem, residual):
            return "actuation"
        other = "pressure_b" if channel == "pressure_a" else "pressure_a"
        if other not in excess:
            return "sensor" if "hydraulic" in excess else channel
        best = {name: gains[name] for name in ("pressure_a", "pressure_b", "actuation") if name in gains}
        return max([channel, "actuation"], key=lambda equation: best.get(equation, 0.0))
    if channel == "hydraulic":
        return "sensor"
    if channel == "motion":
        if "load" in excess and _coherent(problem, residual):
            return "load"
        return "sensor" if "hydraulic" in excess and "load" not in excess else "motion"
    return "load" if "motion" in excess and _coherent(problem, residual) else "sensor"


def _follows_supply(problem: Problem, residual: FloatArray) -> bool:
    """Return whether both chambers' residuals are large mainly while fed by the supply, whose error it then is.

    One of them may be no excess, but must exceed chance.
    """
    layout = problem.layout
    loudness, count = np.zeros((2, 2)), np.zeros((2, 2))
    for k, model in enumerate(problem.models):
        opens_a = np.interp(model.evaluated_time(), model.time, model.channels["valve_current"]) > 0.0
        for index in range(2):
            fed = opens_a if index == 0 else ~opens_a
            squares = np.square(residual[(layout.channel == index) & (layout.segment == k)]) - 1.0
            loudness[index] += [float(squares[fed].sum()), float(squares[~fed].sum())]
            count[index] += [np.count_nonzero(fed), np.count_nonzero(~fed)]
    return bool(np.all(loudness[:, 0] > 2.0 * np.maximum(loudness[:, 1], 0.0) + 4.0 * np.sqrt(2.0 * count[:, 0])))


def _coherent(problem: Problem, residual: FloatArray) -> bool:
    """Return whether the load's residual is its sensor's response to the motion's: one hidden force explains both."""
    layout = problem.layout
    matched = power = 0.0
    for k, model in enumerate(problem.models):
        motion, load = (
            (residual * problem.deviations)[(layout.channel == CHANNELS.index(name)) & (layout.segment == k)]
            for name in ("motion", "load")
        )
        seen = motion
        if problem.bench.load_cell_bandwidth is not None:
            kept = model.evaluated_time()
            fine = model.behind_cell(np.interp(model.time, kept, motion), problem.bench)
            seen = np.interp(kept, model.time, fine)
        matched += float(seen @ load)
        power += float(np.sqrt((seen @ seen) * (load @ load)))
    return power > 0.0 and matched / power > 0.6


def _place(problem: Problem, residual: FloatArray, equation: str, channel: str, share: float) -> MismatchLocation:
    layout = problem.layout
    windows: list[tuple[tuple[float, float], ...]] = []
    inside = []
    for k, model in enumerate(problem.models):
        at = (layout.channel == CHANNELS.index(channel)) & (layout.segment == k)
        time = layout.time[at]
        if len(time) < 2:  # a stroke that is hardly longer than the filters' reach
            windows.append(())
            inside.append(np.zeros(len(model.time), bool))
            continue
        width = max(int(0.5 * FOLD_TIME / max(float(np.median(np.diff(time))), 1e-3)), 1)
        level = uniform_filter1d(np.square(residual[at]), width, mode="nearest")
        loud = level > max(2.0, 0.5 * float(np.mean(level)))
        windows.append(_stretches(time, loud))
        inside.append(np.interp(model.time, time, loud) > 0.5)
    region = {}
    for name in ("position", "velocity", "current"):
        if name == "current" and "valve_current" not in problem.models[0].channels:
            continue
        values = np.concatenate([model.variable(name)[at] for model, at in zip(problem.models, inside, strict=True)])
        if len(values):
            low, high = np.percentile(values, [10, 90])
            region[name] = (float(low), float(high))
    amount = f"{share * 100:.0f} %" if share >= 0.01 else "Under 1 %"
    sentence = f"{amount} of the mismatch is in {_EQUATION_PHRASES[equation]}."
    return MismatchLocation(equation, share, tuple(windows), region, sentence, channel)


def _stretches(time: FloatArray, loud: FloatArray) -> tuple[tuple[float, float], ...]:
    """Intervals [s, s] in which a residual is `loud`; gaps of less than two blocks are bridged."""
    loud = loud.copy()
    pauses = np.flatnonzero(np.diff(np.concatenate([[True], loud, [True]]).astype(np.int8)))
    for begin, end in zip(pauses[::2], pauses[1::2], strict=True):
        if time[min(end, len(time) - 1)] - time[begin] < 2.0 * FOLD_TIME and begin > 0 and end < len(time):
            loud[begin:end] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[False], loud, [False]]).astype(np.int8)))
    return tuple((float(time[begin]), float(time[end - 1])) for begin, end in zip(edges[::2], edges[1::2], strict=True))


_EQUATION_PHRASES = {
    "pressure_a": "the equations of chamber A",
    "pressure_b": "the equations of chamber B",
    "motion": "the forces on the moving mass",
    "load": "the force of the load",
    "actuation": "valve and supply",
    "sensor": "the sensors",
}
