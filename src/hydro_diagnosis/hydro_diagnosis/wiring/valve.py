# SPDX-License-Identifier: Apache-2.0
"""Checks that piston and pressures follow the valve."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydro_diagnosis.wiring.complaint import AGAINST, TOGETHER, Complaint, stands
from hydro_diagnosis.wiring.forces import made_force
from hydro_diagnosis.wiring.repairs import Channels, Exchange, Rename, reversed_sign
from hydro_diagnosis.wiring.signals import correlation, slow
from hydro_sim.model.bench import Bench


def current_and_motion(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the piston follows the valve, apart from the force for which a leaking valve opens too."""
    if not {"valve_current", "piston_position"} <= channels.keys() or stands(channels, bench):
        return
    current, position = slow(channels["valve_current"], step), slow(channels["piston_position"], step)
    together = correlation(current, np.gradient(position), position)
    if correlation(current, position) > TOGETHER and abs(together) < -AGAINST:
        yield Complaint(
            "piston_position goes with the current, as the velocity does",
            (Rename("piston_position", "piston_position is the velocity", becomes="piston_velocity"),),
        )
    if together < AGAINST:
        yield Complaint(
            f"the piston runs against the valve_current (correlation {together:.2f})",
            (reversed_sign("valve_current"), reversed_sign("piston_position")),
        )


def current_and_pressures(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the pressures' force grows while the valve feeds chamber A, with a load that yields."""
    if not {"valve_current", "pressure_a", "pressure_b"} <= channels.keys() or stands(channels, bench):
        return
    force = slow(made_force(channels, bench), step)
    together = correlation(slow(channels["valve_current"], step), np.gradient(force), force)
    if together < AGAINST:
        yield Complaint(
            f"A_p p_a - alpha A_p p_b falls while the valve_current feeds chamber A (correlation {together:.2f})",
            (
                reversed_sign("valve_current"),
                Exchange("pressure_a", "pressure_a and pressure_b are exchanged", other="pressure_b"),
            ),
        )
