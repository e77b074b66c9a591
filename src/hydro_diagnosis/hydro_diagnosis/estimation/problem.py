# SPDX-License-Identifier: Apache-2.0
"""The recordings as one least-squares problem: claims in, residuals in units of the measured noise out.

The deviation of each residual is what it may be off if nothing is missing: the sensors' noise, measured by the white
part of the recordings; the uncertainty of velocity reversals and of flows; rows that were not recorded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from math import hypot
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from hydro_diagnosis.bench_numbers import connected
from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, Effect, FloatArray
from hydro_diagnosis.estimation.budget import Budget
from hydro_diagnosis.estimation.equation_residuals import EquationResiduals, ResidualParts
from hydro_diagnosis.model.segment_model import BLOCKS, SegmentModel
from hydro_diagnosis.model.segment_record import BLOCK
from hydro_diagnosis.preprocessing.smoothing import (
    ACCELERATION_NOISE_GAIN,
    TOTAL_NOISE_GAIN,
    VELOCITY_NOISE_GAIN,
    white_noise,
)
from hydro_diagnosis.recording import InputError, Segment
from hydro_sim.model.bench import Bench

FOLDS = 4
"""Folds of the cross-validation of terms without a name."""
FOLD_SECONDS = 1.0
"""Length of a held-out block [s]: many times the memory of any residual."""
CHANNELS = ("pressure_a", "pressure_b", "motion", "load", "hydraulic")


@dataclass(frozen=True)
class Layout:
    """Assignment of a residual vector's entries to channels: `channel[i]` indexes `CHANNELS`."""

    channel: np.ndarray[Any, np.dtype[np.int64]]
    segment: np.ndarray[Any, np.dtype[np.int64]]
    time: FloatArray

    @classmethod
    def of(cls, blocks: Sequence[str], models: Sequence[SegmentModel]) -> Layout:
        """Return that of these blocks, channel by channel and in each segment by segment."""
        channel, segment, time = [], [], []
        for block in blocks:
            for name in BLOCKS[block]:
                for k, model in enumerate(models):
                    at = model.block_time() if block == HYDRAULIC else model.kept_time()
                    channel.append(np.full(len(at), CHANNELS.index(name)))
                    segment.append(np.full(len(at), k))
                    time.append(at)
        return cls(np.concatenate(channel), np.concatenate(segment), np.concatenate(time))

    @cached_property
    def count(self) -> FloatArray:
        """Entries per channel, shape (5,)."""
        return np.bincount(self.channel, minlength=len(CHANNELS)).astype(np.float64)

    def folds(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Fold of each entry for cross-validation over blocks of `FOLD_SECONDS`, shape (n,)."""
        return (np.floor(self.time / FOLD_SECONDS).astype(np.int64) + self.segment) % FOLDS

    def squares(self, residual: FloatArray) -> FloatArray:
        """Sum of each channel's squares, shape (5,)."""
        sums = np.zeros(len(CHANNELS))
        for index, begin, end in self._stretches:
            part = residual[begin:end]
            sums[index] += part @ part
        return sums

    @cached_property
    def _stretches(self) -> list[tuple[int, int, int]]:
        """Channel, begin and end of the stretches of one channel each."""
        edges = [0, *(np.flatnonzero(np.diff(self.channel)) + 1).tolist(), len(self.channel)]
        return [(int(self.channel[begin]), begin, end) for begin, end in pairwise(edges)]


def sensor_noise(models: Sequence[SegmentModel]) -> dict[str, float]:
    """Standard deviation of each sensor's noise in one sample, by BenchState field name, SI units.

    It does not depend on the logger: of recordings at several rates, those of the highest estimate it best.
    """
    found: dict[str, list[tuple[int, float]]] = {}
    densest = min(model.spacing for model in models)
    for model in (model for model in models if model.spacing == densest):
        measured = model.segment.measured
        recorded = slice(model.segment.phase, None, model.spacing)
        for channel, signal in _nearly_white(model).items():
            noise = white_noise(signal[recorded], None if measured is None else measured[recorded])
            found.setdefault(channel, []).append((len(signal), noise))
    return {channel: _pooled(parts) for channel, parts in found.items()}


def _pooled(parts: list[tuple[int, float]]) -> float:
    counts, deviations = np.array(parts).T
    return float(np.sqrt(np.average(np.square(deviations), weights=counts)))


def _nearly_white(model: SegmentModel) -> dict[str, FloatArray]:
    """Channels without the kinks that the nominal model knows of: the current's steps bend pressures and f_h."""
    signals = {name: model.channels[name] for name in _SENSED if name in model.channels}
    if model.has_position and model.has_pressures and "valve_current" in model.channels:
        run = model.observer.chamber_run(())
        signals["pressure_a"], signals["pressure_b"] = run.innovations
        if "hydraulic_force" in signals:
            signals["hydraulic_force"] = signals["hydraulic_force"] - np.cumsum(run.built_force) + run.built_force
    return signals


_SENSED = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position")
FLOOR = {"pressure_a": 300.0, "pressure_b": 300.0, "motion": 0.05, "load": 0.03, "hydraulic": 0.02}
"""Lower bound [Pa, N] by the residuals' own discretization (diagnosis.md, "Noise floor")."""


def residual_noise(sensors: Mapping[str, float], bench: Bench, step: float) -> dict[str, float]:
    """Standard deviation of each residual if nothing is missing, in its physical unit; `step` between recorded rows."""
    position = sensors.get("piston_position", 0.0)
    inertia = bench.moving_mass * position * ACCELERATION_NOISE_GAIN / step**2
    damping = bench.viscous_friction * position * VELOCITY_NOISE_GAIN / step
    spring = bench.spring_stiffness * position * TOTAL_NOISE_GAIN
    area = bench.piston_area
    by_pressure = hypot(area * sensors.get("pressure_a", 0.0), bench.area_ratio * area * sensors.get("pressure_b", 0.0))
    cell = sensors.get("hydraulic_force", by_pressure)
    noise = {
        "motion": hypot(cell * TOTAL_NOISE_GAIN, inertia, damping, spring),
        "load": hypot(sensors.get("load_force", 0.0) * TOTAL_NOISE_GAIN, spring),
        "hydraulic": hypot(cell, by_pressure) / (BLOCK / step) ** 0.5,
    }
    for chamber in "ab":
        noise["pressure_" + chamber] = sensors.get("pressure_" + chamber, 0.0) * TOTAL_NOISE_GAIN
    return {channel: hypot(deviation, FLOOR[channel]) for channel, deviation in noise.items()}


LEVEL = 1.0
"""Averaging time [s] of the error that missing rows may hide."""


class Noise:
    """What the sensors' noise makes of the residuals, whatever is claimed.

    `models`, `blocks`, `bench`: segments, blocks of equations that they check, and the assumed bench. `sensors`: noise
    of each sensor by its channel, SI units.
    """

    def __init__(
        self, models: Sequence[SegmentModel], blocks: Sequence[str], bench: Bench, sensors: dict[str, float]
    ) -> None:
        self.models, self.sensors = models, sensors
        self.residuals = [residual_noise(sensors, bench, model.step * model.spacing) for model in models]
        """Noise of each segment's residuals by channel, physical units."""
        self.flows = [model.observer.pressure_uncertainty(sensors) for model in models] if PRESSURE in blocks else []
        """By segment: deviations of the pressures' residuals by noise in the flows."""

    def mass_attenuation(self, mass: float) -> float:
        """Share of a moving mass [kg] that the encoder's noise hides: that of noise in the acceleration's power.

        Least squares with a noisy regressor are off by up to that (errors in variables: Fuller 1987); through the
        controller the noise is also in the motion itself, so that the exact amount is not known.
        """
        step = min(model.step * model.spacing for model in self.models)
        noise = self.sensors.get("piston_position", 0.0) * ACCELERATION_NOISE_GAIN / step**2
        power = float(np.mean(np.square(np.concatenate([model.finish(model.a) for model in self.models]))))
        return mass * noise**2 / max(power - noise**2, noise**2, 1e-12)


@dataclass(frozen=True)
class Weights:
    """Deviation of every residual under claims."""

    noise: Noise
    reversals: Sequence[FloatArray] = ()
    """By segment: force [N] in doubt because the sign of dry friction is."""
    unseen: Mapping[tuple[str, int], FloatArray] = field(default_factory=dict)
    """By channel and segment: what the rows that are missing may hide, physical unit."""
    _known: dict[tuple[str, int], FloatArray | float] = field(default_factory=dict)

    @property
    def uncertainty(self) -> tuple[float, ...]:
        """Sum of the uncertainty per segment: identifies the weights."""
        return tuple(float(np.sum(doubt)) for doubt in (*self.reversals, *self.unseen.values()))

    def deviation(self, channel: str, segment: int) -> FloatArray | float:
        """Standard deviation of a channel's residuals if nothing is missing, physical unit."""
        key = channel, segment
        if key not in self._known:
            self._known[key] = self._deviation(channel, segment)
        return self._known[key]

    def deviations(self, layout: Layout) -> FloatArray:
        """`deviation` of every residual in the order of `layout`."""
        found = np.empty(len(layout.time))
        for name in (CHANNELS[index] for index in np.unique(layout.channel)):
            for k in range(len(self.noise.models)):
                found[(layout.channel == CHANNELS.index(name)) & (layout.segment == k)] = self.deviation(name, k)
        return found

    def _deviation(self, channel: str, segment: int) -> FloatArray | float:
        deviation: FloatArray | float = self.noise.residuals[segment][channel]
        if channel == "motion":
            deviation = np.hypot(deviation, self.reversals[segment])
        if channel in ("pressure_a", "pressure_b"):
            deviation = np.hypot(deviation, self.noise.flows[segment][CHANNELS.index(channel)])
        if (channel, segment) in self.unseen:
            return np.asarray(np.maximum(deviation, self.unseen[channel, segment]))
        return deviation


def _level(model: SegmentModel, change: FloatArray) -> FloatArray:
    """Root mean square of a change over `LEVEL` seconds around each residual."""
    duration = len(model.time) * model.step
    count = max(round(LEVEL * len(change) / duration), 1)
    return np.asarray(np.sqrt(uniform_filter1d(np.square(change), count, mode="nearest")))


class Problem:
    """Segments, the assumed bench, and the weights of the residuals; only caches and the count of evaluations change.

    Parameters
    ----------
    segments, bench
        Recorded stretches and the bench file.
    baseline
        Claims that are already made.
    noise
        Of each sensor by its channel, SI units; measured in the segments unless given.
    like
        The same segments with more rows, whose judged samples are judged here too.
    estimated
        Start values of the bench numbers that every fit estimates.
    ruled_out
        Causes that the user says it cannot be.
    budget
        Of work, that every evaluation is counted in.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        bench: Bench,
        baseline: Sequence[Claim] = (),
        noise: dict[str, float] | None = None,
        like: Problem | None = None,
        estimated: Sequence[Claim] = (),
        ruled_out: Sequence[Effect] = (),
        budget: Budget | None = None,
    ) -> None:
        self.bench = bench
        self.estimated = tuple(estimated)
        self.baseline = tuple(baseline)
        self.ruled_out = tuple(ruled_out)
        self.budget = budget or Budget()
        likes = like.models if like else [None] * len(segments)
        self.models: list[SegmentModel] = [
            SegmentModel(segment, bench, one) for segment, one in zip(segments, likes, strict=True)
        ]
        self.blocks = self._checked_blocks()
        self._noise = Noise(self.models, self.blocks, bench, noise or sensor_noise(self.models))
        self.sensor_noise = self._noise.sensors
        """Noise of each sensor by its channel, SI units."""
        self.noise = self._noise.residuals[0]
        """Noise of the first segment's residuals; those of others differ where the logger's rate does (`deviation`)."""
        thinner = [segment.thinner or segment for segment in segments]
        lacking = like is None and any(segment.thinner for segment in segments)
        self.thinner = Problem(thinner, bench, baseline, self.sensor_noise, self) if lacking else None
        """The same problem from half of the rows where rows are missing; None where none are."""
        self.equations = EquationResiduals(self.models, self.blocks, self.baseline)
        self.parts, self.columns = self.equations.parts, self.equations.columns
        self.weights = self._weights(())
        self.layout = Layout.of(self.blocks, self.models)
        self.samples = sum(len(model.time) for model in self.models)
        moves = MOTION in self.blocks
        self.attenuation = {"moving_mass": self._noise.mass_attenuation(bench.moving_mass)} if moves else {}
        """By effect id: how far [SI unit] a parameter may be off because the signal that it multiplies is noisy."""

    def _checked_blocks(self) -> tuple[str, ...]:
        have = set.intersection(*(set(model.channels) for model in self.models))
        present = {one.block for one in connected(have, self.bench)}
        if not present:
            names = ", ".join(sorted(have))
            raise InputError(f"no equation can be checked with {names}: both pressures or a force are needed, too")
        return tuple(block for block in (PRESSURE, MOTION, LOAD, HYDRAULIC) if block in present)

    @property
    def unseen_ringing(self) -> float:
        """Frequency [Hz] of a mass that rings on the oil too fast for the rows of a logger; 0 where none does.

        Seen less than twice a period it looks slow, in half of the rows as in all: nothing tells it from a law.
        """
        return max(model.unseen_ringing for model in self.models) if PRESSURE in self.blocks else 0.0

    def weighed(self, claims: Sequence[Claim]) -> Problem:
        """Return the problem with residuals weighed down where these claims leave the sign of friction uncertain.

        Missing rows weigh residuals down, too. All else is shared, caches and the count of evaluations among them.
        """
        other = copy(self)
        other.weights = self._weights(claims)
        return other

    def _weights(self, claims: Sequence[Claim]) -> Weights:
        """Weights under the baseline and these claims."""
        everything, doubt = (*self.baseline, *claims), list[FloatArray]()
        if MOTION in self.blocks:
            count = sum(model.reversals for model in self.models)
            doubt = [model.kept(model.friction_uncertainty(everything, count)) for model in self.models]
        changes = self._changes(claims) if self.thinner is not None else {}
        return Weights(
            self._noise, doubt, {key: _level(self.models[key[1]], change) for key, change in changes.items()}
        )

    @property
    def uncertainty(self) -> tuple[float, ...]:
        """Sum of the uncertainty per segment, all zeros without any: identifies the weights."""
        return self.weights.uncertainty

    @property
    def evaluations(self) -> int:
        """Number of evaluations of all residuals: the measure of a search's effort."""
        return self.equations.evaluations

    def count(self, evaluations: int) -> None:
        """Count evaluations, also those that a cache has spared: a search's effort is the same."""
        self.equations.evaluations += evaluations
        self.budget.spend(self.samples * len(self.blocks), evaluations)

    def _changes(self, claims: Sequence[Claim]) -> ResidualParts:
        """Change of each residual if half of the rows are left out, physical unit."""
        whole = self.parts(claims)
        fewer = self.thinner.parts(claims) if self.thinner is not None else whole
        return {key: fewer[key] - part for key, part in whole.items()}

    def change(self, claims: Sequence[Claim]) -> FloatArray:
        """Change of each residual if half of the rows are left out, over its deviation."""
        changes = self._changes(claims).items()
        return np.concatenate([change / self.deviation(*key) for key, change in changes])

    def deviation(self, channel: str, segment: int) -> FloatArray | float:
        """Standard deviation of a channel's residuals if nothing is missing, physical unit."""
        return self.weights.deviation(channel, segment)

    def deviations(self) -> FloatArray:
        """`deviation` of every residual in the order of `layout`."""
        return self.weights.deviations(self.layout)

    def with_estimated(self, claims: Sequence[Claim]) -> tuple[Claim, ...]:
        """The claims, before them the estimated numbers that are not among them."""
        among = {claim.effect.label for claim in claims if claim.effect.estimated}
        return (*(one for one in self.estimated if one.effect.label not in among), *claims)

    def residual(self, claims: Sequence[Claim]) -> FloatArray:
        """Every residual over its noise, one vector in the order of `layout`."""
        self.count(1)
        return np.concatenate([part / self.deviation(*key) for key, part in self.parts(claims).items()])

    def joined(self, shown: Sequence[Mapping[str, FloatArray]], terms: int) -> dict[int, FloatArray]:
        """By channel: responses of its residuals, over their deviation, to so many terms; shape (terms, residuals).

        `shown`: of each segment (`model.responses`), physical unit; 0 where no term acts in a channel.
        """
        found = {}
        for index, name in enumerate(CHANNELS):
            if not any(name in one for one in shown):
                continue
            own = []
            for k, one in enumerate(shown):
                there = (self.layout.channel == index) & (self.layout.segment == k)
                own.append(one.get(name, np.zeros((terms, np.count_nonzero(there)))) / self.deviation(name, k))
            found[index] = np.concatenate(own, axis=1)
        return found
