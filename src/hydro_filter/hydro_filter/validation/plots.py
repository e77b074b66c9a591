# SPDX-License-Identifier: Apache-2.0
"""The paper's figure unstable_track: force tracking under destabilising gains, with and without the filter."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hydro_filter.validation.trial import Run
from hydro_sim.plotting import BLUE, GRAY, GREEN, ORANGE, RED, draw, figure, legend


def draw_tracking(without: Run, filtered: Run, title: str, path: Path) -> None:
    """Draw reference and both forces, the gain, the correction and the certificate over time."""
    with figure(path, 4, size=(8.0, 8.0), sharex=True, height_ratios=(3, 1.5, 1.5, 1.5)) as (drawing, axes):
        force, gain, valve, certificate = axes
        drawing.suptitle(title, x=0.01, ha="left", weight="semibold")
        draw(force, filtered.states, "reference_force", color=GRAY, linestyle="--")
        tripped = "" if without.bounded else ", until the box tripped"
        draw(force, without.states, "load_force", color=RED, label="without filter" + tripped, linewidth=0.9)
        draw(force, filtered.states, "load_force", color=BLUE, label="with filter")
        force.set(ylabel="load force [N]", ylim=(-720.0, 720.0))
        draw(gain, filtered.states, "proportional_gain", color=GREEN, drawstyle="steps-post", linewidth=0.7)
        gain.set(ylabel="[1/s]")
        time = filtered.states["time"]
        correction = np.array([result.delta_u for result in filtered.results])
        valve.plot(time, 1e3 * correction, color=ORANGE, label="correction", linewidth=0.7)
        valve.set(ylabel="[mA]")
        before, after = (np.array([getattr(r, name) for r in filtered.results]) for name in ("before", "after"))
        certificate.plot(time, before, color=RED, label=r"$M_c$ before", linewidth=0.7)
        certificate.plot(time, after, color=BLUE, label=r"$M_c$ after", linewidth=0.7)
        certificate.set(ylabel="[1/s]", xlabel="time [s]", yscale="symlog", xlim=(time[0], time[-1]))
        for panel in axes:
            legend(panel)
