# SPDX-License-Identifier: Apache-2.0
"""Localisation of a mismatch: by equation, by time, and by region of the state space.

Channels alone do not locate it: a wrong load model also shows in the motion, and a wrong valve model in both
chambers. So an excess is traced back to the one equation whose hidden input explains the channels together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.estimation.fit import Fit, remaining
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.model.segment_model import SegmentModel

_PAUSE = 2.0
"""s, pauses of excess that `windows` bridge."""
_WINDOW = 0.5
"""s, over which excess is averaged for `windows`."""


@dataclass(frozen=True)
class Place:
    """One equation's part of the mismatch."""

    equation: str
    share: float
    windows: tuple[tuple[tuple[float, float], ...], ...]
    """Per segment: stretches [s, s] in which it stands out."""
    region: dict[str, tuple[float, float]]
    """Where it stands out, by variable: 10th and 90th percentile, SI units."""
    sentence: str
    channel: str
    """Channel of the residuals in which it shows most."""


def locate(problem: Problem, residual: FloatArray, gains: Mapping[str, float]) -> list[Place]:
    """Equations that hold more than noise, the largest share first; empty if there is none.

    `gains`: evidence of the best free-form input in each equation (`free_form.gains_by_equation`).
    """
    excess = {name: square - 1.0 for name, square in remaining(problem, residual).items()}
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


def locate_claims(problem: Problem, found: Fit, nothing: FloatArray) -> list[Place]:
    """Return the places where the claimed effects act, by the size of their signatures in the residuals."""
    layout = problem.layout
    power: dict[tuple[str, str], float] = {}
    for claim in found.judged:
        without = problem.residual(found.but(claim))
        signature = np.bincount(layout.channel, np.square(without - found.residual), len(CHANNELS))
        shown = {name: float(signature[k]) for k, name in enumerate(CHANNELS)}
        for equation in claim.effect.equations:
            channel = (
                equation
                if equation in shown and len(claim.effect.equations) > 1
                else max(shown, key=lambda name: shown[name])
            )
            size = shown[channel] if len(claim.effect.equations) > 1 else sum(shown.values())
            key = (equation, channel)
            power[key] = power.get(key, 0.0) + size
    total = sum(power.values()) or 1.0
    ranked = sorted(power, key=lambda key: -power[key])
    return [
        _place(problem, nothing, equation, channel, power[equation, channel] / total) for equation, channel in ranked
    ]


def _equation(
    problem: Problem, residual: FloatArray, channel: str, excess: dict[str, float], gains: Mapping[str, float]
) -> str:
    if channel in ("pressure_a", "pressure_b"):
        if _follows_supply(problem, residual):
            return "actuation"
        return _of_chambers(channel, excess, gains)
    if channel == "hydraulic":
        return "sensor"
    if channel == "motion":
        if "load" in excess and _coherent(problem, residual):
            return "load"
        return "sensor" if "hydraulic" in excess and "load" not in excess else "motion"
    return "load" if "motion" in excess and _coherent(problem, residual) else "sensor"


def _of_chambers(channel: str, excess: dict[str, float], gains: Mapping[str, float]) -> str:
    other = "pressure_b" if channel == "pressure_a" else "pressure_a"
    if "hydraulic" in excess and other not in excess:
        return "sensor"
    if other not in excess:
        return channel
    best = {name: gains[name] for name in ("pressure_a", "pressure_b", "actuation") if name in gains}
    return max([channel, "actuation"], key=lambda equation: best.get(equation, 0.0))


def _follows_supply(problem: Problem, residual: FloatArray) -> bool:
    """Return whether each chamber is off mainly while the valve connects it to the supply: then the supply is off.

    One of them may be off by less than is noticeable, but must show it beyond chance.
    """
    layout = problem.layout
    loudness, count = np.zeros((2, 2)), np.zeros((2, 2))
    for k, model in enumerate(problem.models):
        opens_a = np.interp(model.kept_time(), model.time, model.channels["valve_current"]) > 0.0
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
        motion = residual[(layout.channel == CHANNELS.index("motion")) & (layout.segment == k)]
        motion = motion * problem.deviation("motion", k)
        load = residual[(layout.channel == CHANNELS.index("load")) & (layout.segment == k)]
        load = load * problem.deviation("load", k)
        seen = _through_cell(model, problem, motion)
        matched += float(seen @ load)
        power += float(np.sqrt((seen @ seen) * (load @ load)))
    return power > 0.0 and matched / power > 0.6


def _through_cell(model: SegmentModel, problem: Problem, motion: FloatArray) -> FloatArray:
    if problem.bench.load_cell_bandwidth is None:
        return motion
    kept = model.kept_time()
    fine = np.interp(model.time, kept, motion)
    return np.interp(kept, model.time, model.behind_cell(fine, problem.bench))


def _place(problem: Problem, residual: FloatArray, equation: str, channel: str, share: float) -> Place:
    layout = problem.layout
    windows, inside = [], []
    for k, model in enumerate(problem.models):
        at = (layout.channel == CHANNELS.index(channel)) & (layout.segment == k)
        time = layout.time[at]
        width = max(int(_WINDOW / max(float(np.median(np.diff(time))), 1e-3)), 1)
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
    sentence = f"{amount} of the mismatch is in {_WORDS[equation]}."
    return Place(equation, share, tuple(windows), region, sentence, channel)


def _stretches(time: FloatArray, loud: FloatArray) -> tuple[tuple[float, float], ...]:
    """Stretches in which something is loud; pauses shorter than `_PAUSE` are bridged."""
    loud = loud.copy()
    pauses = np.flatnonzero(np.diff(np.concatenate([[True], loud, [True]]).astype(np.int8)))
    for begin, end in zip(pauses[::2], pauses[1::2], strict=True):
        if time[min(end, len(time) - 1)] - time[begin] < _PAUSE and begin > 0 and end < len(time):
            loud[begin:end] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[False], loud, [False]]).astype(np.int8)))
    return tuple((float(time[begin]), float(time[end - 1])) for begin, end in zip(edges[::2], edges[1::2], strict=True))


_WORDS = {
    "pressure_a": "the equations of chamber A",
    "pressure_b": "the equations of chamber B",
    "motion": "the forces on the moving mass",
    "load": "the force of the load",
    "actuation": "valve and supply",
    "sensor": "the sensors",
}
