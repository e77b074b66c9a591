# SPDX-License-Identifier: Apache-2.0
"""A curve in one line of text."""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import FloatArray

LEVELS = "▁▂▃▄▅▆▇█"
WIDTH = 24
"""Width in characters."""


def sparkline(values: FloatArray) -> str:
    """The middle of each of `WIDTH` parts, from the smallest number (▁) to the largest (█); gaps are blanks."""
    parts = np.array_split(values, min(WIDTH, len(values))) if len(values) else []
    middles = np.array([np.nanmedian(part) if np.isfinite(part).any() else np.nan for part in parts])
    if not np.isfinite(middles).any():
        return ""
    low, high = float(np.nanmin(middles)), float(np.nanmax(middles))
    span = high - low if high > low else 1.0
    return "".join(
        " " if not np.isfinite(one) else LEVELS[min(int((one - low) / span * len(LEVELS)), len(LEVELS) - 1)]
        for one in middles
    )
