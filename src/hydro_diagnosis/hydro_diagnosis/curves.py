# SPDX-License-Identifier: Apache-2.0
"""Missing force as an additive model of the motion, estimated from the recordings before any cause is named.

In the band of the recorded motion the force that the bench file does not explain is an additive model (Hastie and
Tibshirani 1990), fitted jointly, so that one curve does not leak into another::

    missing = cell( g(speed, direction) s(position) + m acceleration + h(position) + constant )

`g` is piecewise linear in the speed, for each direction, with a smoothness penalty (P-splines: Eilers and Marx 1996);
`s` is the direction of motion, behind a play and an elastic rise where there is memory (Dahl 1968); `cell` is the
identity, or the low-pass of a slow force cell. A term or an operator joins if it halves the held-out RMS over strokes.
Standard errors are clustered by stroke (sandwich), and by recording where there are three. Samples at rest, and at
turns of the piston, are no evidence of friction: the points of the curve exclude them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt, welch

from hydro_core.signals import FloatArray
from hydro_diagnosis.effects.base import EffectHypothesis
from hydro_diagnosis.effects.memory import Memory
from hydro_diagnosis.significance import COVERAGE_FACTOR, FOLDS, ITERATIONS, PRACTICAL_SHARE, TIE_RATIO
from hydro_sim.model.equations import LOAD_CELL_DAMPING
from hydro_sim.model.tables import KNOTS

if TYPE_CHECKING:
    from hydro_diagnosis.model.segment_model import SegmentModel

SAMPLES_PER_PERIOD = 16.0
"""Samples per period of the cut-off."""
STANDSTILL_SHARE = 0.03
"""Share of the top speed below which the piston is at rest: a tenth of a decade above the band's resolution of a turn.
"""
SPEED_KNOT_RATIO = 1.4
"""Ratio of neighbouring knots over the speed: eleven per direction, from about `STANDSTILL_SHARE` to the top speed."""
MAX_RISE = 0.3
"""Largest distance of an elastic rise, as a share of the stroke: beyond, the piston would hardly ever slide."""
SMOOTHING_WEIGHT = 0.03
"""Factor of the smoothness penalties on first differences over the speed and second ones over the position, relative to
the root of the samples' total weight."""
ROUGHNESS_THRESHOLD = 2.5
"""Ratio of the most flexible curve's residual to the force's white noise above which recordings are rough: 3.1 and more
on 24 of 26 real rigs, at most 1.8 on drawn ones whose causes are shapes of the motion
(docs/reports/real_recordings.md)."""


def motion_bandwidth(position: FloatArray, step: float) -> float:
    """Return the cut-off [Hz] of a position's motion, sampled every `step` [s], low enough for its speed's noise."""
    frequency, power = welch(
        position - position.mean(), 1.0 / step, nperseg=min(len(position), max(256, len(position) // 2)),
        detrend="linear",
    )  # fmt: skip
    noise = float(np.median(power[frequency > 0.35 / step])) + 1e-30
    clean = np.cumsum(np.maximum(power - 3.0 * noise, 0.0))
    motion = float(frequency[min(np.searchsorted(clean, 0.999 * clean[-1]), len(frequency) - 1)])
    period = max(int(0.1 / max(motion, 1e-9) / step), 1)
    speed = float(np.std(np.diff(position[::period]))) * motion / 0.1
    quiet = (3.0 * (PRACTICAL_SHARE * speed) ** 2 / (4.0 * np.pi**2 * noise)) ** (
        1.0 / 3.0
    )  # up to there the speed's noise is small
    within = min(5.0 * motion, quiet)  # with the motion's harmonics, which friction excites
    return float(np.clip(within, min(40.0 / (len(position) * step), 0.2 / step), 0.2 / step))


class Motion:
    """Recorded motion and force, low-passed and resampled at `SAMPLES_PER_PERIOD` per period of the cut-off.

    Attributes
    ----------
    position, velocity, acceleration
        SI units, shape (n,).
    measured, modelled
        Force [N] of the cell or of the pressures, and its part that the bench file explains, shape (n,).
    noise
        Standard deviation [N] of the force's white noise in the band.
    """

    def __init__(self, models: Sequence[SegmentModel], baseline: Sequence[EffectHypothesis] = ()) -> None:
        first = models[0]
        self.models = list(models)
        bench, step = first.base, first.step * first.spacing
        place, raw = (
            np.concatenate([part[one.segment.phase :: one.spacing] for one, part in zip(models, parts, strict=True)])
            for parts in ([one.channels["piston_position"] for one in models], [one.driving_force for one in models])
        )
        self.recording = first.segment.recording
        self.mass = bench.moving_mass
        self.band = motion_bandwidth(place, step)
        every = max(int(1.0 / (SAMPLES_PER_PERIOD * self.band * step)), 1)
        self.step = step * every
        position, force = (self.low_pass(one, step)[::every] for one in (place, raw))
        self.position, self.measured = position, force
        self.velocity = np.gradient(position, self.step)
        self.acceleration = np.gradient(self.velocity, self.step)
        self.modelled = (
            bench.moving_mass * self.acceleration
            + bench.viscous_friction * self.velocity
            + bench.spring_stiffness * (position - bench.spring_rest_position)
        )
        if baseline:  # effects of an earlier diagnosis in the bench file
            self.modelled = self.modelled + self.force_of((), baseline)
        frequency, power = welch(raw, 1.0 / step, nperseg=min(len(raw), 1024))
        self.noise = float(np.sqrt(np.median(power[frequency > 0.35 / step]) * self.band))
        self.memory = Memory(self.step)

    def low_pass(self, signals: FloatArray, step: float) -> FloatArray:
        """Return signals, sampled every `step` [s], after a zero-phase low-pass at the cut-off, shape (n, ...)."""
        order, reach = butter(4, self.band, fs=1.0 / step, output="sos"), int(3 / (self.band * step))
        return np.asarray(sosfiltfilt(order, signals, axis=0, padlen=min(len(signals) - 1, reach)))

    def force_of(self, baseline: Sequence[EffectHypothesis], claims: Sequence[EffectHypothesis]) -> FloatArray:
        """Return the force [N] that claims add to that required by the recorded motion, low-passed, shape (n,)."""
        parts = [
            (one.required_force((*baseline, *claims)) - one.required_force(baseline))[one.segment.phase :: one.spacing]
            for one in self.models
        ]
        whole = np.concatenate(parts)
        step = self.models[0].step * self.models[0].spacing
        return self.low_pass(whole, step)[:: max(round(self.step / step), 1)]

    def motion_masks(self, top: float) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Return masks of evaluated samples in motion, with and without turns, shape (n,); `top`: top speed [m/s]."""
        period = 1.0 / (self.band * self.step)
        slow = np.abs(self.velocity) < STANDSTILL_SHARE * top
        rest = _share(_share(~slow, 0.25 * period) < 0.5, 0.75 * period) > 1e-9
        turning = (_share(slow, 0.15 * period) > 0.0) | (
            np.abs(self.acceleration) > np.pi * self.band * np.abs(self.velocity)
        )
        edge, there = int(0.5 * period), np.zeros(len(slow), dtype=bool)
        there[edge : len(slow) - edge : 2] = True  # 8 to a period of the cut-off
        return there & ~rest, there & ~rest & ~turning

    def stroke_numbers(self, top: float) -> npt.NDArray[np.int64]:
        """Return the index of each sample's stroke, from one turn to the next, shape (n,).

        A stroke lasts five periods of the cut-off (one of the motion) at most: errors farther apart are independent.
        """
        moving = np.flatnonzero(np.abs(self.velocity) > STANDSTILL_SHARE * top)
        turns = np.zeros(len(self.velocity), dtype=np.int64)
        turns[moving[1:][np.diff(np.sign(self.velocity[moving])) != 0.0]] = 1
        stroke = np.cumsum(turns)
        first = np.searchsorted(stroke, stroke)
        since = (np.arange(len(stroke)) - first) * self.step * self.band
        return stroke * 1000 + np.minimum(since / 5.0, 999.0).astype(np.int64)


def motions(models: Sequence[SegmentModel], baseline: Sequence[EffectHypothesis] = ()) -> list[Motion]:
    """Return one motion per gapless part of a recording: consecutive segments are joined.

    `baseline`: effects that the bench file contains in addition to its parameters.
    """
    groups: list[list[SegmentModel]] = []
    for one in models:
        last = groups[-1][-1].segment if groups else one.segment
        apart = abs(last.start + last.step * len(last) - one.segment.start)
        if last.recording == one.segment.recording and apart < 0.5 * last.step:
            groups[-1].append(one)
        else:
            groups.append([one])
    return [Motion(group, baseline) for group in groups]


def _share(there: npt.NDArray[np.bool_], reach: float) -> FloatArray:
    """Share of the samples within `reach` of each sample for which a mask is true."""
    width = 2 * int(reach) + 1
    return np.convolve(there, np.full(width, 1.0 / width), "same")


@dataclass(frozen=True)
class Terms:
    """Terms and operators of the additive model other than the curve over the speed."""

    mass: bool = False
    position: str = ""
    """Force over the position: `straight`, `curved`, or empty: none."""
    play: float = 0.0
    """Width [m] of a play ahead of the friction; 0: none."""
    presliding_distance: float = 0.0
    """Distance [m] of the elastic rise to the sliding force, extrapolated from its initial slope; 0: no rise."""
    prandtl: bool = False
    """Whether the rise is linear up to the sliding force (Prandtl), not exponential (Dahl)."""
    cell_bandwidth: float = 0.0
    """Bandwidth [Hz] of the force cell's low-pass; 0: none."""


@dataclass(frozen=True, kw_only=True)
class Design:
    """Regression of the additive model over all recordings: design matrix, target, and signals of each row."""

    columns: FloatArray
    """Design matrix, shape (n, k): hat functions of the speed by direction, position terms, acceleration, constant."""
    missing: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    position: FloatArray
    sign: FloatArray
    """Direction of motion, -1 to 1, after its play and rise."""
    stroke: npt.NDArray[np.int64]
    recording: npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Point:
    """Point of the force curve: missing force at a velocity."""

    velocity: float
    """Velocity [m/s], with its sign."""
    force: float
    """Missing force [N], without the terms of position and acceleration."""
    error: float
    """Standard error [N] between strokes, or between recordings."""
    strokes: int


CurveSamples = tuple[tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]], npt.NDArray[np.int64], FloatArray]
"""Samples of a recording: masks of `Motion.motion_masks`, indices of strokes, and hat functions of the speed."""


class ForceCurve:
    """Additive model of the missing force, fitted to recordings.

    Parameters
    ----------
    motions
        Motions of the fitted recordings.
    terms
        Terms of the model; chosen by held-out RMS if not given.
    """

    def __init__(self, motions: Sequence[Motion], terms: Terms | None = None) -> None:
        self.motions = list(motions)
        self.top_speed = max(float(np.percentile(np.abs(one.velocity), 95)) for one in motions)
        """Top speed [m/s]."""
        self.limits = min(float(m.position.min()) for m in motions), max(float(m.position.max()) for m in motions)
        self.stroke = float(np.median([np.ptp(one.position) for one in motions]))
        """Median range [m] of the recordings' positions."""
        count = int(np.ceil(np.log(1.0 / STANDSTILL_SHARE) / np.log(SPEED_KNOT_RATIO)))
        self.knots = np.concatenate([[0.0], self.top_speed * SPEED_KNOT_RATIO ** np.arange(1 - count, 2.0)])
        """Knots [m/s] of the curve, which is linear between them."""
        self._samples: dict[int, CurveSamples] = {}
        self.rivals: list[Terms] = []
        """Alternatives to the chosen terms that fit as well."""
        self.terms = self._chosen() if terms is None else terms
        design = self.design(self.terms, self.motions, sliding=True)
        weight = np.ones(len(design.missing))
        for _ in range(ITERATIONS):
            values = self._solved(design, weight, self.terms)
            left = design.missing - design.columns @ values
            size = 1.483 * float(np.median(np.abs(left))) + 1e-30
            weight = np.minimum(1.0, COVERAGE_FACTOR * size / np.maximum(np.abs(left), 1e-30))
        self.values, self.sliding, self.weight, self.residual = values, design, weight, left

    # -- choice of terms -----------------------------------------------------------------------------------------------

    def _chosen(self) -> Terms:
        terms = Terms()
        left = self.held_out_rms(terms)
        while True:
            best: list[tuple[float, Terms]] = []
            for kind in self._further(terms):
                played = bool(kind) and kind[0].play > terms.play
                if kind and not (played and min(one for one, _ in best) > TIE_RATIO * left):
                    best.append(self._best(kind))
            least = min((one for one, _ in best), default=np.inf)
            if not least < 0.5 * left:  # a term joins if it halves what is left
                bent = terms.position == "straight" and self.position_confounded
                bent = bent and even_share(ForceCurve(self.motions, terms).points) > 1.0
                return replace(terms, position="curved") if bent else terms
            alike = [one for one in best if TIE_RATIO * one[0] <= least]
            self.rivals += [other for _, other in alike[1:]]
            left, terms = alike[0]

    def _best(self, kind: Sequence[Terms]) -> tuple[float, Terms]:
        """Return the least held-out RMS [N] of a kind of terms, the rise refined, and the terms."""
        left, terms = min(((self.held_out_rms(one), one) for one in kind), key=lambda one: one[0])
        if not terms.presliding_distance:
            return left, terms
        found = minimize_scalar(
            lambda log: self.held_out_rms(replace(terms, presliding_distance=float(np.exp(log)))),
            bounds=(np.log(terms.presliding_distance / 3.0),
                    np.log(min(terms.presliding_distance * 3.0, MAX_RISE * self.stroke))), method="bounded",
            options={"maxiter": 8},
        )  # fmt: skip
        finer = replace(terms, presliding_distance=float(np.exp(found.x)))
        return (float(found.fun), finer) if found.fun < left else (left, terms)

    def _further(self, terms: Terms) -> Iterator[list[Terms]]:
        """Further terms, kind by kind, the most usual first."""
        beginning = not (terms.presliding_distance or terms.cell_bandwidth)
        cell = beginning and all("hydraulic_force" in one.channels for motion in self.motions for one in motion.models)
        rises = [
            replace(terms, presliding_distance=share * self.stroke)
            for share in (0.003, 0.01, 0.03, MAX_RISE / 3.0, MAX_RISE)
            if beginning
        ]
        yield rises
        yield [replace(one, prandtl=True) for one in rises]
        yield [replace(one, play=play * self.stroke) for one in rises for play in (0.05, 0.1, 0.2, 0.3)]
        position = {"": "straight", "straight": "curved", "curved": ""}[terms.position]
        bent = position == "curved" and self.position_confounded
        yield [replace(terms, position=position)] if position and not bent else []
        yield [replace(terms, mass=True)] if not terms.mass else []  # after its look-alike in sines of one frequency
        yield [replace(terms, cell_bandwidth=share * self.motions[0].band) for share in (0.25, 0.5, 1.0, 2.0) if cell]

    @cached_property
    def position_confounded(self) -> bool:
        """Whether curvature over the position cannot be told from the curve over the speed, as in equal strokes.

        Then the mean at each speed leaves less than a fifth of the bend's variance. A force that is the same both ways
        and varies more than friction is then taken for one over the position, and friction as equal both ways.
        """
        design = self.design(Terms(), self.motions)
        bend = np.square(self.relative_position(design.position) - 0.5)
        place = np.sign(design.velocity) * (1 + self.nearest_knot(np.abs(design.velocity)))
        _, index = np.unique(place, return_inverse=True)
        means = np.bincount(index, bend) / np.bincount(index)
        return bool(np.var(bend - means[index]) < 0.2 * np.var(bend))

    def held_out_rms(self, terms: Terms) -> float:
        """Return the held-out RMS [N] of the fit, by folds of strokes; inf if the moving mass became negative."""
        design = self.design(terms, self.motions)
        if terms.mass and self._solved(design, np.ones(len(design.missing)), terms)[-2] < -self.motions[0].mass:
            return float(np.inf)  # no body weighs less than nothing
        return float(np.sqrt(np.mean(np.square(self._held_out(design, terms)))))

    def _held_out(self, design: Design, terms: Terms) -> FloatArray:
        """Return the residual [N] of each row under the fit to the strokes of the other folds."""
        names, stroke = np.unique(design.stroke, return_inverse=True)
        fold = stroke % FOLDS if len(names) >= FOLDS else np.arange(len(stroke)) * FOLDS // len(stroke)
        off = np.array(design.missing)
        for one in range(FOLDS):
            there = fold == one
            if there.any() and not there.all():
                values = self._solved(design, (~there).astype(float), terms)
                off[there] -= design.columns[there] @ values
        return off

    # -- least squares -------------------------------------------------------------------------------------------------

    def nearest_knot(self, speed: FloatArray) -> npt.NDArray[np.int64]:
        """Return the index of the knot nearest by ratio to each speed [m/s], shape (n,); 0 below the others."""
        return np.searchsorted(self.knots[1:] / SPEED_KNOT_RATIO**0.5, speed)

    def hat_basis(self, speed: FloatArray) -> FloatArray:
        """Return the hat functions of the knots at each speed [m/s], shape (n, knots)."""
        return np.stack([np.interp(speed, self.knots, one) for one in np.eye(len(self.knots))], axis=-1)

    def _samples_of(self, motion: Motion) -> CurveSamples:
        """Masks, stroke indices and hat functions of a recording, independent of the terms and computed once."""
        if id(motion) not in self._samples:
            hats = self.hat_basis(np.abs(motion.velocity))
            self._samples[id(motion)] = motion.motion_masks(self.top_speed), motion.stroke_numbers(self.top_speed), hats
        return self._samples[id(motion)]

    def design(self, terms: Terms, motions: Sequence[Motion], *, sliding: bool = False) -> Design:
        """Return the regression of some recordings; `sliding`: without turns and unfinished elastic rises."""
        parts: list[dict[str, npt.NDArray[Any]]] = []
        for number, one in enumerate(motions):
            judged, stroke, hats = self._samples_of(one)
            there = judged[1 if sliding else 0]
            sign, cell = self._sign(one, terms), self._cell(one, terms)
            sides = (np.maximum(sign, 0.0), np.minimum(sign, 0.0))
            speeds = np.concatenate([side[:, None] * hats for side in sides], axis=1)
            bends, share = list[FloatArray](), self.relative_position(one.position)
            if terms.position:
                bends = [share - 0.5] if terms.position == "straight" else list(centred_splines(share)[:, 1:].T)
            further = np.column_stack([*bends, *([one.acceleration] if terms.mass else []), np.ones(len(sign))])
            columns = np.concatenate([one.low_pass(cell(speeds), one.step), cell(further)], axis=1)
            if sliding:  # an elastic rise must be complete
                there = there & (np.abs(sign) > 0.9)
            rows = {
                "columns": columns, "missing": one.measured - cell(one.modelled), "velocity": one.velocity,
                "acceleration": one.acceleration, "position": one.position, "sign": sign,
                "stroke": stroke + number * 10**9, "recording": np.full(len(sign), number),
            }  # fmt: skip
            parts.append({name: row[there] for name, row in rows.items()})
        return Design(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})

    def _sign(self, motion: Motion, terms: Terms) -> FloatArray:
        position = motion.memory.play(motion.position, terms.play) if terms.play else motion.position
        if not terms.presliding_distance:  # the mean over the sample, in whose middle the piston may turn
            half = 0.5 * motion.step * np.abs(motion.acceleration) + 1e-300
            return np.clip(motion.velocity / half, -1.0, 1.0)
        if terms.prandtl:
            return (
                position - motion.memory.play(position, 2.0 * terms.presliding_distance)
            ) / terms.presliding_distance
        return motion.memory.bristle(position, 1.0 / terms.presliding_distance, np.ones(len(position)))

    @staticmethod
    def _cell(motion: Motion, terms: Terms) -> Callable[[FloatArray], FloatArray]:
        if not terms.cell_bandwidth:
            return lambda signals: signals
        return lambda signals: motion.memory.low_pass(signals, terms.cell_bandwidth, LOAD_CELL_DAMPING)

    def relative_position(self, position: FloatArray) -> FloatArray:
        """Position over the recorded range, 0 to 1."""
        return np.clip((position - self.limits[0]) / max(self.limits[1] - self.limits[0], 1e-12), 0.0, 1.0)

    def _normal(self, design: Design, weight: FloatArray, terms: Terms) -> FloatArray:
        """Inverse of the normal matrix, with the smoothness penalties."""
        columns, speeds = design.columns, len(self.knots)
        curved = terms.position == "curved"
        tied = speeds if curved and self.position_confounded else 0
        held = np.zeros((2 * (speeds - 1) + (KNOTS - 2 if curved else 0) + tied, columns.shape[1]))
        for row, k in enumerate([*range(speeds - 1), *range(speeds, 2 * speeds - 1)]):
            held[row, k], held[row, k + 1] = -SMOOTHING_WEIGHT, SMOOTHING_WEIGHT
        for row, k in zip(range(len(held) - tied, len(held)), range(tied), strict=True):  # friction alike both ways
            held[row, k], held[row, speeds + k] = 1.0, -1.0
        for k, row in enumerate(range(2 * (speeds - 1), len(held) - tied)):  # the first spline has the coefficient 0
            at = 2 * speeds + np.arange(k - 1, k + 2)
            held[row, at[at >= 2 * speeds]] = SMOOTHING_WEIGHT * np.array([1.0, -2.0, 1.0])[at >= 2 * speeds]
        held = held * np.sqrt(weight.sum())
        normal = (columns * weight[:, None]).T @ columns + held.T @ held
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        size = np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(normal / size, rcond=1e-12, hermitian=True)) / size

    def _solved(self, design: Design, weight: FloatArray, terms: Terms) -> FloatArray:
        return np.asarray(self._normal(design, weight, terms) @ (design.columns.T @ (weight * design.missing)))

    def predicted(
        self, motion: Motion, shape: Callable[[FloatArray, FloatArray], FloatArray], terms: Terms
    ) -> FloatArray:
        """Return the force [N] predicted by a shape and terms for a recording, after band and cell, shape (n,).

        `shape`: force over the velocity [m/s] and the direction after its memory (-1 to 1), shape (n,) each.
        """
        force = shape(motion.velocity, self._sign(motion, terms))
        if terms.mass:
            force = force + self.mass[0] * motion.acceleration
        if terms.position:
            force = force + spline_basis(self.relative_position(motion.position)) @ self.over_position
        return self._cell(motion, terms)(motion.low_pass(force, motion.step))

    def missing_force(self, motion: Motion) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        """Return the missing force [N] of a recording, and the mask of evaluated samples, shape (n,) each.

        Rests are excluded, and turns too unless a memory of the direction is part of the model.
        """
        there = motion.motion_masks(self.top_speed)[0 if self.terms.presliding_distance else 1]
        return motion.measured - self._cell(motion, self.terms)(motion.modelled), there

    @classmethod
    def over_speed(cls, motions: Sequence[Motion]) -> ForceCurve:
        """Return the model with the curve over the speed alone."""
        return cls(motions, Terms())

    # -- results -------------------------------------------------------------------------------------------------------

    @cached_property
    def covariances(self) -> list[FloatArray]:
        """Covariances of the coefficients, clustered by stroke (sandwich), and by recording where there are three."""
        inverse = self._normal(self.sliding, self.weight, self.terms)
        scores = self.sliding.columns * (self.weight * self.residual)[:, None]
        found = []
        for group in [self.sliding.stroke, *([self.sliding.recording] if len(self.motions) >= 3 else [])]:
            names, index = np.unique(group, return_inverse=True)
            summed = np.zeros((len(names), scores.shape[1]))
            np.add.at(summed, index, scores)
            moves = summed @ inverse
            found.append(np.asarray(moves.T @ moves) * len(names) / max(len(names) - 1, 1))
        return found

    def error(self, row: FloatArray) -> float:
        """Return the standard error of a linear combination `row` of the coefficients, shape (k,): the largest one."""
        return float(np.sqrt(max(row @ one @ row for one in self.covariances)))

    @cached_property
    def points(self) -> list[Point]:
        """Points of the curve over the speed, where at least two strokes have samples, by ascending velocity."""
        design, count, found = self.sliding, len(self.knots), []
        place = self.nearest_knot(np.abs(design.velocity))
        for side in (1.0, -1.0):
            for k in range(count):
                here = (np.sign(design.velocity) == side) & (place == k)
                strokes = len(np.unique(design.stroke[here]))
                rising = np.count_nonzero(here & (design.acceleration * side > 0.0))
                alone = min(rising, np.count_nonzero(here) - rising) < 0.1 * np.count_nonzero(here)
                if strokes < 2 or (alone and self.terms.presliding_distance):
                    continue  # after an elastic rise, the rest of a stroke only decelerates
                row, at = np.zeros(len(self.values)), float(design.velocity[here].mean())
                first = 0 if side > 0.0 else count
                row[first : first + count], row[-1] = side * self.hat_basis(np.array([abs(at)]))[0], 1.0
                found.append(Point(velocity=at, force=float(row @ self.values),
                                   error=self.error(row), strokes=strokes))  # fmt: skip
        return sorted(found, key=lambda point: point.velocity)

    def point_means(self, signals: Sequence[FloatArray]) -> list[float]:
        """Return the mean of one signal per motion over the samples of each point, in the order of `points`."""
        there = [one.motion_masks(self.top_speed)[1] for one in self.motions]
        values, speed = (
            np.concatenate([one[here] for one, here in zip(parts, there, strict=True)])
            for parts in (signals, [one.velocity for one in self.motions])
        )
        place, sign = self.nearest_knot(np.abs(speed)), np.sign(speed)
        return [
            float(
                np.mean(
                    values[
                        (place == self.nearest_knot(np.array([abs(one.velocity)]))[0]) & (sign == np.sign(one.velocity))
                    ]
                )
            )
            for one in self.points
        ]

    @property
    def mass(self) -> tuple[float, float]:
        """Missing mass [kg] and its standard error; 0 without that term."""
        k = len(self.values) - 2
        return (float(self.values[k]), self.error(np.eye(len(self.values))[k])) if self.terms.mass else (0.0, 0.0)

    @cached_property
    def over_position(self) -> FloatArray:
        """Coefficients [N] of the `KNOTS` splines over the position, of mean 0; zeros without that term."""
        first = 2 * len(self.knots)
        if self.terms.position == "straight":
            return np.asarray(self.values[first] * ((np.arange(KNOTS) - 1.0) / (KNOTS - 3.0) - 0.5))
        if self.terms.position == "curved":
            values = np.concatenate([[0.0], self.values[first : first + KNOTS - 1]])
            return np.asarray(values - SPLINE_MEANS @ values)
        return np.zeros(KNOTS)

    @property
    def opposing_share(self) -> float:
        """Share of the sliding samples, or of the strokes, in which the force over the speed opposes the motion.

        The larger of both: noise may hide the force in samples, not in the means of strokes. Of less than ten strokes
        chance makes such a share.
        """
        design, first = self.sliding, 2 * len(self.knots)
        force = design.missing - design.columns[:, first:-1] @ self.values[first:-1] - middle_force(self.points)
        opposing, side = force * np.sign(design.velocity), design.velocity > 0.0
        _, stroke = np.unique(2 * design.stroke + side, return_inverse=True)
        means = np.bincount(stroke, opposing)
        by_stroke = float(np.mean(means > 0.0)) if len(means) >= 10 else 0.0
        return max(float(np.mean(opposing > 0.0)), by_stroke)

    @property
    def rough(self) -> bool:
        """Whether even the most flexible curve leaves far more than noise, so that named causes cannot explain it all.

        By the median of the held-out residuals, so that single strokes do not decide.
        """
        terms = Terms(mass=True, position="curved")
        off = np.abs(self._held_out(self.design(terms, self.motions, sliding=True), terms))
        noise = float(np.sqrt(np.mean(np.square([one.noise for one in self.motions]))))
        return 1.483 * float(np.median(off)) / noise > ROUGHNESS_THRESHOLD


def middle_force(points: Sequence[Point]) -> float:
    """Return the force [N] midway between both directions, such as a weight; 0 if all motion is one way."""
    sides = [[point.force for point in points if point.velocity * side > 0.0] for side in (1.0, -1.0)]
    return 0.5 * sum(float(np.mean(side)) for side in sides) if all(sides) else 0.0


def even_share(points: Sequence[Point]) -> float:
    """Return the variation over the speed of the force that is alike both ways, over the mean of what opposes."""
    (out, out_force), (back, back_force) = (
        np.array(sorted((abs(one.velocity), one.force) for one in points if one.velocity * side > 0.0)).reshape(-1, 2).T
        for side in (1.0, -1.0)
    )
    if not (len(out) and len(back)):
        return 0.0
    speed = np.sort(np.concatenate([out, back]))
    speed = speed[(speed >= max(out[0], back[0])) & (speed <= min(out[-1], back[-1]))]
    if not len(speed):
        return 0.0
    there, here = np.interp(speed, out, out_force), np.interp(speed, back, back_force)
    return float(np.ptp(there + here) / max(abs(float(np.mean(there - here))), 1e-30))


def centred_splines(share: FloatArray) -> FloatArray:
    """Return `spline_basis`, each spline less its mean over the positions from 0 to 1, shape (n, KNOTS)."""
    return spline_basis(share) - SPLINE_MEANS


def spline_basis(share: FloatArray) -> FloatArray:
    """Return the `KNOTS` uniform cubic B-splines of `model.tables` at positions from 0 to 1, shape (n, KNOTS)."""
    step = 1.0 / (KNOTS - 3)
    knots = step * np.arange(-3, KNOTS + 1)
    inside = np.clip(share, 0.0, 1.0 - 1e-12)
    return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())


SPLINE_MEANS = np.asarray(spline_basis(np.arange(1001, dtype=np.float64) / 1000.0).mean(axis=0))
"""Mean of each spline over the positions from 0 to 1, shape (KNOTS,)."""
