# SPDX-License-Identifier: Apache-2.0
"""The recordings as one least-squares problem: claims in, residuals in units of the measured noise out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Claim, Effect, FloatArray
from hydro_diagnosis.estimation.addition import Parts
from hydro_diagnosis.estimation.equation_residuals import EquationResiduals
from hydro_diagnosis.estimation.layout import Layout
from hydro_diagnosis.estimation.needed_numbers import connected
from hydro_diagnosis.estimation.weights import Noise, Weights
from hydro_diagnosis.model.noise_floor import sensor_noise
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench


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
        self.blocks = self._checked_blocks()
        self._noise = Noise(self.models, self.blocks, bench, noise or sensor_noise(self.models))
        thinner = [segment.thinner or segment for segment in segments]
        lacking = like is None and any(segment.thinner for segment in segments)
        self.thinner = Problem(thinner, bench, baseline, self.sensor_noise, self) if lacking else None
        """The same problem from half of the rows where rows are missing; None where none are."""
        self.equations = EquationResiduals(self.models, self.blocks, self.baseline)
        self.shelf: dict[str, Any] = {}
        """What later stages keep of these recordings, by their own names."""
        self.columns = self.equations.columns
        """Responses to terms that add, and derivatives of the residual (`slopes.jacobian`), as computed."""
        self.evaluations = 0
        """Number of calls of `residual`: the measure of a search's effort."""
        self.update_weights(())
        self.layout = Layout.of(self.blocks, self.models)
        moves = MOTION in self.blocks
        self.attenuation = {"moving_mass": self._noise.mass_attenuation(bench.moving_mass)} if moves else {}
        """By effect id: how far [SI unit] a parameter may be off because the signal that it multiplies is noisy."""

    @property
    def sensor_noise(self) -> dict[str, float]:
        """Noise of each sensor by its channel, SI units."""
        return self._noise.sensors

    @property
    def noise(self) -> dict[str, float]:
        """Noise of the first segment's residuals; those of others differ where the logger's rate does (`deviation`)."""
        return self._noise.residuals[0]

    def _checked_blocks(self) -> tuple[str, ...]:
        have = set.intersection(*(set(model.channels) for model in self.models))
        present = {one.block for one in connected(have, self.bench)}
        return tuple(block for block in (PRESSURE, MOTION, LOAD, HYDRAULIC) if block in present)

    def update_weights(self, claims: Sequence[Claim]) -> None:
        """Weigh residuals down: where these claims leave the sign of dry friction in doubt, and by missing rows."""
        changes = self._changes(claims) if self.thinner is not None else {}
        self.weights = Weights.under((*self.baseline, *claims), self._noise, changes)
        self.doubted = self.weights.doubted
        """Identifies the present doubt: its sum per segment, all zeros without any."""

    def _changes(self, claims: Sequence[Claim]) -> Parts:
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
        self.evaluations += 1
        return np.concatenate([part / self.deviation(*key) for key, part in self.parts(claims).items()])

    def parts(self, claims: Sequence[Claim]) -> Parts:
        """Residuals by channel and segment in the order of `layout`, physical unit."""
        return self.equations.parts(claims)

    def forget(self) -> None:
        """Drop what was kept to spare computing, of copies too."""
        self.shelf.clear()
        self.columns.clear()
