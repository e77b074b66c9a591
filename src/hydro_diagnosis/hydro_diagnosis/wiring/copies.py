# SPDX-License-Identifier: Apache-2.0
"""Check that no sensor copies another."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from hydro_diagnosis.recording import MEASURED
from hydro_diagnosis.wiring.complaint import Complaint
from hydro_diagnosis.wiring.forces import made_force
from hydro_diagnosis.wiring.repairs import Channels, Rename
from hydro_diagnosis.wiring.signals import correlation, follows, slope, slow
from hydro_sim.model.bench import Bench

FRICTION_LATE = 5e-3
"""s: a force that comes so long after the pressures is the load's."""


def copies(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check for copies: two sensors never have the same noise."""
    sensors = [name for name in (*MEASURED, "valve_current") if name in channels and np.ptp(channels[name]) > 0.0]
    for one, other in combinations(sensors, 2):
        first, second = channels[one], channels[other]
        size = slope(second, first)
        left = second - second.mean() - size * (first - first.mean())
        if float(np.std(left)) < 1e-6 * float(np.std(second)):
            wrong, right = (one, other) if _second_is_right(one, other, channels, step, bench) else (other, one)
            yield Complaint(
                f"{one} and {other} are the same, noise and all",
                (Rename(wrong, f"{wrong} holds the column of {right}: name its own, or leave it out"),),
            )


def _second_is_right(one: str, other: str, channels: Channels, step: float, bench: Bench) -> bool:
    """Of two sensors with the same numbers, whether those are rather what the second reads."""
    if {one, other} == {"pressure_a", "pressure_b"} and "hydraulic_force" in channels:
        return correlation(slow(channels["hydraulic_force"], step), slow(channels[one], step)) < 0.0
    if {one, other} == {"hydraulic_force", "load_force"} and {"pressure_a", "pressure_b"} <= channels.keys():
        late, _ = follows(made_force(channels, bench), channels["hydraulic_force"], step)
        return late > FRICTION_LATE
    return False
