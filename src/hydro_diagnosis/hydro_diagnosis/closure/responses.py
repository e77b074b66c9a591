# SPDX-License-Identifier: Apache-2.0
"""Residuals that a term of an equation leaves, to first order: its own hooks, then the way through to the channels.

Many terms are carried at a time: the way is linear, so it is one filter for all rows. What a term of one equation does
by way of another is left out: this ranks terms, it fits none. The error of a pressure gauge also goes through flows,
stiffness and hydraulic balance, which are computed from its readings; only a snubber, which is no small change, is
computed as it stands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from hydro_diagnosis.effects import kernels
from hydro_diagnosis.effects.base import Claim, FloatArray, Oil
from hydro_diagnosis.effects.closure import (
    AcrossClosure,
    Closure,
    EdgeClosure,
    FlowClosure,
    GaugeClosure,
    LoadClosure,
    MotionClosure,
    PlaceClosure,
    SnubberClosure,
    ValveClosure,
)
from hydro_diagnosis.estimation.problem import CHANNELS, Problem
from hydro_diagnosis.model import chambers
from hydro_diagnosis.model.memory import RecordMemory
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.model.segment_record import OBSERVER_MEMORY, SLOPE_STEP
from hydro_diagnosis.preprocessing.smoothing import kinematics
from hydro_sim.model import equations as eq

_CHANNELS = ("pressure_a", "pressure_b")


class GaugeWays:
    """Ways of the errors of both gauges of one segment, under the claims that stand."""

    def __init__(self, model: SegmentModel, claims: Sequence[Claim]) -> None:
        self.model, self.claims, self.bench = model, claims, model.bench(claims)
        oil = model.observer.oil(claims)
        self._gain = model.step / OBSERVER_MEMORY
        self._built = model.observer.built(self.bench, oil, claims)[1]
        self._by_pressure = {name: self._sensitivity(oil, k) for k, name in enumerate(_CHANNELS)}

    def _sensitivity(self, oil: Oil, index: int) -> tuple[FloatArray, FloatArray]:
        """Change of what each sample builds in chambers A and B per change of one pressure."""
        moved = []
        for sign in (1.0, -1.0):
            pressures = list(oil.pressures)
            pressures[index] = pressures[index] + sign * SLOPE_STEP
            shifted = Oil(oil.time, oil.position, (pressures[0], pressures[1]), oil.spool, oil.velocity)
            moved.append(self.model.observer.built(self.bench, shifted, self.claims)[1])
        a, b = ((up - down) / (2.0 * SLOPE_STEP) for up, down in zip(*moved, strict=True))
        return a, b

    def of(self, terms: Sequence[Claim], channel: str) -> dict[str, FloatArray]:
        """By channel of the residuals: responses to terms of one law; physical unit, shape (terms, judged rows)."""
        shown: dict[str, list[FloatArray]] = {"pressure_a": [], "pressure_b": [], "hydraulic": []}
        area = self.bench.piston_area * (1.0 if channel == "pressure_a" else -self.bench.area_ratio)
        signal = self.model.true_signal(channel, self.claims)
        for one in terms:
            error = self.model.reading(channel, signal, [one]) - signal
            for name, built, by in zip(_CHANNELS, self._built, self._by_pressure[channel], strict=True):
                more, off = -by * chambers.middle(error), np.zeros_like(error)
                if name == channel and one.effect.nonlinear_channel == channel:
                    more = more + built * self._slope(channel, signal, one)
                elif name == channel:
                    off = -error
                shown[name].append(self.model.kept_smooth(chambers.innovations(off, more, self._gain)))
            shown["hydraulic"].append(self.model.means(area * error))
        return {name: np.stack(rows) for name, rows in shown.items()}

    def _slope(self, channel: str, signal: FloatArray, term: Claim) -> FloatArray:
        """Change of the error [-] per change of the pressure, within each sample."""
        middle = chambers.middle(signal)
        above, below = (self.model.reading(channel, middle + sign * SLOPE_STEP, [term]) for sign in (1.0, -1.0))
        return (above - below) / (2.0 * SLOPE_STEP) - 1.0


Shown = dict[str, FloatArray]
"""By channel of the residuals: physical unit, shape (terms, judged rows)."""


class Responses:
    """Ways of one segment, under the names that stand."""

    def __init__(self, problem: Problem, model: SegmentModel, claims: Sequence[Claim]) -> None:
        model = model.placed(claims)
        self.problem, self.model, self.claims = problem, model, claims
        self.bench = model.bench(claims)
        self.memory = RecordMemory(model.step, model.beside)
        if "pressure" in problem.blocks:
            self.oil = model.observer.oil(claims)
            self.stiff = chambers.compliances(self.bench, self.oil, claims)
            p_a, p_b = self.oil.pressures
            extends = kernels.substep_mean(self.oil.spool) >= 0.0
            drops = zip(*eq.edge_drops(self.bench.supply_pressure, self.bench.tank_pressure, p_a, p_b), strict=True)
            self.roots = [eq.signed_root(np.where(extends, out, back)) for out, back in drops]
        if "motion" in problem.blocks:
            self.force = model.finish(model.required_force(claims))

    def of(self, terms: Sequence[Claim]) -> Shown:
        """Responses to terms of one law."""
        effect = terms[0].effect
        assert isinstance(effect, Closure)
        if isinstance(effect, MotionClosure):
            return self._moved(np.stack([self._resisting(one) for one in terms]))
        if isinstance(effect, LoadClosure):
            return self._loaded(np.stack([self._loading(one) for one in terms]))
        if isinstance(effect, ValveClosure):
            shift = np.stack([self._commanding(one) for one in terms]) * self.bench.valve_gain
            return self._filled(shift * self.roots[0], -shift * self.roots[1])
        if isinstance(effect, FlowClosure | EdgeClosure | AcrossClosure):
            still = np.zeros_like(self.model.time), np.zeros_like(self.model.time)
            flows = [one.effect.inflows(still, self.oil, self.memory, one.values) for one in terms]
            return self._filled(np.stack([one[0] for one in flows]), np.stack([one[1] for one in flows]))
        if isinstance(effect, PlaceClosure):
            return self._displaced(terms)
        if isinstance(effect, GaugeClosure):
            return self._present(self.gauges.of(terms, effect.law.where))
        return self._read(terms, effect.law.where)

    @cached_property
    def gauges(self) -> GaugeWays:
        """Ways of a gauge's error."""
        return GaugeWays(self.model, self.claims)

    def _resisting(self, claim: Claim) -> FloatArray:
        nothing = np.zeros_like(self.model.x)
        return claim.effect.resistance(nothing, nothing, self.model.kinematics, self.memory, claim.values)

    def _loading(self, claim: Claim) -> FloatArray:
        nothing = np.zeros_like(self.model.x)
        return claim.effect.load(nothing, self.model.kinematics, self.bench, self.memory, claim.values)

    def _commanding(self, claim: Claim) -> FloatArray:
        spool = self.oil.spool
        if spool.shape[-1] == 1:
            spool = np.repeat(spool, chambers.SUBSTEPS, axis=1)
        moved = claim.effect.command(spool, self.model.step / spool.shape[-1], claim.values) - spool
        return kernels.substep_mean(moved)

    def _smooth(self, signals: FloatArray) -> FloatArray:
        return np.stack([self.model.kept_smooth(one) for one in signals])

    def _finish(self, signals: FloatArray) -> FloatArray:
        return np.stack([self.model.kept_finish(one) for one in signals])

    def _present(self, shown: Mapping[str, FloatArray | None]) -> Shown:
        blocks = {"pressure_a": "pressure", "pressure_b": "pressure"}
        return {name: one for name, one in shown.items() if one is not None
                and blocks.get(name, name) in self.problem.blocks}  # fmt: skip

    def _moved(self, force: FloatArray) -> Shown:
        return self._present({"motion": -self._finish(force)})

    def _loaded(self, force: FloatArray) -> Shown:
        return {**self._moved(force), **self._present({"load": -self._smooth(self._in_cell(force))})}

    def _filled(self, into_a: FloatArray, into_b: FloatArray) -> Shown:
        shown: dict[str, FloatArray | None] = {}
        for name, flow, stiff in (("pressure_a", into_a, self.stiff[0]), ("pressure_b", into_b, self.stiff[1])):
            if flow.any():
                built = chambers.fading_sums(flow * (stiff * self.model.step), 1.0 - self.model.step / OBSERVER_MEMORY)
                shown[name] = -self._smooth(built)
        return self._present(shown)

    def _read(self, terms: Sequence[Claim], channel: str) -> Shown:
        def read(signal: FloatArray, smoothed: bool = False) -> FloatArray:
            return np.stack([self.model.reading(channel, signal, [one], smoothed) - signal for one in terms])

        channels = self.model.channels
        if channel == "load_force":
            force = self.model.spring_force(self.bench, [], self.model.recorded)
            return self._present({"load": -self._smooth(read(force))})
        means = np.stack([self.model.means(one) for one in read(channels[channel])])
        return self._present({"motion": -read(self.force, True)[:, self.model.rows], "hydraulic": -means})

    def _displaced(self, terms: Sequence[Claim]) -> Shown:
        """Return the responses to an error of the position, but not by friction near standstill and the oil."""
        model, bench, recorded = self.model, self.bench, self.model.channels["piston_position"]
        errors = np.stack([one.effect.unmeasure("piston_position", recorded, self.memory, one.values) - recorded
                           for one in terms])  # fmt: skip
        moved = [kinematics(one, model.step, model.spacing) for one in errors]
        x, v, a = (np.stack([one[k] for one in moved]) for k in range(3))
        force = bench.moving_mass * a + bench.viscous_friction * v + bench.spring_stiffness * x
        found = self._present({"motion": -self._finish(force)})
        if "load" in self.problem.blocks:
            found |= self._present({"load": -self._smooth(self._in_cell(bench.spring_stiffness * errors))})
        if "pressure" in self.problem.blocks:
            swept = bench.piston_area * np.diff(errors, axis=1, append=errors[:, -1:]) / model.step
            found |= self._filled(-swept, bench.area_ratio * swept)
        return found

    def _in_cell(self, force: FloatArray) -> FloatArray:
        """Forces [N] behind the load cell's amplifier."""
        return np.stack([self.model.behind_cell(one, self.bench) for one in force])


def shown(
    problem: Problem, claims: Sequence[Claim], residual: FloatArray, ways: Sequence[Responses], terms: Sequence[Claim]
) -> dict[int, FloatArray]:
    """By channel: responses of its residuals, over their deviation, to terms of one law; shape (terms, residuals).

    `claims`, `residual`: of the fit beside which the terms stand.
    """
    effect = terms[0].effect
    assert isinstance(effect, Closure)
    if isinstance(effect, SnubberClosure):
        changes = np.stack([problem.residual((*claims, one)) - residual for one in terms])
        channel = problem.layout.channel
        return {int(k): changes[:, channel == k] for k in np.unique(channel)}
    parts = [way.of(terms) for way in ways]
    return {CHANNELS.index(name): _joined(problem, parts, name, len(terms)) for name in set().union(*parts)}


def _joined(problem: Problem, parts: Sequence[Shown], name: str, terms: int) -> FloatArray:
    """Responses of a channel in all segments, over their deviation; 0 in a segment in which no term acts there."""
    layout = problem.layout
    rows = [int(np.sum((layout.channel == CHANNELS.index(name)) & (layout.segment == k))) for k in range(len(parts))]
    own = [one.get(name, np.zeros((terms, count))) for one, count in zip(parts, rows, strict=True)]
    return np.concatenate([one / problem.deviation(name, k) for k, one in enumerate(own)], axis=1)
