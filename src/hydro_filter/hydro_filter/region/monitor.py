# SPDX-License-Identifier: Apache-2.0
"""Monitor of the certified region of the active force law.

The region is checked once a policy step, 10 ms: in that time its states hardly move, and the gains change once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP
from hydro_filter.model.sample import Sample
from hydro_filter.region.certified_region import CertifiedRegion
from hydro_filter.region.parameters import STATE_NAMES, region_states

ROUNDING_TOLERANCE = 1e-9
"""Relative tolerance of the bounds, for rounding."""


class RegionViolation(NamedTuple):
    """Quantity outside of its certified range."""

    name: str
    """A state of `parameters.STATE_NAMES`, velocity_compensation, proportional_gain, or gain_rate."""
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.name} is {self.value:.4g}, proved from {self.low:.4g} to {self.high:.4g}"


class RegionMonitor:
    """Checks samples of one bench against its certified regions.

    `regions`: by whether they are of the compensated law. `closing`: current [A] that closes the valve.
    """

    def __init__(self, regions: Mapping[bool, CertifiedRegion], closing: float) -> None:
        self._regions, self._closing = regions, closing
        self._gain: float | None = None  # of the step before

    def reset(self) -> None:
        """Discard the last step's gain, as a new run begins."""
        self._gain = None

    def check(self, sample: Sample, opening: float, opening_rate: float) -> RegionViolation | None:
        """Return the first quantity outside of the active law's region; None: all are within, or the law has no region.

        Call once a policy step. `opening`, `opening_rate`: of the valve at the sample, as the filter has them [A, A/s].
        """
        before, self._gain = self._gain, sample.proportional_gain
        region = self._regions.get(sample.compensated)
        if region is None:
            return None
        valve = np.array([[opening, opening_rate, sample.nominal_current - self._closing]])
        states = region_states(region.bench, sample.state[np.newaxis], valve)[0]
        quantities = [
            (name, float(value), *region.states[name]) for name, value in zip(STATE_NAMES, states, strict=True)
        ]
        quantities.append(("velocity_compensation", sample.law_inputs[2], *region.velocity_compensation))
        quantities.append(("proportional_gain", sample.proportional_gain, *region.proportional_gain))
        if before is not None:
            rate = (sample.proportional_gain - before) / (SAMPLES_PER_STEP * SAMPLE_PERIOD)
            quantities.append(("gain_rate", rate, -region.gain_rate, region.gain_rate))
        for name, value, low, high in quantities:
            slack = ROUNDING_TOLERANCE * max(abs(low), abs(high))
            if not low - slack <= value <= high + slack:
                return RegionViolation(name, value, low, high)
        return None
