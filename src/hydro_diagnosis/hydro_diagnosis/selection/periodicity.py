# SPDX-License-Identifier: Apache-2.0
"""What repeats in what remains: mains, a pump's strokes, a dither. No law has a phase of each recording's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.estimation.layout import CHANNELS, Layout

SLOWEST = 5.0
"""Hz: what repeats less often may be the reference's doing."""
AROUND = 40
"""Bins on either side of a line whose median is what it stands out of."""
STANDS_OUT = 40.0
"""Times that median: among 5000 bins of white noise it is exceeded once in 10^8."""
SHARE = 0.3
"""Of what remains in a channel, that a line must hold."""


@dataclass(frozen=True)
class Line:
    """A line in the spectrum of what remains, the same in all recordings."""

    frequency: float
    """Hz."""
    share: float
    """Of the squares of what remains there, of the recording that has least of it."""

    @property
    def sentence(self) -> str:
        """What it is typical of."""
        return (
            f"{100.0 * self.share:.0f} % of what remains repeats every {1e3 / self.frequency:.3g} ms "
            f"({self.frequency:.3g} Hz), unless the reference does: typical of the mains, a pump's strokes, a dither "
            "or a machine nearby; stop it, for it is not modelled."
        )


def line_of(parts: Sequence[tuple[Layout, FloatArray]], channel: str) -> Line | None:
    """Return the line that holds most of what remains in a channel of the residuals in every recording, or None.

    `parts`: layouts, and residuals [noise] in their order: of the fitted recordings, of the held-out ones.
    """
    lines, finest = [], 0.0
    for layout, residual in parts:
        here = layout.channel == CHANNELS.index(channel)
        for segment in np.unique(layout.segment[here]):
            at = here & (layout.segment == segment)
            lines.append(_strongest(layout.time[at], residual[at]))
            finest = max(finest, 2.0 / max(float(np.ptp(layout.time[at])), 1e-9))
    told = [line for line in lines if line is not None]
    if not told or len(told) < len(lines) or np.ptp([line.frequency for line in told]) > finest:
        return None
    return Line(float(np.mean([line.frequency for line in told])), min(line.share for line in told))


def _strongest(time: FloatArray, residual: FloatArray) -> Line | None:
    """The line of one recording: most of the residual's power beyond the noise (1 a sample) within two bins."""
    if len(time) < 8 * AROUND:
        return None
    step = float(np.median(np.diff(time)))
    even = np.interp(np.arange(time[0], time[-1], step), time, residual)
    frequency, power = scipy.signal.periodogram(even, 1.0 / step, window="hann", scaling="spectrum")
    beyond = float(np.mean(even * even)) - 1.0
    best = int(np.argmax(np.where(frequency > SLOWEST, power, 0.0)))
    around = np.r_[power[max(best - AROUND, 1) : max(best - 2, 1)], power[best + 3 : best + AROUND]]
    if beyond <= 0.0 or frequency[best] <= SLOWEST or power[best] < STANDS_OUT * np.median(around):
        return None
    share = float(power[best - 2 : best + 3].sum()) / 1.5 / beyond  # Hann's window widens a line: 1.5 bins of noise
    return Line(float(frequency[best]), min(share, 1.0)) if share > SHARE else None
