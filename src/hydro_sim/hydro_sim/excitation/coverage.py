# SPDX-License-Identifier: Apache-2.0
"""Coverage of the state space by a recording."""

from __future__ import annotations

import numpy as np

from hydro_bridge.cli.console import Table
from hydro_bridge.signals import Flag, StateArray
from hydro_sim.plotting import UNITS

WORKING_RANGE: dict[str, tuple[float, float]] = {
    "load_force": (-400.0, 400.0),
    "load_force_rate": (-3770.0, 3770.0),
    "pressure_a": (4e6, 9e6),
    "pressure_b": (5e6, 14e6),
    "piston_position": (0.02, 0.06),
    "piston_velocity": (-0.19, 0.19),
    "valve_current": (-5e-3, 5e-3),
    "proportional_gain": (15.0, 75.0),
    "integral_gain": (5.0, 15.0),
}
"""Working range of a model: 300 N at 2 Hz with offsets (physics.md), SI units."""

BINS = 20


def coverage(states: StateArray) -> Table:
    """One row per quantity: its range, its spread, and how much of the working range was visited while armed.

    `visited` is the share of 20 bins of the working range with at least 0.1 % of the samples; the last row is the share
    of cells of load force by velocity, 10 each way, within the ellipse that sines of 400 N and 3770 N/s fill.
    """
    armed = states[(states["flags"] & Flag.ARMED) != 0]
    seconds = 1e-3 * len(armed)
    columns = {
        "quantity": "", "unit": "", "low": "0.1 % of samples are below", "high": "0.1 % of samples are above",
        "std": "standard deviation", "visited": "share of the working range visited",
    }  # fmt: skip
    table = Table(columns, title=f"{seconds:g} s armed of {1e-3 * len(states):g} s")
    for field in WORKING_RANGE:
        name, unit, factor = UNITS[field]
        values = armed[field]
        low, high = np.quantile(values, [0.001, 0.999])
        counts, _ = np.histogram(values, BINS, WORKING_RANGE[field])
        table.add(
            quantity=name, unit=unit, low=float(factor * low), high=float(factor * high),
            std=float(factor * values.std()),
            visited=float((counts > 0.001 * len(values)).mean()),
        )  # fmt: skip
    table.add(quantity="force by velocity", unit="", low=np.nan, high=np.nan, std=np.nan, visited=_plane(armed))
    return table


def _plane(armed: StateArray) -> float:
    ranges = (WORKING_RANGE["load_force"], WORKING_RANGE["piston_velocity"])
    counts, force, velocity = np.histogram2d(armed["load_force"], armed["piston_velocity"], 10, ranges)
    f, v = 0.5 * (force[1:] + force[:-1]) / ranges[0][1], 0.5 * (velocity[1:] + velocity[:-1]) / ranges[1][1]
    inside = f[:, None] ** 2 + v[None, :] ** 2 <= 1.0
    return float((counts[inside] >= 10).mean())
