# SPDX-License-Identifier: Apache-2.0
"""First-order responses of the residuals to a term of an equation: its hook, then linear propagation to the channels.

Many terms are propagated at a time. The influence of a term of one equation by way of another is neglected: responses
serve to rank terms, not to fit them. The error of a pressure sensor also propagates through flows, stiffness and
hydraulic balance, which are computed from its readings.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hydro_diagnosis.effects.base import (
    BLOCKS,
    SLOPE_STEP,
    ChamberInputs,
    EffectHypothesis,
    FloatArray,
    Pair,
    substep_mean,
)
from hydro_diagnosis.effects.closure import Closure
from hydro_diagnosis.effects.memory import Memory
from hydro_diagnosis.model import chambers
from hydro_diagnosis.preprocessing.smoothing import kinematics
from hydro_sim.model import equations as eq

if TYPE_CHECKING:
    from hydro_diagnosis.model.segment_model import SegmentModel

_PRESSURES = ("pressure_a", "pressure_b")
ChannelResponses = dict[str, FloatArray]
"""Responses by channel of the residuals: physical unit, shape (terms, evaluated rows)."""


class Responses:
    """Linear responses of a segment's residuals to hidden inputs, under given claims."""

    def __init__(self, model: SegmentModel, blocks: Collection[str], claims: Sequence[EffectHypothesis]) -> None:
        self.model, self.claims = model.with_true_position(claims), claims
        self.bench = self.model.bench(claims)
        self._channels = {name for block in blocks for name in BLOCKS[block]}
        self._memory = Memory(model.step, self.model.other_signals)
        self._gain = chambers.observer_gain(model.step)
        self._zeros = np.zeros_like(model.time)

    @cached_property
    def _oil(self) -> ChamberInputs:
        return self.model.oil(self.claims)

    @cached_property
    def _stiff(self) -> Pair:
        return chambers.chamber_stiffnesses(self.bench, self._oil, self.claims)

    @cached_property
    def _roots(self) -> list[FloatArray]:
        """Roots of the pressure drops [sqrt(Pa)] across the open edges of the valve at chambers A and B."""
        extends = substep_mean(self._oil.spool) >= 0.0
        drops = eq.edge_drops(self.bench.supply_pressure, self.bench.tank_pressure, *self._oil.pressures)
        return [eq.signed_root(np.where(extends, out, back)) for out, back in zip(*drops, strict=True)]

    def to_terms(self, terms: Sequence[EffectHypothesis]) -> ChannelResponses:
        """Return the responses to terms of one law or table, each at its values."""
        effect, model, zeros = terms[0].effect, self.model, self._zeros
        assert isinstance(effect, Closure)
        if effect.acts_in("opposing_force"):
            motion = model.kinematics
            return self.to_force(np.stack([one.effect.opposing_force(zeros, zeros, motion, self._memory, one.values)
                                           for one in terms]))  # fmt: skip
        if effect.acts_in("load"):
            moved, recorded = (
                np.stack([one.effect.load(zeros, motion, self.bench, self._memory, one.values) for one in terms])
                for motion in (model.kinematics, model.recorded)
            )
            return self.to_load(moved, recorded)
        if effect.acts_in("command"):
            spool = self._oil.spool
            spool = np.repeat(spool, chambers.SUBSTEPS, axis=1) if spool.shape[-1] == 1 else spool
            substep = model.step / spool.shape[-1]
            shifts = [one.effect.command(spool, Memory(substep), one.values) - spool for one in terms]
            return self.to_spool(np.stack([substep_mean(one) for one in shifts]))
        if effect.acts_in("leaks"):
            still = zeros, zeros
            flows = [one.effect.leaks(still, self._oil, self.bench, self._memory, one.values) for one in terms]
            return self.to_flows(np.stack([one[0] for one in flows]), np.stack([one[1] for one in flows]))
        if effect.is_position_error:
            return self._displaced(terms)
        if effect.acts_in("invert_reading"):
            return self._misread(terms, effect.law.where)
        return self._read(terms, effect.law.where)

    def smooth(self, signals: FloatArray) -> FloatArray:
        """Return `SegmentModel.smooth_at_evaluated` of each signal, shape (terms, evaluated rows)."""
        return np.stack([self.model.smooth_at_evaluated(one) for one in signals])

    def restrict_to_blocks(self, shown: Mapping[str, FloatArray]) -> ChannelResponses:
        """Return the responses in the channels of the chosen blocks."""
        return {name: one for name, one in shown.items() if name in self._channels}

    def to_force(self, force: FloatArray) -> ChannelResponses:
        """Responses to forces against the motion [N], shape (terms, n)."""
        return self.restrict_to_blocks(
            {"motion": -np.stack([self.model.smooth_kinematic_at_evaluated(one) for one in force])}
        )

    def to_load(self, moved: FloatArray, recorded: FloatArray) -> ChannelResponses:
        """Return the residuals' responses, by channel, shape (terms, rows), to load forces [N], shape (terms, n).

        The forces are given at the smoothed (`moved`) and at the recorded (`recorded`) motion.
        """
        shown = self.restrict_to_blocks({"load": recorded})
        return {**self.to_force(moved), **{name: -self.smooth(self._in_cell(one)) for name, one in shown.items()}}

    def to_spool(self, shift: FloatArray) -> ChannelResponses:
        """Responses to shifts of the spool [A], shape (terms, n)."""
        flow = shift * self.bench.valve_gain
        return self.to_flows(flow * self._roots[0], -flow * self._roots[1])

    def to_flows(self, into_a: FloatArray, into_b: FloatArray) -> ChannelResponses:
        """Responses to flows into both chambers [m3/s], shape (terms, n)."""
        shown = {}
        for name, flow, stiff in zip(_PRESSURES, (into_a, into_b), self._stiff, strict=True):
            if flow.any():
                increments = flow * stiff * self.model.step
                shown[name] = self.smooth(np.stack([self.observer_innovations(self._zeros, one) for one in increments]))
        return self.restrict_to_blocks(shown)

    def observer_innovations(self, off: FloatArray, increments: FloatArray) -> FloatArray:
        """Return innovations [Pa], shape (n,), of a reading's error `off` and of pressure `increments` per sample."""
        return np.asarray(chambers.innovations(off, increments, self._gain))

    def _read(self, terms: Sequence[EffectHypothesis], channel: str) -> ChannelResponses:
        def read(signal: FloatArray, smoothed: bool = False) -> FloatArray:
            return np.stack([self.model.reading(channel, signal, [one], smoothed) - signal for one in terms])

        if channel == "load_force":
            force = self.model.load_force(self.bench, [], self.model.recorded)
            return self.restrict_to_blocks({"load": -self.smooth(read(force))})
        means = np.stack([self.model.means(one) for one in read(self.model.channels[channel])])
        force = self.model.smooth_kinematic(self.model.required_force(self.claims))
        return self.restrict_to_blocks({"motion": -read(force, True)[:, self.model.rows], "hydraulic": -means})

    def _displaced(self, terms: Sequence[EffectHypothesis]) -> ChannelResponses:
        """Return the responses to an error of the position, without those by dry friction and oil volumes."""
        model, bench, recorded = self.model, self.bench, self.model.channels["piston_position"]
        errors = np.stack([one.effect.invert_reading("piston_position", recorded, self._memory, one.values) - recorded
                           for one in terms])  # fmt: skip
        moved = [kinematics(one, model.step, model.spacing) for one in errors]
        x, v, a = (np.stack([one[k] for one in moved]) for k in range(3))
        found = self.to_force(bench.moving_mass * a + bench.viscous_friction * v + bench.spring_stiffness * x)
        if "load" in self._channels:
            found["load"] = -self.smooth(self._in_cell(bench.spring_stiffness * errors))
        if "pressure_a" in self._channels:
            swept = bench.piston_area * np.diff(errors, axis=1, append=errors[:, -1:]) / model.step
            found |= self.to_flows(-swept, bench.area_ratio * swept)
        return found

    def _in_cell(self, force: FloatArray) -> FloatArray:
        """Forces [N] behind the load cell's amplifier."""
        return np.stack([self.model.behind_cell(one, self.bench) for one in force])

    def _misread(self, terms: Sequence[EffectHypothesis], channel: str) -> ChannelResponses:
        """Responses to errors of a pressure sensor."""
        model = self.model
        shown: dict[str, list[FloatArray]] = {"pressure_a": [], "pressure_b": [], "hydraulic": []}
        area = self.bench.piston_area * (1.0 if channel == "pressure_a" else -self.bench.area_ratio)
        signal = model.true_signal(channel, self.claims)
        for one in terms:
            error = model.reading(channel, signal, [one]) - signal
            for name, increments, by in zip(
                _PRESSURES, self._pressure_increments, self._by_pressure[channel], strict=True
            ):
                more, off = -by * chambers.interval_means(error), self._zeros
                if name == channel and one.effect.nonlinear_channel == channel:
                    more = more + increments * (model.reading_slope(channel, signal, [one]) - 1.0)
                elif name == channel:
                    off = -error
                shown[name].append(model.smooth_at_evaluated(self.observer_innovations(off, more)))
            shown["hydraulic"].append(model.means(area * error))
        return self.restrict_to_blocks({name: np.stack(rows) for name, rows in shown.items()})

    @cached_property
    def _pressure_increments(self) -> Pair:
        """Pressure increments [Pa] per sample in both chambers."""
        return self.model.pressure_increments(self.bench, self._oil, self.claims)[1]

    @cached_property
    def _by_pressure(self) -> dict[str, Pair]:
        """Derivatives of the pressure increments per sample in chambers A and B by each pressure."""
        found, step = {}, SLOPE_STEP * self.model.base.size.pressure
        for k, name in enumerate(_PRESSURES):
            moved = []
            for sign in (1.0, -1.0):
                pressures = list(self._oil.pressures)
                pressures[k] = pressures[k] + sign * step
                shifted = replace(self._oil, pressures=(pressures[0], pressures[1]))
                moved.append(self.model.pressure_increments(self.bench, shifted, self.claims)[1])
            a, b = ((up - down) / (2.0 * step) for up, down in zip(*moved, strict=True))
            found[name] = a, b
        return found
