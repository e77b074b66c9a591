# SPDX-License-Identifier: Apache-2.0
"""Operating regimes in which the simulation is wrong beyond chance, with a false-discovery rate over all of them.

A regime is a range of one variable: `BINS` of equal counts, those of the velocity apart by direction. Its statistic is
the mean of a residual over its standard error by sums in blocks of `FOLD_TIME`, so that the samples of a block need not
be independent (cluster-robust, Liang and Zeger 1986). The false-discovery rate is Benjamini and Hochberg's
(1995) over all regimes of all residuals; arXiv 2606.23215 does the same for the misfit of simulations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np
import numpy.typing as npt
from scipy.stats import false_discovery_control
from scipy.stats import t as student

from hydro_core.signals import FloatArray
from hydro_diagnosis.effects.base import BLOCKS, CHANNELS, PRESSURE
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.report_json import Regime
from hydro_diagnosis.significance import FOLD_TIME

FALSE_DISCOVERY_RATE = 0.05
"""Expected share of the regimes named that chance alone would name."""
BINS = 6
"""Number of regimes of a variable."""
MIN_BLOCKS = 5
"""Smallest effective number of blocks of which a mean is judged."""


@dataclass(frozen=True)
class _Tested:
    channel: str
    regime: Regime
    probability: float
    apart: float
    """Mean there less the mean everywhere, of the residual over its deviation."""
    count: int


def wrong_regimes(problem: Problem, residual: FloatArray) -> dict[str, list[Regime]]:
    """Return the regimes in which a residual that is more than noise is wrong, ascending, by channel.

    Of each channel they are those of one variable, the one by which the means differ most.
    """
    excess = problem.excess_channels(residual)
    names = {channel: _variables(problem, channel) for channel in excess}
    signals = {name: [one.variable(name) for one in problem.models] for name in sorted({*chain(*names.values())})}
    tests = [
        one
        for channel in excess
        for variable in names[channel]
        for one in _tested(problem, residual, channel, variable, signals[variable])
    ]
    if not tests:
        return {}
    rates = false_discovery_control([one.probability for one in tests], method="bh")
    named = [
        replace(one, regime=replace(one.regime, rate=float(rate)))
        for one, rate in zip(tests, rates, strict=True)
        if rate <= FALSE_DISCOVERY_RATE
    ]
    found: dict[str, list[Regime]] = {}
    for channel in dict.fromkeys(one.channel for one in named):
        own = [one for one in named if one.channel == channel]
        explained = {one.regime.variable: 0.0 for one in own}
        for one in own:
            explained[one.regime.variable] += one.count * one.apart**2
        best = max(explained, key=lambda variable: explained[variable])
        found[channel] = _joined([one for one in own if one.regime.variable == best])
    return found


def where(regimes: list[Regime], unit: str) -> str:
    """Return the sentence of a channel's regimes; `unit` of its residual: N or Pa."""
    if not regimes:
        return ""
    name, own, factor = _WORDS[regimes[0].variable]
    shown, size = ("kPa", 1e-3) if unit == "Pa" else (unit, 1.0)
    parts = [
        f"{size * one.mean:+.3g} {shown} from {factor * one.low:.3g} to {factor * one.high:.3g} {own}"
        for one in regimes
    ]
    text = f"Beyond chance by the {name}: {', '.join(parts)} (false-discovery rate {FALSE_DISCOVERY_RATE:g})."
    return text.replace(" -", " \N{MINUS SIGN}")


_WORDS = {
    "time": ("time", "s", 1.0), "position": ("position", "mm", 1e3), "velocity": ("velocity", "mm/s", 1e3),
    "current": ("valve current", "mA", 1e3), "pressure_a": ("pressure A", "bar", 1e-5),
    "pressure_b": ("pressure B", "bar", 1e-5),
}  # fmt: skip
"""Name, unit and factor of each variable."""


def _variables(problem: Problem, channel: str) -> list[str]:
    """Variables of the regimes of a channel; the pressures are part of what the other equations measure."""
    have = set.intersection(*(set(model.channels) for model in problem.models))
    needs = {"position": "piston_position", "velocity": "piston_position", "current": "valve_current"}
    if channel in BLOCKS[PRESSURE]:
        needs |= {name: name for name in BLOCKS[PRESSURE]}
    single = len({model.segment.recording for model in problem.models}) == 1
    return [*(["time"] if single else []), *(name for name, needed in needs.items() if needed in have)]


def _tested(
    problem: Problem, residual: FloatArray, channel: str, variable: str, signals: list[FloatArray]
) -> list[_Tested]:
    """Tests of a channel's residual in the regimes of a variable, whose signals in each segment are given."""
    at = problem.layout.channel == CHANNELS.index(channel)
    segment, time, over = problem.layout.segment[at], problem.layout.time[at], residual[at]
    physical = over * problem.deviations[at]
    values = np.concatenate([
        np.interp(time[segment == k], model.time, signal)
        for k, (model, signal) in enumerate(zip(problem.models, signals, strict=True))
    ])  # fmt: skip
    edges = _edges(values, by_sign=variable == "velocity")
    regime = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    period = np.floor(time / FOLD_TIME).astype(np.int64)
    _, block = np.unique((regime * len(signals) + segment) * (period.max() + 1) + period, return_inverse=True)
    sums, counts = np.bincount(block, over), np.bincount(block)
    regime_of = np.zeros(len(sums), np.int64)
    regime_of[block] = regime
    found = []
    for k, (low, high) in enumerate(pairwise(edges.tolist())):
        own, count = sums[regime_of == k], counts[regime_of == k]
        blocks = float(np.sum(count)) ** 2 / max(
            float(np.sum(np.square(count))), 1.0
        )  # effective number: some are short
        if blocks < MIN_BLOCKS:
            continue
        mean = float(np.sum(own) / np.sum(count))
        root = float(np.sqrt(np.sum(np.square(own - mean * count)) * blocks / (blocks - 1.0)))
        found.append(_Tested(
            channel=channel,
            regime=Regime(variable=variable, low=low, high=high, mean=float(np.mean(physical[regime == k])), rate=1.0),
            probability=float(2.0 * student.sf(abs(float(np.sum(own))) / max(root, 1e-300), blocks - 1.0)),
            apart=mean - float(np.mean(over)), count=int(np.sum(count)),
        ))  # fmt: skip
    return found


def _edges(values: FloatArray, *, by_sign: bool) -> npt.NDArray[np.float64]:
    """Edges of regimes of equal counts, also at 0 if `by_sign` and both signs occur."""
    edges: npt.NDArray[np.float64] = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    inner = edges[0] < 0.0 < edges[-1]
    if by_sign and inner:
        halves = (values[values < 0.0], values[values >= 0.0])
        edges = np.unique([*np.quantile(halves[0], np.linspace(0.0, 1.0, BINS // 2 + 1))[:-1], 0.0,
                           *np.quantile(halves[1], np.linspace(0.0, 1.0, BINS // 2 + 1))[1:]])  # fmt: skip
    return edges if len(edges) > 1 else np.array([edges[0], edges[0] + 1e-300])


def _joined(tests: list[_Tested]) -> list[Regime]:
    """Regimes, joined with neighbours whose means are on the same sides of 0 and of the mean everywhere."""
    joined: list[_Tested] = []
    for one in sorted(tests, key=lambda test: test.regime.low):
        before = joined[-1] if joined else one
        sides = before.regime.mean * one.regime.mean > 0.0 and before.apart * one.apart > 0.0
        if before.regime.high == one.regime.low and sides:
            joined.pop()
            count = before.count + one.count
            mean = (before.count * before.regime.mean + one.count * one.regime.mean) / count
            rate = max(before.regime.rate, one.regime.rate)
            one = replace(one, regime=replace(one.regime, low=before.regime.low, mean=mean, rate=rate), count=count)
        joined.append(one)
    return [one.regime for one in joined]
