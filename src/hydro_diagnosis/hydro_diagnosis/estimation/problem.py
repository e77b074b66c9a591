# SPDX-License-Identifier: Apache-2.0
"""The recordings as one least-squares problem: claims in, residuals in units of the measured noise out."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, Effect, FloatArray
from hydro_diagnosis.estimation.addition import Parts, amplitudes, between, responses, shapes, summed, written
from hydro_diagnosis.estimation.columns import Columns
from hydro_diagnosis.estimation.direct_response import direct_response
from hydro_diagnosis.estimation.needed_numbers import connected
from hydro_diagnosis.model.chambers import ChamberRun
from hydro_diagnosis.model.noise_floor import residual_noise, sensor_noise
from hydro_diagnosis.model.segment_model import BLOCKS, SegmentModel
from hydro_diagnosis.preprocessing.smoothing import ACCELERATION_NOISE_GAIN
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench

CHANNELS = ("pressure_a", "pressure_b", "motion", "load", "hydraulic")
LEVEL = 1.0
"""Averaging time [s] of the error that missing rows may hide."""
_CACHE = 24


@dataclass(frozen=True)
class Layout:
    """Assignment of a residual vector's entries to channels: `channel[i]` indexes `CHANNELS`."""

    channel: np.ndarray[Any, np.dtype[np.int64]]
    segment: np.ndarray[Any, np.dtype[np.int64]]
    time: FloatArray

    def count(self) -> FloatArray:
        """Entries per channel, shape (5,)."""
        return self._count

    def squares(self, residual: FloatArray) -> FloatArray:
        """Sum of each channel's squares, shape (5,)."""
        sums = np.zeros(len(CHANNELS))
        for index, begin, end in self._stretches:
            part = residual[begin:end]
            sums[index] += part @ part
        return sums

    @cached_property
    def _count(self) -> FloatArray:
        return np.bincount(self.channel, minlength=len(CHANNELS)).astype(np.float64)

    @cached_property
    def _stretches(self) -> list[tuple[int, int, int]]:
        """Channel, begin and end of the stretches of one channel each."""
        edges = [0, *(np.flatnonzero(np.diff(self.channel)) + 1).tolist(), len(self.channel)]
        return [(int(self.channel[begin]), begin, end) for begin, end in pairwise(edges)]


class Problem:
    """Segments, the assumed bench, and claims that are already made (`baseline`).

    `like`: the same segments with more rows, whose judged samples are judged here too. `estimated`: where each fit
    begins with the numbers that are estimated in all of them.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        bench: Bench,
        baseline: Sequence[Claim] = (),
        noise: dict[str, float] | None = None,
        like: Problem | None = None,
        estimated: Sequence[Claim] = (),
    ) -> None:
        self.bench = bench
        self.estimated = tuple(estimated)
        self.baseline = tuple(baseline)
        self.ruled_out: tuple[Effect, ...] = ()
        """Causes that the user says it cannot be."""
        likes = like.models if like else [None] * len(segments)
        self.models: list[SegmentModel] = [
            SegmentModel(segment, bench, one) for segment, one in zip(segments, likes, strict=True)
        ]
        self.sensor_noise = noise or sensor_noise(self.models)
        self._noises = [residual_noise(self.sensor_noise, bench, model.step * model.spacing) for model in self.models]
        self.noise = self._noises[0]
        """Noise of the first segment's residuals; those of others differ where the logger's rate does (`deviation`)."""
        thinner = [segment.thinner or segment for segment in segments]
        lacking = like is None and any(segment.thinner for segment in segments)
        self.thinner = Problem(thinner, bench, baseline, self.sensor_noise, self) if lacking else None
        """The same problem from half of the rows where rows are missing; None where none are."""
        self.blocks = self._checked_blocks()
        self._cache: dict[tuple[Any, ...], list[Any]] = {}
        self.shelf: dict[str, Any] = {}
        """What later stages keep of these recordings, by their own names."""
        self.columns = Columns()
        """Responses to terms that add, and derivatives of the residual (`slopes.jacobian`), as computed."""
        self._doubt: list[FloatArray] = []
        self._deviations: dict[tuple[str, int], FloatArray | float] = {}
        """By channel and segment: `deviation` under the present doubt, as far as asked for."""
        self._unseen: dict[tuple[str, int], FloatArray] = {}
        """By channel and segment: what the rows that are missing may hide, shape of the residuals, physical unit."""
        self.evaluations = 0
        """Number of calls of `residual`: the measure of a search's effort."""
        self.doubted: tuple[float, ...] = ()
        """Identifies the present doubt: its sum per segment, all zeros without any."""
        checked = PRESSURE in self.blocks
        self._flows = [model.pressure_doubt(self.sensor_noise) for model in self.models] if checked else []
        self.update_weights(())
        self.layout = self._layout()
        self.attenuation = {"moving_mass": self._mass_attenuation()} if MOTION in self.blocks else {}
        """By effect id: how far [SI unit] a parameter may be off because the signal that it multiplies is noisy."""

    def _checked_blocks(self) -> tuple[str, ...]:
        have = set.intersection(*(set(model.channels) for model in self.models))
        present = {one.block for one in connected(have, self.bench)}
        return tuple(block for block in (PRESSURE, MOTION, LOAD, HYDRAULIC) if block in present)

    def update_weights(self, claims: Sequence[Claim]) -> None:
        """Weigh residuals down: where these claims leave the sign of dry friction in doubt, and by missing rows."""
        self._deviations = {}
        if MOTION in self.blocks:
            everything, reversals = (*self.baseline, *claims), sum(model.reversals for model in self.models)
            self._doubt = [model.kept(model.friction_doubt(everything, reversals)) for model in self.models]
        if self.thinner is not None:
            self._unseen = {key: self._level(key[1], change) for key, change in self._changes(claims).items()}
        self.doubted = tuple(float(np.sum(doubt)) for doubt in (*self._doubt, *self._unseen.values()))

    def _changes(self, claims: Sequence[Claim]) -> dict[tuple[str, int], FloatArray]:
        """Change of each residual if half of the rows are left out, physical unit."""
        fewer = self.thinner.parts(claims) if self.thinner is not None else self.parts(claims)
        return {key: fewer[key] - part for key, part in self.parts(claims).items()}

    def _level(self, segment: int, change: FloatArray) -> FloatArray:
        """Root mean square of a change over `LEVEL` seconds around each residual."""
        duration = len(self.models[segment].time) * self.models[segment].step
        count = max(round(LEVEL * len(change) / duration), 1)
        return np.asarray(np.sqrt(uniform_filter1d(np.square(change), count, mode="nearest")))

    def change(self, claims: Sequence[Claim]) -> FloatArray:
        """Change of each residual if half of the rows are left out, over its deviation."""
        changes = self._changes(claims).items()
        return np.concatenate([change / self.deviation(*key) for key, change in changes])

    def _mass_attenuation(self) -> float:
        """Mass [kg] that the encoder's noise hides: m times the share of noise in the acceleration's power.

        Least squares with a noisy regressor are off by up to that (errors in variables: Fuller 1987); through the
        controller the noise is also in the motion itself, so that the exact amount is not known.
        """
        step = min(model.step * model.spacing for model in self.models)
        noise = self.sensor_noise.get("piston_position", 0.0) * ACCELERATION_NOISE_GAIN / step**2
        power = float(np.mean(np.square(np.concatenate([model.finish(model.a) for model in self.models]))))
        return self.bench.moving_mass * noise**2 / max(power - noise**2, noise**2, 1e-12)

    def deviation(self, channel: str, segment: int) -> FloatArray | float:
        """Standard deviation of a channel's residuals if nothing is missing, physical unit."""
        key = channel, segment
        if key not in self._deviations:
            self._deviations[key] = self._deviation(channel, segment)
        return self._deviations[key]

    def _deviation(self, channel: str, segment: int) -> FloatArray | float:
        deviation: FloatArray | float = self._noises[segment][channel]
        if channel == "motion":
            deviation = np.hypot(deviation, self._doubt[segment])
        if channel in ("pressure_a", "pressure_b"):
            deviation = np.hypot(deviation, self._flows[segment][CHANNELS.index(channel)])
        if (channel, segment) in self._unseen:
            return np.asarray(np.maximum(deviation, self._unseen[channel, segment]))
        return deviation

    def deviations(self) -> FloatArray:
        """`deviation` of every residual in the order of `layout`."""
        layout, found = self.layout, np.empty(len(self.layout.time))
        for name in (CHANNELS[index] for index in np.unique(layout.channel)):
            for k in range(len(self.models)):
                found[(layout.channel == CHANNELS.index(name)) & (layout.segment == k)] = self.deviation(name, k)
        return found

    def with_estimated(self, claims: Sequence[Claim]) -> tuple[Claim, ...]:
        """The claims, before them the estimated numbers that are not among them."""
        among = {claim.effect.label for claim in claims if claim.effect.estimated}
        return (*(one for one in self.estimated if one.effect.label not in among), *claims)

    def residual(self, claims: Sequence[Claim]) -> FloatArray:
        """Every residual over its noise, one vector in the order of `layout`."""
        self.evaluations += 1
        return np.concatenate([part / self.deviation(*key) for key, part in self.parts(claims).items()])

    def parts(self, claims: Sequence[Claim]) -> dict[tuple[str, int], FloatArray]:
        """Residuals by channel and segment in the order of `layout`, physical unit."""
        adding, rest = summed((*self.baseline, *claims), self.baseline)
        parts = self._parts(rest)
        for claim in adding:
            for key, response in self._responses(claim).items():
                parts[key] = parts[key] + np.array(amplitudes(claim)) @ response
        return parts

    def _responses(self, claim: Claim) -> Parts:
        """What each amplitude of a term that adds does to the residual, shape (amplitudes, n)."""
        beside = between(claim, self.baseline)
        limits = getattr(claim.effect, "limits", ())
        key = ("response", claim.effect.label, limits, *shapes(claim), written(beside))
        found: Parts | None = self.columns.get(key)
        if found is None:
            found = responses(claim, lambda one: self._response(one, beside))
            self.columns.put(key, found, sum(one.nbytes for one in found.values()))
        return found

    def forget(self) -> None:
        """Drop what was kept to spare computing, of copies too."""
        self.shelf.clear()
        self.columns.clear()

    def _response(self, claim: Claim, beside: tuple[Claim, ...]) -> Parts:
        """What a term that adds does to the residual beside others that stand between it and the sensors."""
        touched = claim.effect.touches & set(self.blocks)
        shown: Parts = {}
        channels = {name for block in touched for name in BLOCKS[block]}
        for k, model in enumerate(self.models):
            direct = direct_response(model, claim, beside)
            if direct is None:
                with_it, without = self._parts((*beside, claim), touched), self._parts(beside, touched)
                return {key: with_it[key] - part for key, part in without.items()}
            shown |= {(name, k): part for name, part in direct.items() if name in channels}
        return shown

    def _parts(self, everything: Sequence[Claim], only: Collection[str] = ()) -> Parts:
        """Residuals of claims each as it stands; `only`: in these blocks, the arcs left out."""
        blocks = only or self.blocks
        parts: Parts = {}
        arcs: list[FloatArray] | None = None
        if PRESSURE in blocks:
            chambers = self._block(PRESSURE, everything, self._pressure)
            parts |= {("pressure_a", k): part for k, (_, part, _) in enumerate(chambers)}
            parts |= {("pressure_b", k): part for k, (_, _, part) in enumerate(chambers)}
            arcs = None if only else [arc for arc, _, _ in chambers]
        if MOTION in blocks:
            motions = self._block(MOTION, everything, lambda model, claims: model.motion_residual(claims))
            rounded = any(claim.effect.rounds == "hydraulic_force" for claim in everything)
            for k, part in enumerate(motions):
                parts["motion", k] = part if arcs is None or rounded else part + arcs[k]
        if LOAD in blocks:
            loads = self._block(LOAD, everything, lambda model, claims: model.load_residual(claims))
            parts |= {("load", k): part for k, part in enumerate(loads)}
        if HYDRAULIC in blocks:
            balances = self._block(HYDRAULIC, everything, lambda model, claims: model.hydraulic_residual(claims))
            parts |= {("hydraulic", k): part for k, part in enumerate(balances)}
        return parts

    def _block(self, block: str, claims: Sequence[Claim], compute: Any) -> list[Any]:
        acting = tuple(claim for claim in claims if block in claim.effect.touches)
        key = (block, *((claim.effect.label, *claim.values.values()) for claim in acting))
        found = self._cache.pop(key, None) or [compute(model.placed(acting), acting) for model in self.models]
        if len(self._cache) > _CACHE:
            self._cache.pop(next(iter(self._cache)))
        self._cache[key] = found  # the one that was asked for longest ago goes first
        return found

    @staticmethod
    def _pressure(model: SegmentModel, claims: Sequence[Claim]) -> tuple[FloatArray, FloatArray, FloatArray]:
        run: ChamberRun = model.chamber_run(claims)
        return model.arc_residual(run), *model.pressure_residuals(run)

    def _layout(self) -> Layout:
        names = {
            PRESSURE: ("pressure_a", "pressure_b"),
            MOTION: ("motion",),
            LOAD: ("load",),
            HYDRAULIC: ("hydraulic",),
        }
        channel, segment, time = [], [], []
        for block in self.blocks:
            for name in names[block]:
                for k, model in enumerate(self.models):
                    at = model.block_time() if block == HYDRAULIC else model.kept_time()
                    channel.append(np.full(len(at), CHANNELS.index(name)))
                    segment.append(np.full(len(at), k))
                    time.append(at)
        return Layout(np.concatenate(channel), np.concatenate(segment), np.concatenate(time))
