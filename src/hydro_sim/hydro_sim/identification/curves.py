# SPDX-License-Identifier: Apache-2.0
"""Plots of a validation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.signals import PLANT_FIELDS, SAMPLE_PERIOD, FloatArray
from hydro_sim.plotting import BLUE, GRAY, RED, UNITS, figure, legend

SI_UNITS = ("N", "N/s", "N", "N/s", "Pa", "Pa", "m", "m/s")
"""Units of the entries of x."""


def draw_horizons(
    horizons: FloatArray, learned: FloatArray, analytic: FloatArray, noise: FloatArray | None, path: str | Path
) -> None:
    """Draw RMSE over the time predicted, one panel per state: learned, analytic, and the recording's noise if known.

    Shapes: horizons (k,) in samples, learned and analytic (k, 8), noise (8,), SI units.
    """
    with figure(path, 8, size=(7.0, 14.0), sharex=True) as (_, axes):
        for i, (axis, field) in enumerate(zip(axes, PLANT_FIELDS, strict=True)):
            name, unit, factor = UNITS[field]
            axis.loglog(horizons * SAMPLE_PERIOD, factor * analytic[:, i], color=RED, label="analytic")
            axis.loglog(horizons * SAMPLE_PERIOD, factor * learned[:, i], color=BLUE, label="learned")
            if noise is not None:
                axis.axhline(factor * noise[i], color=GRAY, linestyle="--", label="noise of the recording")
            axis.set(title=name, ylabel=f"RMSE [{unit}]")
        legend(axes[0])
        axes[-1].set_xlabel("predicted [s]")


def draw_free_run(time: Any, measured: FloatArray, learned: FloatArray, analytic: FloatArray, path: str | Path) -> None:
    """Draw load force and its error in one long prediction; shapes (n,) for time [s], (n, 8) for the others."""
    with figure(path, 2, size=(8.0, 5.0), sharex=True) as (_, (force, error)):
        for values, color, name in (
            (measured, GRAY, "recorded"),
            (analytic, RED, "analytic"),
            (learned, BLUE, "learned"),
        ):
            force.plot(time, values[:, 2], color=color, label=name)
        error.plot(time, learned[:, 2] - measured[:, 2], color=BLUE, label="learned - recorded")
        force.set(ylabel="load force [N]")
        error.set(ylabel="error [N]", xlabel="time [s]")
        legend(force)
        legend(error)


def draw_regions(edges: FloatArray, errors: FloatArray, labels: list[str], path: str | Path) -> None:
    """Draw errors of f_l by bins of several coordinates.

    Shapes: edges (coordinates, bins + 1), errors (coordinates, bins).
    """
    with figure(path, len(labels), size=(7.0, 2.2 * len(labels))) as (_, axes):
        for axis, edge, error, label in zip(np.atleast_1d(axes), edges, errors, labels, strict=True):
            axis.bar(edge[:-1], error, width=np.diff(edge), align="edge", color=BLUE, edgecolor="white")
            axis.set(xlabel=label, ylabel="RMSE of f_l [N]")
