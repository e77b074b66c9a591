# SPDX-License-Identifier: Apache-2.0
"""Channels that were recorded late or early against the others, by more than any sensor or valve delays them."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

import numpy as np

from hydro_diagnosis.wiring.complaint import Complaint
from hydro_diagnosis.wiring.forces import made_force
from hydro_diagnosis.wiring.repairs import Advance, Channels
from hydro_diagnosis.wiring.signals import follows
from hydro_sim.model.bench import Bench

SENSOR = 0.02
"""s between the hydraulic force and the pressures that a sensor's amplifier can make (of 15 Hz)."""
VALVE = (-0.008, 0.02)
"""s from current to motion: none before it, valves of 10 Hz after it."""
SPRING = (-0.012, 0.06)
"""s from travel to the load's force: none before it, play and the cell's amplifier after it."""
CLEAR = 0.9
"""Correlation of the rates at that delay, below which nothing is said."""


def delays(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that related channels move at the same time."""
    slack = 2.0 * step
    if {"hydraulic_force", "pressure_a", "pressure_b"} <= channels.keys():
        late, clear, field = max(_hydraulic(channels, step, bench), key=lambda one: one[1])
        if clear > CLEAR and abs(late) > SENSOR + slack:
            yield Complaint(f"{field} moves {_said(late)} what goes with it", (_advance(field, late),))
    if {"valve_current", "piston_position"} <= channels.keys():
        late, clear = _along(channels, "valve_current", "piston_position", step)
        if clear > CLEAR and not VALVE[0] - slack < late < VALVE[1] + slack:
            yield Complaint(
                f"the piston moves {_said(late)} the current that moves it",
                (_advance("valve_current", -late), _advance("piston_position", late)),
            )
    if {"load_force", "piston_position"} <= channels.keys():
        late, clear = follows(channels["piston_position"], channels["load_force"], step)
        lag = 2.0**0.5 / (2.0 * pi * bench.load_cell_bandwidth) if bench.load_cell_bandwidth else 0.0
        if clear > CLEAR and not SPRING[0] - slack < late < SPRING[1] + lag + slack:
            yield Complaint(
                f"load_force moves {_said(late)} the position that makes it",
                (_advance("load_force", late - lag), _advance("piston_position", lag - late)),
            )


def _hydraulic(channels: Channels, step: float, bench: Bench) -> Iterator[tuple[float, float, str]]:
    """Delay of each of the three against the prediction from the two others, its clarity, and the field."""
    force, area, ratio = channels["hydraulic_force"], bench.piston_area, bench.area_ratio
    yield *follows(made_force(channels, bench), force, step), "hydraulic_force"
    yield *follows(force / area + ratio * channels["pressure_b"], channels["pressure_a"], step), "pressure_a"
    yield *follows(channels["pressure_a"] - force / area, ratio * channels["pressure_b"], step), "pressure_b"


def _along(channels: Channels, current: str, position: str, step: float) -> tuple[float, float]:
    """Time from the current to the velocity: the travel's rate against the current itself, summed."""
    return follows(np.cumsum(channels[current]) * step, channels[position], step)


def _said(late: float) -> str:
    return f"{abs(late) * 1e3:.0f} ms {'after' if late > 0.0 else 'before'}"


def _advance(field: str, late: float) -> Advance:
    rounded = round(late, 4)
    return Advance(field, f"{field} was recorded about {_spoken(rounded)}", delay=rounded)


def _spoken(late: float) -> str:
    return f"{abs(late) * 1e3:.3g} ms {'late' if late > 0.0 else 'early'}"
