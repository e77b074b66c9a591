# SPDX-License-Identifier: Apache-2.0
"""Quality of a bench file's predictions, and whether they are good enough to use.

A model whose predictions leave only noise cannot be better. The mean over the readings ranks models; the worst reading
is limited, too, as a mean can hide it: four readings at the noise and one at 240 times have a mean of 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log
from typing import Any

from hydro_sim.model.equations import READINGS

HORIZON_SAMPLES = 70
"""Length of a prediction [samples]."""
ERROR_RATIO_MAX = 3.0
"""Largest acceptable prediction error over the noise, geometric mean of the readings."""
WORST_ERROR_RATIO_MAX = 10.0
"""Largest acceptable prediction error of the worst reading over its noise. It exceeds that of the mean, as noise is no
measure of an error's effect: ten times are 6 N of a load cell, and 3 um of an encoder."""

GOOD_ERROR_RATIO = 1.3
"""Prediction error of a reading, over its noise, that is accepted without a note."""


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Quality of a bench file: RMSE of predictions against the readings, over the readings' noise."""

    over_noise: float
    """Geometric mean of the five readings; 1: nothing but noise."""
    worst: float
    """Largest ratio of the five."""
    worst_reading: str
    """Name of the reading with the largest ratio."""

    @classmethod
    def of(cls, ratios: Sequence[float]) -> Quality:
        """Create from the readings' error ratios, in the order of `READINGS`; NaN counts as infinite."""
        worst, name = max(zip(ratios, READINGS, strict=True), key=lambda one: one[0] if one[0] >= 0.0 else float("inf"))
        mean = exp(sum(log(ratio) for ratio in ratios) / len(ratios))
        return cls(over_noise=float(mean), worst=float(worst), worst_reading=name)

    @classmethod
    def from_mapping(cls, content: Any) -> Quality:
        """Create from the entry `learned` of a bench file. Raises ValueError: it is not as `learn` writes it."""
        try:
            over_noise, worst = float(content["over_noise"]), float(content["worst"])
            return cls(over_noise=over_noise, worst=worst, worst_reading=str(content["worst_reading"]))
        except (KeyError, TypeError, ValueError):
            raise ValueError("'learned' is not as `learn` writes it: learn the file again") from None

    def to_mapping(self) -> dict[str, Any]:
        """Return the quality as a mapping for a bench file."""
        left = {"over_noise": round(self.over_noise, 4), "worst": round(self.worst, 4)}
        return {"samples": HORIZON_SAMPLES, **left, "worst_reading": self.worst_reading}

    @property
    def rejection_reason(self) -> str:
        """Error message if the predictions are too poor to rely on; empty otherwise."""
        if not self.over_noise <= ERROR_RATIO_MAX:
            left = f"{self.over_noise:.3g} times the noise, more than {ERROR_RATIO_MAX:g}"
        elif not self.worst <= WORST_ERROR_RATIO_MAX:
            left = f"{self.worst:.3g} times the noise of {self.worst_reading}, more than {WORST_ERROR_RATIO_MAX:g}"
        else:
            return ""
        return f"predictions of this bench file leave {left}: `diagnose` names the effects that it lacks"

    def sentence(self) -> str:
        """Return a sentence on the prediction error and whether it is acceptable."""
        left = f"{self.over_noise:.2f} times the noise, {self.worst:.2f} times of {self.worst_reading}"
        told = f"{HORIZON_SAMPLES}-sample predictions leave {left}"
        if self.rejection_reason:
            return f"{told}; NOT fit for the filter: {self.rejection_reason}"
        if self.worst > GOOD_ERROR_RATIO:
            return f"{told}; more than {GOOD_ERROR_RATIO:g} times hints at an effect that the file does not name"
        return told
