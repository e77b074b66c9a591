# SPDX-License-Identifier: Apache-2.0
"""Checks of the hydraulic force against the pressures, and of the spring's force against its travel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.wiring.complaint import AGAINST, SIZE, TOGETHER, VELOCITY, Complaint, stands
from hydro_diagnosis.wiring.repairs import Channels, Exchange, Rename, Repair, in_unit, reversed_sign
from hydro_diagnosis.wiring.signals import correlation, slope, slow
from hydro_sim.model.bench import Bench

LEVEL = 0.2
"""Share of piston area times supply pressure by which a force may constantly differ from that of the pressures."""


def force_and_pressures(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the hydraulic force is that of the pressures on the piston."""
    if not {"hydraulic_force", "pressure_a", "pressure_b"} <= channels.keys():
        return
    force, made = slow(channels["hydraulic_force"], step), slow(made_force(channels, bench), step)
    together = correlation(force, made)
    exchanged = Exchange("pressure_a", "pressure_a and pressure_b are exchanged", other="pressure_b")
    if together < AGAINST:
        yield Complaint(
            f"hydraulic_force goes against A_p p_a - alpha A_p p_b (correlation {together:.2f})",
            (reversed_sign("hydraulic_force"), exchanged),
        )
    elif together > TOGETHER and not 1.0 / SIZE < slope(force, made) < SIZE:
        size = slope(force, made)
        yield Complaint(
            f"hydraulic_force is {size:.3g} times A_p p_a - alpha A_p p_b", tuple(_force_units("hydraulic_force", size))
        )
    level = abs(float(np.median(force - made)))
    other_way = slow(made_force(exchanged.apply(channels, step), bench), step)
    nearer = abs(float(np.median(force - other_way))) < 0.5 * level
    if level > LEVEL * bench.piston_area * bench.supply_pressure and nearer and not together < AGAINST:
        yield Complaint(
            f"hydraulic_force differs from A_p p_a - alpha A_p p_b by {level:.3g} N all along", (exchanged,)
        )


def made_force(channels: Channels, bench: Bench) -> FloatArray:
    """A_p p_a - alpha A_p p_b [N]."""
    return np.asarray(bench.piston_area * (channels["pressure_a"] - bench.area_ratio * channels["pressure_b"]))


def force_and_spring(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the load's force grows as the spring is compressed."""
    if not {"load_force", "piston_position"} <= channels.keys() or stands(channels, bench):
        return
    force, position = slow(channels["load_force"], step), slow(channels["piston_position"], step)
    together = correlation(force, position)
    rates = correlation(np.gradient(force), position)
    if abs(together) < -AGAINST and abs(rates) > VELOCITY and _goes_with_current(channels, step):
        yield Complaint(
            f"load_force changes as piston_position (correlation {rates:.2f}), as it would with the velocity",
            (Rename("piston_position", "piston_position is the velocity", becomes="piston_velocity"),),
        )
    elif together < AGAINST:
        yield Complaint(
            f"load_force falls as piston_position grows (correlation {together:.2f})",
            (reversed_sign("load_force"), reversed_sign("piston_position")),
        )
    elif together > TOGETHER:
        size = slope(force, position) / bench.spring_stiffness
        if not 1.0 / SIZE < size < SIZE:
            yield Complaint(f"load_force is {size:.3g} times the spring's", tuple(_force_units("load_force", size)))


def _goes_with_current(channels: Channels, step: float) -> bool:
    """Whether what is called the position goes with the current, as only the velocity does; true without a current."""
    if "valve_current" not in channels:
        return True
    current, position = slow(channels["valve_current"], step), slow(channels["piston_position"], step)
    return abs(correlation(current, position)) > VELOCITY


def forces(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the piston's force arrives at the load."""
    if not {"hydraulic_force", "load_force"} <= channels.keys() or stands(channels, bench):
        return
    together = correlation(slow(channels["hydraulic_force"], step), slow(channels["load_force"], step))
    if together < AGAINST:
        yield Complaint(
            f"load_force goes against hydraulic_force (correlation {together:.2f})",
            (reversed_sign("load_force"), reversed_sign("hydraulic_force")),
        )


def _force_units(field: str, size: float) -> Iterator[Repair]:
    """Units of force by which it would be of the right size."""
    for unit in ("kN", "daN", "lbf"):
        if 1.0 / SIZE < size * in_unit(field, unit).factor < SIZE:
            yield in_unit(field, unit)
