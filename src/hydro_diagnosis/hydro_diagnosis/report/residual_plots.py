# SPDX-License-Identifier: Apache-2.0
"""Plot of the residuals: each equation's unexplained part over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.report.diagnosis import Diagnosis
from hydro_diagnosis.report.plots import svg
from hydro_diagnosis.selection.localisation import Place
from hydro_sim.plotting import BLUE, ORANGE, RED, legend

MOST = 4
"""Equations shown at most, the largest share first."""
_SMOOTHED = 0.1
"""s, over which the squares are averaged."""
_PAUSE = 1.0
"""s, drawn between recordings."""
_LABELS = {"pressure_a": "chamber A", "pressure_b": "chamber B"}


def location_plot(found: Diagnosis) -> str:
    """Residuals with the bench file alone, in units of the noise, over all segments side by side."""
    places = found.assessment.places[:MOST]
    begins = np.cumsum([0.0, *(len(model.segment) * model.step + _PAUSE for model in found.problem.models)])

    def draw(axes: Any) -> None:
        for axis, place in zip(axes, places, strict=True):
            for k, model in enumerate(found.problem.models):
                time, level = _level(found, place, k)
                shift = begins[k] - model.segment.start
                axis.plot(time + shift, level, color=BLUE, linewidth=0.7, label="unexplained" if k == 0 else None)
                for number, (begin, end) in enumerate(place.windows[k]):
                    label = "stands out" if k == 0 and number == 0 else None
                    axis.axvspan(begin + shift, end + shift, color=ORANGE, alpha=0.18, linewidth=0, label=label)
                if k:
                    axis.axvline(begins[k] - 0.5 * _PAUSE, color="black", linewidth=0.6)
            axis.axhline(1.0, color=RED, linewidth=0.7, label="noise")
            axis.set_yscale("log")
            axis.set_ylabel(_LABELS.get(place.equation, place.equation))
        legend(axes[0])
        axes[-1].set_xlabel("time [s], recordings one after the other")

    return svg(len(places), (9.0, 1.2 * len(places) + 0.6), draw, sharex=True)


def _level(found: Diagnosis, place: Place, segment: int) -> tuple[FloatArray, FloatArray]:
    """Time [s] and root mean square over the noise's, of the channel in which an equation shows most."""
    layout = found.problem.layout
    at = (layout.channel == CHANNELS.index(place.channel)) & (layout.segment == segment)
    time = layout.time[at]
    width = max(int(_SMOOTHED / max(float(np.median(np.diff(time))), 1e-3)), 1)
    squares = uniform_filter1d(np.square(found.outcome.nothing.residual[at]), width, mode="nearest")
    return time, np.sqrt(np.maximum(squares, 1e-2))
