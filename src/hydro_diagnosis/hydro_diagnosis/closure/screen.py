# SPDX-License-Identifier: Apache-2.0
"""Screening of unnamed terms: the first-order, held-out gain of each smooth function and law if added to a fit.

The residuals' responses to a smooth function (`grammar.CURVES`) are computed once, one for each of its splines. A law
of the same signal is a sum of these splines, wherever its threshold or level lies: so its gain if added to a fit, to
first order, follows from products of the same responses. Laws with memory or of several signals
(`grammar.MEMORY_LAWS`), or too steep for splines, have responses of their own. Gains are those of four-fold
cross-validation (`fit.cross_validated_deviance`), of each term alone. Only the best few are fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hydro_diagnosis.curves import spline_basis
from hydro_diagnosis.effects.base import CHANNELS, Effect, EffectHypothesis, FloatArray
from hydro_diagnosis.effects.closure import Closure, closure, is_closure
from hydro_diagnosis.estimation.budget import CPU_COST
from hydro_diagnosis.estimation.fit import MIN_COLUMN_LENGTH, Fit, cross_validated_deviance
from hydro_diagnosis.model.responses import Responses
from hydro_diagnosis.significance import FOLDS
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import SIGN_VELOCITY, Law, Signals
from hydro_sim.model.tables import Table

if TYPE_CHECKING:
    from hydro_diagnosis.estimation.problem import Problem


@dataclass(frozen=True)
class CandidateLaw:
    """Candidate law to be added to a fit, with its gain and start values."""

    gain: float
    """Reduction of the held-out deviance, to first order."""
    starts: tuple[EffectHypothesis, ...]
    """The law at start values of its parameters, the best first."""

    @property
    def effect(self) -> Effect:
        """The law as an effect."""
        return self.starts[0].effect


@dataclass
class _Term:
    """Columns of the residuals' responses to one term, and the laws that are sums of these columns."""

    columns: list[EffectHypothesis]
    """Splines of a smooth function, or a law at its starts; each at its noticeable size."""
    starts: list[EffectHypothesis]
    """Laws at their start values."""
    sums: FloatArray
    """Weights of the columns in the sum that is each law at its start values, shape (columns, starts)."""
    responses: dict[int, npt.NDArray[np.float32]] = field(default_factory=dict)
    """By channel, shape (columns, rows)."""
    square: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Products of the columns by fold and channel."""


class Screen:
    """Screening of all unnamed terms against the residuals of a problem.

    `problem`: the least-squares problem. `base`: fit of the named causes. `closed`: blocks that no term may act in.
    """

    def __init__(self, problem: Problem, base: Fit, closed: Collection[str] = ()) -> None:
        self.problem = problem
        layout, fold = problem.layout, problem.layout.folds()
        self._every = max(int(layout.count.max()) // 20_000, 1)  # thinning: every second, third ... residual
        kept = [np.flatnonzero(layout.channel == k)[:: self._every] for k in range(len(CHANNELS))]
        self._order = [np.argsort(fold[rows], kind="stable") for rows in kept]
        self._rows = [rows[order] for rows, order in zip(kept, self._order, strict=True)]
        self._edges = [np.searchsorted(fold[rows], np.arange(FOLDS + 1)) for rows in self._rows]
        self._count = np.array([len(rows) for rows in self._rows], dtype=np.float64)
        ways = [Responses(model, problem.blocks, (*problem.baseline, *base.claims)) for model in problem.models]
        self._terms = [one for one in self._looked_for() if not one.columns[0].effect.blocks & set(closed)]
        for term in self._terms:
            many = len(term.columns)
            shown = problem.join_responses([way.to_terms(term.columns) for way in ways], many)
            problem.budget.spent += CPU_COST["column"] * problem.samples * many
            term.square = np.zeros((FOLDS, len(CHANNELS), many, many))
            for channel, responses in shown.items():
                thinned = responses[:, :: self._every].astype(np.float32)[:, self._order[channel]]
                term.responses[channel] = thinned
                for k in range(FOLDS):
                    part = thinned[:, self._edges[channel][k] : self._edges[channel][k + 1]]
                    term.square[k, channel] = part @ part.T

    def _looked_for(self) -> list[_Term]:
        problem, found, alone = self.problem, list[_Term](), [*grammar.MEMORY_LAWS]
        for curve in grammar.CURVES:
            alone += [law for law in curve.laws if law.is_step]
            table = curve.table
            if not _visible(closure(table, problem.bench), problem):
                continue
            argument = _recorded(problem, table.where if table.variable == "force" else table.variable)
            low, high = np.percentile(argument, [0.1, 99.9]).tolist()  # without the rare values at either end
            if high > low:
                smooth = closure(table, problem.bench, (low, high))
                nothing = smooth.start_values()[0]
                columns = [EffectHypothesis(smooth, {**nothing, name: table.typical}) for name in nothing]
                shapes = [(law, start) for law in curve.laws if not law.is_step for start in self._starts(law)]
                sums = [_as_splines(table, (low, high), law, start, problem.bench) for law, start in shapes]
                found.append(_Term(columns, [start for _, start in shapes], np.stack(sums, axis=1)))
        for law in alone:
            if starts := self._starts(law):
                columns = [EffectHypothesis(one.effect, {**one.values, "coefficient": law.typical}) for one in starts]
                found.append(_Term(columns, starts, np.eye(len(starts))))
        return found

    def _starts(self, law: Law) -> list[EffectHypothesis]:
        """A law at each combination of start values of its shape parameters; thresholds within the recorded range."""
        problem, effect = self.problem, closure(law, self.problem.bench)
        if not _visible(effect, problem):
            return []
        if over := next((one.threshold_signal for one in law.shape_parameters if one.threshold_signal), ""):
            # quantiles at which thresholds are tried, between those that limit them
            shares = (0.02, 0.05, 0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85, 0.95, 0.98)
            low, *probes, high = np.quantile(_recorded(problem, over), shares).tolist()
            if over == "speed":  # drag up to less is dry friction, drag above less is viscous friction
                slowest = 3.0 * SIGN_VELOCITY
                low, probes = max(low, slowest), [one for one in probes if one > slowest]
            if not (high > low and probes):
                return []
            effect = closure(law, problem.bench, (low, high), tuple(probes))
        return [EffectHypothesis(effect, values) for values in effect.start_values()]

    def __len__(self) -> int:
        return sum(len(one.starts) for one in self._terms)

    def _products(self, found: Fit) -> tuple[FloatArray, float, FloatArray, list[FloatArray]]:
        """Products of a fit's residual and columns by fold and channel, with each other and with those of each term."""
        base = np.column_stack([found.residual, found.jacobian])
        lengths = np.maximum(np.linalg.norm(base, axis=0), MIN_COLUMN_LENGTH)
        base = base / lengths
        own = np.zeros((FOLDS, len(CHANNELS), base.shape[1], base.shape[1]))
        cross = [np.zeros((FOLDS, len(CHANNELS), base.shape[1], len(one.columns))) for one in self._terms]
        for channel, rows in enumerate(self._rows):
            for k in range(FOLDS):
                at = slice(self._edges[channel][k], self._edges[channel][k + 1])
                part = base[rows[at]]
                own[k, channel] = part.T @ part
                single = part.T.astype(np.float32)
                for term, product in zip(self._terms, cross, strict=True):
                    if channel in term.responses:
                        product[k, channel] = single @ term.responses[channel][:, at].T
        return own, float(lengths[0]) ** 2, 1.0 / self.problem.variances(found.residual), cross

    def best_laws(self, found: Fit, count: int, without: Collection[str] = ()) -> tuple[list[CandidateLaw], float]:
        """Return the `count` laws of largest gain, after ln(n) per shape parameter, and the largest possible gain."""
        own, size, weight, cross = self._products(found)
        before = cross_validated_deviance(own[..., None], weight, self._count, size)[0]
        price, by_law = float(np.log(len(found.residual))), list[tuple[float, float, list[EffectHypothesis]]]()
        width = own.shape[-1]
        for term, across in zip(self._terms, cross, strict=True):
            summed = np.einsum("im,fcij,jm->fcm", term.sums, term.square, term.sums, optimize=True)
            whole = np.empty((*own.shape[:2], width + 1, width + 1, len(term.starts)))  # one column beside the fit's
            whole[:, :, :width, :width] = own[..., None]
            whole[:, :, :width, width] = whole[:, :, width, :width] = across @ term.sums
            whole[:, :, width, width] = summed
            gains = before - cross_validated_deviance(whole, weight, self._count, size)
            labels = np.array([one.effect.label for one in term.starts])
            for label in dict.fromkeys(labels.tolist()):
                at = np.flatnonzero(labels == label)
                best = at[np.argsort(-gains[at])]
                paid = gains[best[0]] * self._every - price * (len(term.starts[best[0]].effect.parameters) - 1)
                if label not in without:
                    by_law.append((float(paid), float(gains[best[0]]) * self._every, [term.starts[k] for k in best]))
        by_law.sort(key=lambda one: -one[0])
        possible_gain = (before - float(self._count.sum())) * self._every
        return [CandidateLaw(gain, _distinct_starts(starts)) for _, gain, starts in by_law[:count]], possible_gain

    def best_smooth_function(
        self, found: Fit, without: Collection[str] = ()
    ) -> tuple[EffectHypothesis | None, float, float]:
        """Return the smooth function of largest gain if added to a fit, its gain, and the largest possible gain."""
        own, size, weight, cross = self._products(found)
        before = cross_validated_deviance(own[..., None], weight, self._count, size)[0]
        best, gain = None, 0.0
        for term, across in zip(self._terms, cross, strict=True):
            effect = term.columns[0].effect
            if is_closure(effect) and isinstance(effect.law, Table) and effect.label not in without:
                whole = np.block([[own, across], [across.swapaxes(-1, -2), term.square]])
                gained = before - cross_validated_deviance(whole[..., None], weight, self._count, size)[0]
                if gained > gain:
                    best, gain = EffectHypothesis(effect, effect.start_values()[0]), gained
        return best, gain * self._every, (before - float(self._count.sum())) * self._every


def _as_splines(
    table: Table, limits: tuple[float, float], law: Law, start: EffectHypothesis, bench: Bench
) -> FloatArray:
    """Weights of a smooth function's columns in the sum that is a law at its start values, shape (columns,)."""
    share = np.asarray(np.linspace(0.0, 1.0, 100), dtype=np.float64)  # several between any two knots
    grid = limits[0] + (limits[1] - limits[0]) * share
    ones = {"velocity": 1.0, "pressure_b" if table.factor and table.factor.text == "p_b" else "pressure_a": 1.0}
    argument = {"speed": "velocity", "pressure_difference": "pressure_a"}.get(table.variable, table.variable)
    at = Signals(**{**ones, argument: np.maximum(grid, 1e-6) if table.variable == "speed" else grid})
    values = law.value(at, bench, [law.typical, *(start.values[one.name] for one in law.shape_parameters)])
    values = np.asarray(np.broadcast_to(values / (table.factor.shape(at) if table.factor else 1.0), grid.shape))
    return np.asarray(np.linalg.lstsq(spline_basis(share), values, rcond=None)[0] / table.typical)


def _distinct_starts(starts: Sequence[EffectHypothesis]) -> tuple[EffectHypothesis, ...]:
    """The best start; of a law with several shape parameters, the best at each of up to three values of the first."""
    names = [one.name for one in starts[0].effect.shapes]
    if len(names) < 2:
        return tuple(starts[:1])
    found: dict[float, EffectHypothesis] = {}
    for one in starts:
        found.setdefault(one.values[names[0]], one)
    return tuple(found.values())[:3]


_SIGNED_VARIABLES = {"speed": "velocity", "opening": "current"}


def _recorded(problem: Problem, name: str) -> FloatArray:
    """Recorded values of a signal that is an argument of laws and smooth functions."""
    values = np.concatenate(
        [model.variable(_SIGNED_VARIABLES.get(name, name))[model.settle :] for model in problem.models]
    )
    return np.abs(values) if name in _SIGNED_VARIABLES else values


_VARIABLE_CHANNELS = {
    "current": "valve_current",
    "position": "piston_position",
    "velocity": "piston_position",
    "acceleration": "piston_position",
}
"""Recorded channels of the signals that are no channels themselves."""


def _visible(effect: Closure, problem: Problem) -> bool:
    """Whether the term's equation has residuals, and all of its signals were recorded."""
    have = set.intersection(*(set(model.channels) for model in problem.models))
    if (effect.is_position_error or effect.depends_on_acceleration) and len(effect.blocks & set(problem.blocks)) < 2:
        return False  # in one equation alone it cannot be told from a force
    needed = {_VARIABLE_CHANNELS.get(one, one) for one in effect.law.uses} - {"time"}
    return bool(effect.blocks & set(problem.blocks)) and needed | ({effect.law.where} - {"", "edges", "across"}) <= have
