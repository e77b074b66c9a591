# SPDX-License-Identifier: Apache-2.0
"""Residuals that a small error of a pressure gauge leaves, to first order.

The reading itself is off; so are the pressures that flows and stiffness are computed from, and the hydraulic balance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_diagnosis.effects.base import Claim, FloatArray, Oil
from hydro_diagnosis.model import chambers, kernels
from hydro_diagnosis.model.observer import OBSERVER_MEMORY, SLOPE_STEP
from hydro_diagnosis.model.segment_model import SegmentModel

_CHANNELS = ("pressure_a", "pressure_b")


class GaugeWays:
    """Ways of the errors of both gauges of one segment, under the claims that stand."""

    def __init__(self, model: SegmentModel, claims: Sequence[Claim]) -> None:
        self.model, self.claims, self.bench = model, claims, model.bench(claims)
        oil = model.oil(claims)
        self._gain = model.step / OBSERVER_MEMORY
        self._built = model.built(self.bench, oil, claims)[1]
        self._by_pressure = {name: self._sensitivity(oil, k) for k, name in enumerate(_CHANNELS)}

    def _sensitivity(self, oil: Oil, index: int) -> tuple[FloatArray, FloatArray]:
        """Change of what each sample builds in chambers A and B per change of one pressure."""
        moved = []
        for sign in (1.0, -1.0):
            pressures = list(oil.pressures)
            pressures[index] = pressures[index] + sign * SLOPE_STEP
            shifted = Oil(oil.time, oil.position, (pressures[0], pressures[1]), oil.spool, oil.velocity)
            moved.append(self.model.built(self.bench, shifted, self.claims)[1])
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
                if name == channel and one.effect.curves == channel:
                    more = more + built * self._slope(channel, signal, one)
                elif name == channel:
                    off = -error
                shown[name].append(self.model.kept_smooth(kernels.innovations(off, more, self._gain)))
            shown["hydraulic"].append(self.model.means(area * error))
        return {name: np.stack(rows) for name, rows in shown.items()}

    def _slope(self, channel: str, signal: FloatArray, term: Claim) -> FloatArray:
        """Change of the error [-] per change of the pressure, within each sample."""
        middle = chambers.middle(signal)
        above, below = (self.model.reading(channel, middle + sign * SLOPE_STEP, [term]) for sign in (1.0, -1.0))
        return (above - below) / (2.0 * SLOPE_STEP) - 1.0
