# SPDX-License-Identifier: Apache-2.0
"""Agreement of a law's numbers over the benches: the common value, and whether it fits all of them.

Cochran's Q: squared deviations from the mean, which is weighted by the inverse variances, over these variances; of
equal values it follows chi-squared. Source: Cochran 1954, The combination of estimates from different experiments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from hydro_diagnosis.growing.sightings import Estimate, Sighting, units

LEVEL = 0.05
"""Probability of larger deviations, below which one value does not fit all benches."""
SMALL = 1e-6
"""Probability below which no figure is given."""
_HALF_95 = 1.959964
"""Half a 95 % interval, in standard deviations."""


@dataclass(frozen=True)
class Agreement:
    """How one number of a law compares over the benches."""

    name: str
    unit: str
    common: float
    """Weighted mean; the median where one value does not fit, or fewer than two benches identify the number."""
    low: float | None
    """Ends of the 95 % interval of the weighted mean; None where fewer than two benches identify the number."""
    high: float | None
    probability: float | None
    """Of deviations as large as these if one value holds for all; None likewise."""

    @property
    def one_for_all(self) -> bool:
        """Whether one value fits all benches."""
        return self.probability is not None and self.probability >= LEVEL

    @property
    def sentence(self) -> str:
        """The finding, for the command and for the effect's docstring."""
        if self.probability is None or self.low is None or self.high is None:
            return f"{self.name}: too few benches identify it to compare its values."
        if not self.one_for_all:
            return f"{self.name}: each bench has its own value ({_probability(self.probability)} for one value)."
        interval = f"{self.low:.4g} to {self.high:.4g}"
        return (
            f"{self.name}: one value fits all benches, {self.common:.4g} {self.unit} (95 % {interval}, "
            f"{_probability(self.probability)})."
        )


def agreements(found: Sequence[Sighting]) -> list[Agreement]:
    """How each number of the law compares, in the law's order."""
    named = units(found[0].law)
    return [_compared(name, unit, [one.estimates[name] for one in found]) for name, unit in named.items()]


def _compared(name: str, unit: str, estimates: Sequence[Estimate]) -> Agreement:
    known = [(one.value, one.low, one.high) for one in estimates if one.low is not None and one.high is not None]
    if len(known) < 2:
        return Agreement(name, unit, float(np.median([one.value for one in estimates])), None, None, None)
    values, lows, highs = np.array(known).T
    weights = np.square(2.0 * _HALF_95 / np.maximum(highs - lows, 1e-12 * np.abs(values)))
    mean = float(weights @ values / weights.sum())
    reach = _HALF_95 / float(np.sqrt(weights.sum()))
    deviation = float(weights @ np.square(values - mean))
    probability = float(chi2.sf(deviation, len(known) - 1))
    common = mean if probability >= LEVEL else float(np.median(values))
    return Agreement(name, unit, common, mean - reach, mean + reach, probability)


def _probability(value: float) -> str:
    return f"p = {value:.2g}" if value >= SMALL else f"p < {SMALL:g}"
