# SPDX-License-Identifier: Apache-2.0
"""The recordings as one least-squares problem: residuals, in units of the measured noise, as a function of effects.

Each block of equations is computed once for the effects that act in it, with their parameter values.

The deviation of each residual is its standard deviation under a complete model: by the sensors' noise, estimated from
the white part of the recordings; by the uncertainty of velocity reversals and of flows; by missing rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from hydro_diagnosis.bench_parameters import available_equations, require_equation
from hydro_diagnosis.effects.base import (
    BLOCKS,
    CHANNELS,
    HYDRAULIC,
    LOAD,
    MOTION,
    PRESSURE,
    BoundedCache,
    Effect,
    EffectHypothesis,
    FloatArray,
    claims_acting_in,
)
from hydro_diagnosis.estimation.budget import CPU_COST, Budget
from hydro_diagnosis.estimation.noise import SegmentNoise, mass_attenuation, sensor_noise
from hydro_diagnosis.model.segment_model import LAG_ITERATIONS, SegmentModel
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.significance import EXCESS_THRESHOLD, FOLD_TIME, FOLDS
from hydro_sim.model.bench import Bench


@dataclass(frozen=True)
class Layout:
    """Assignment of a residual vector's entries to channels: `channel[i]` indexes `CHANNELS`."""

    channel: np.ndarray[Any, np.dtype[np.int64]]
    segment: np.ndarray[Any, np.dtype[np.int64]]
    time: FloatArray

    @classmethod
    def of(cls, blocks: Sequence[str], models: Sequence[SegmentModel]) -> Layout:
        """Return the layout of the residuals of these blocks, ordered by channel, then by segment."""
        channel, segment, time = [], [], []
        for block in blocks:
            for name in BLOCKS[block]:
                for k, model in enumerate(models):
                    at = model.block_time() if block == HYDRAULIC else model.evaluated_time()
                    channel.append(np.full(len(at), CHANNELS.index(name)))
                    segment.append(np.full(len(at), k))
                    time.append(at)
        return cls(np.concatenate(channel), np.concatenate(segment), np.concatenate(time))

    @cached_property
    def count(self) -> FloatArray:
        """Entries per channel, shape (5,)."""
        return np.bincount(self.channel, minlength=len(CHANNELS)).astype(np.float64)

    def folds(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Fold of each entry for cross-validation over blocks of `FOLD_TIME`, shape (n,)."""
        return (np.floor(self.time / FOLD_TIME).astype(np.int64) + self.segment) % FOLDS

    def squares(self, residual: FloatArray) -> FloatArray:
        """Sum of each channel's squares, shape (5,)."""
        sums = np.zeros(len(CHANNELS))
        for index, begin, end in self._stretches:
            part = residual[begin:end]
            sums[index] += part @ part
        return sums

    @cached_property
    def _stretches(self) -> list[tuple[int, int, int]]:
        """Channel, begin and end of each run of entries of one channel."""
        edges = [0, *(np.flatnonzero(np.diff(self.channel)) + 1).tolist(), len(self.channel)]
        return [(int(self.channel[begin]), begin, end) for begin, end in pairwise(edges)]


ResidualParts = dict[tuple[str, int], FloatArray]
"""Residuals by channel and segment, physical unit."""


class Problem:
    """Least-squares problem: segments, assumed bench, residuals and their deviations; only caches and budget change.

    Parameters
    ----------
    segments, bench
        Recorded stretches and the bench file.
    baseline
        Effects that the bench file contains already, part of every residual.
    noise
        Standard deviation of each sensor's noise by its channel, SI units; estimated from the segments unless given.
    like
        Problem of the same segments with all recorded rows, whose evaluated samples are used here too.
    estimated
        Start values of the bench parameters that every fit estimates.
    ruled_out
        Causes that the user has ruled out.
    budget
        Budget of work, to which every evaluation is charged.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        bench: Bench,
        baseline: Sequence[EffectHypothesis] = (),
        noise: dict[str, float] | None = None,
        like: Problem | None = None,
        estimated: Sequence[EffectHypothesis] = (),
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
        self.samples = sum(len(model.time) for model in self.models)
        have = set.intersection(*(set(model.channels) for model in self.models))
        require_equation(have, bench)
        present = {one.block for one in available_equations(have, bench)}
        self.blocks = tuple(block for block in (PRESSURE, MOTION, LOAD, HYDRAULIC) if block in present)
        self.layout = Layout.of(self.blocks, self.models)
        self.sensor_noise = noise or sensor_noise(self.models)
        """Noise of each sensor by its channel, SI units."""
        flows = PRESSURE in self.blocks
        self._noises = [SegmentNoise(model, self.sensor_noise, flows=flows) for model in self.models]
        self.noise = self._noises[0].residuals
        """Noise of the first segment's residuals by channel, physical units; others differ where their rate does."""
        self.attenuation = {}
        """Attenuation bias [SI unit] of a parameter by noise in its regressor, by effect id."""
        if MOTION in self.blocks:
            hidden = mass_attenuation(self.models, self.sensor_noise, bench.moving_mass)
            self.attenuation["moving_mass"] = hidden
        self._cache = BoundedCache(25)  # residuals of a block
        half_rows = [segment.half_rows or segment for segment in segments]
        lacking = like is None and any(segment.half_rows for segment in segments)
        self.half_rows = (
            Problem(half_rows, bench, baseline, self.sensor_noise, self, budget=self.budget) if lacking else None
        )
        """The same problem with half of the rows, if any rows are missing; else None."""
        self._weigh(())

    @property
    def aliased_resonance(self) -> float:
        """Hydraulic natural frequency [Hz] of the assumed bench if above the rows' Nyquist frequency, else 0.

        The aliased oscillation looks slow, in half of the rows as in all, and cannot be told from a law.
        """
        return max(model.aliased_resonance for model in self.models) if PRESSURE in self.blocks else 0.0

    # -- deviations ----------------------------------------------------------------------------------------------------

    def reweighted(self, claims: Sequence[EffectHypothesis]) -> Problem:
        """Return the problem with the deviations of the residuals under these effects.

        They are larger where the sign of dry friction is uncertain, or rows are missing. All else is shared, including
        caches and budget.
        """
        other = copy(self)
        other._weigh(claims)
        return other

    def for_segments(self, segments: Sequence[Segment]) -> Problem:
        """Return the same problem for other segments, with this problem's estimate of the sensors' noise."""
        return Problem(segments, self.bench, self.baseline, noise=self.sensor_noise, estimated=self.estimated,
                       budget=self.budget)  # fmt: skip

    def with_estimated(self, claims: Sequence[EffectHypothesis]) -> Problem:
        """Return the problem with other start values of the bench parameters that every fit estimates."""
        other = copy(self)
        other.estimated = tuple(claims)
        return other

    def _weigh(self, claims: Sequence[EffectHypothesis]) -> None:
        """Set the deviations under the baseline and these effects."""
        everything, doubt = (*self.baseline, *claims), list[FloatArray]()
        if MOTION in self.blocks:
            count = sum(noise.reversals for noise in self._noises)
            doubt = [noise.friction(everything, count) for noise in self._noises]
        unseen: ResidualParts = {}
        for key, change in (self._changes(claims) if self.half_rows is not None else {}).items():
            seconds = len(self.models[key[1]].time) * self.models[key[1]].step
            count = max(round(FOLD_TIME * len(change) / seconds), 1)  # root mean square around each residual
            around = uniform_filter1d(np.square(change), count, mode="nearest")
            unseen[key] = np.sqrt(np.maximum(around, 0.0))  # beside a spike its running sum may round below 0
        self.uncertainty = tuple(float(np.sum(one)) for one in (*doubt, *unseen.values()))
        """Sum of the uncertainty per segment, all zeros without any: identifies the deviations."""
        self.deviations = np.empty(len(self.layout.time))
        """Standard deviation of every residual under a complete model, physical unit, in the order of `layout`."""
        for index in np.unique(self.layout.channel):
            for k, noise in enumerate(self._noises):
                deviation: FloatArray | float = noise.residuals[CHANNELS[index]]
                if CHANNELS[index] == "motion":
                    deviation = np.hypot(deviation, doubt[k])
                if noise.flows is not None and CHANNELS[index] in BLOCKS[PRESSURE]:
                    deviation = np.hypot(deviation, noise.flows[index])
                if (CHANNELS[index], k) in unseen:
                    deviation = np.maximum(deviation, unseen[CHANNELS[index], k])
                self.deviations[(self.layout.channel == index) & (self.layout.segment == k)] = deviation

    def _changes(self, claims: Sequence[EffectHypothesis]) -> ResidualParts:
        """Change of each residual if half of the rows are left out, physical unit."""
        whole = self.parts(claims)
        fewer = self.half_rows.parts(claims) if self.half_rows is not None else whole
        return {key: fewer[key] - part for key, part in whole.items()}

    def half_rows_change(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Return the change of each residual, over its deviation, if half of the rows are left out, shape (n,)."""
        return np.concatenate([*self._changes(claims).values()]) / self.deviations

    # -- residuals -----------------------------------------------------------------------------------------------------

    def residual(self, claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Return the residual vector, each entry over its deviation, in the order of `layout`, shape (n,)."""
        self.budget.evaluations += 1  # counted also where a cache spares it: a search's effort is the same
        self.budget.spent += CPU_COST["evaluation"]
        return np.concatenate([*self.parts(claims).values()]) / self.deviations

    def join_responses(self, shown: Sequence[Mapping[str, FloatArray]], terms: int) -> dict[int, FloatArray]:
        """Return the responses of all segments, over the residuals' deviations, by channel index, (terms, residuals).

        `shown`: responses of each segment (`model.responses`), physical unit; 0 where no term acts in a channel.
        """
        found = {}
        for index, name in enumerate(CHANNELS):
            if any(name in one for one in shown):
                here = self.layout.channel == index
                counts = np.bincount(self.layout.segment[here], minlength=len(shown))
                own = [one.get(name, np.zeros((terms, count))) for one, count in zip(shown, counts, strict=True)]
                found[index] = np.concatenate(own, axis=1) / self.deviations[here]
        return found

    def parts(self, claims: Sequence[EffectHypothesis]) -> ResidualParts:
        """Residuals under the baseline and these effects, by channel and segment in the order of `layout`."""
        everything = tuple(one for one in (*self.baseline, *claims) if one.acts)
        parts: ResidualParts = {}
        errors: list[FloatArray] = []
        for block in self.blocks:
            shown = self._of_block(block, everything)
            parts |= {(name, k): one[name] for name in BLOCKS[block] for k, one in enumerate(shown)}
            errors = errors or [one["interpolation_error"] for one in shown if "interpolation_error" in one]
        if errors and MOTION in self.blocks:
            rounded = any(claim.effect.lagged_channel == "hydraulic_force" for claim in everything)
            for k, error in enumerate(errors if not rounded else ()):
                parts["motion", k] = parts["motion", k] + error
        return parts

    def _of_block(self, block: str, claims: Sequence[EffectHypothesis]) -> list[dict[str, FloatArray]]:
        there = tuple(claim for claim in claims if block in claim.effect.blocks)

        def computed(some: Sequence[EffectHypothesis]) -> list[dict[str, FloatArray]]:
            late = block == PRESSURE and any(claim.effect.lagged_channel for claim in some)
            lines = len(claims_acting_in(some, "supply", "tank")) if block == PRESSURE else 0
            times = 1.0 + LAG_ITERATIONS * late + lines + len(claims_acting_in(some, "invert_reading"))
            self.budget.spent += times * (CPU_COST[block] * self.samples + CPU_COST["segment"] * len(self.models))
            return [one.residuals(block, some) for one in self.models]

        return self._cache.get_or_compute(block, there, computed)

    # -- statistics of residuals ---------------------------------------------------------------------------------------

    def variances(self, residual: FloatArray) -> FloatArray:
        """Mean square of each channel's residual, at least 1 (the noise), shape (5,)."""
        return np.maximum(self.layout.squares(residual) / np.maximum(self.layout.count, 1.0), 1.0)

    def weight(self, residual: FloatArray) -> FloatArray:
        """Weight of each residual: 1 over the root of its channel's variance."""
        return np.sqrt(1.0 / self.variances(residual))[self.layout.channel]

    def deviance(self, residual: FloatArray) -> float:
        """-2 log likelihood up to a constant, with a channel's variance at its most likely value of 1 or more."""
        squares = self.layout.squares(residual)
        variance = np.maximum(squares / np.maximum(self.layout.count, 1.0), 1.0)
        return float(np.sum(self.layout.count * np.log(variance) + squares / variance))

    def mean_squares(self, residual: FloatArray) -> dict[str, float]:
        """Return the mean square of each channel's residuals over the noise variance."""
        squares = np.bincount(self.layout.channel, np.square(residual), len(CHANNELS))
        count = self.layout.count
        return {name: float(squares[k] / count[k]) for k, name in enumerate(CHANNELS) if count[k]}

    @property
    def noise_thresholds(self) -> dict[str, float]:
        """Thresholds of `mean_squares` above which a channel's residuals are more than noise.

        The residuals are all but independent, so the mean of n squares has variance 2 / n (chi-square): it must exceed
        1 by four standard deviations, too.
        """
        counts = {name: n for name, n in zip(CHANNELS, self.layout.count, strict=True) if n}
        return {name: 1.0 + max(EXCESS_THRESHOLD, 4.0 * float(np.sqrt(2.0 / n))) for name, n in counts.items()}

    def excess_channels(self, residual: FloatArray) -> dict[str, float]:
        """Return `mean_squares` of the channels whose residuals are more than noise."""
        limit = self.noise_thresholds
        return {name: square for name, square in self.mean_squares(residual).items() if square > limit[name]}

    def has_excess(self, residual: FloatArray) -> bool:
        """Return whether the residuals of any channel are more than noise."""
        return bool(self.excess_channels(residual))
