# SPDX-License-Identifier: Apache-2.0
"""How far each residual may be off if nothing is missing: noise, doubt about reversals and flows, rows not recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import uniform_filter1d

from hydro_diagnosis.effects.base import MOTION, PRESSURE, Claim, FloatArray
from hydro_diagnosis.estimation.addition import Parts
from hydro_diagnosis.estimation.layout import CHANNELS, Layout
from hydro_diagnosis.model.noise_floor import residual_noise
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.smoothing import ACCELERATION_NOISE_GAIN
from hydro_sim.model.bench import Bench

LEVEL = 1.0
"""Averaging time [s] of the error that missing rows may hide."""


class Noise:
    """What the sensors' noise makes of the residuals, whatever is claimed.

    Parameters
    ----------
    models, blocks, bench
        Segments, blocks of equations that they check, and the assumed bench.
    sensors
        Noise of each sensor by its channel, SI units.
    """

    def __init__(
        self, models: Sequence[SegmentModel], blocks: Sequence[str], bench: Bench, sensors: dict[str, float]
    ) -> None:
        self.models, self.blocks, self.sensors = models, blocks, sensors
        self.residuals = [residual_noise(sensors, bench, model.step * model.spacing) for model in models]
        """Of each segment's residuals by channel, physical units."""
        self.flows = [model.pressure_doubt(sensors) for model in models] if PRESSURE in blocks else []
        """Of each segment: what noise in the flows makes of the pressures' residuals."""

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

    @classmethod
    def under(cls, claims: Sequence[Claim], noise: Noise, changes: Parts) -> Weights:
        """Weights under all these claims; `changes`: of the residuals if half of the rows are left out."""
        doubt: list[FloatArray] = []
        if MOTION in noise.blocks:
            count = sum(model.reversals for model in noise.models)
            doubt = [model.kept(model.friction_doubt(claims, count)) for model in noise.models]
        return cls(noise, doubt, {key: _level(noise.models[key[1]], change) for key, change in changes.items()})

    @property
    def doubted(self) -> tuple[float, ...]:
        """What identifies them: the sum of all doubt per segment."""
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
