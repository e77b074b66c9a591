# SPDX-License-Identifier: Apache-2.0
"""Checks of magnitude: pressures, positions and currents against supply, stroke and valve."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydro_diagnosis.wiring.complaint import MOVES, SIZE, TOGETHER, Complaint
from hydro_diagnosis.wiring.repairs import Channels, Repair, Scale, in_unit
from hydro_diagnosis.wiring.signals import correlation, slope, slow
from hydro_sim.model.bench import Bench

PRESSURES = (0.05, 3.0)
"""Range of the highest pressure, over that of the supply, that a bench can have."""
BEYOND = 1.5
"""Multiple of the stroke or largest current above which a number is in another unit."""
MARGIN = 0.05
"""Share of the stroke by which a position may lie outside of it."""
_PRESSURE_UNITS = ("bar", "kPa", "MPa", "psi", "hPa")
_LENGTH_UNITS = ("mm", "cm", "um", "in")


def pressure_sizes(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the pressures reach a share of the supply's."""
    for name in ("pressure_a", "pressure_b"):
        if name not in channels:
            continue
        share = float(np.quantile(channels[name], 0.99)) / bench.supply_pressure
        if share > PRESSURES[1] or share < PRESSURES[0]:
            alive = float(np.quantile(channels[name], 0.05)) > -0.02 * share * bench.supply_pressure
            units = [in_unit(name, unit) for unit in _PRESSURE_UNITS if alive]
            fitting = [one for one in units if PRESSURES[0] < one.factor * share < PRESSURES[1]]
            fitting.sort(key=lambda one: abs(float(np.log(one.factor * share / 0.6))))
            yield Complaint(
                f"{name} reaches {share * bench.supply_pressure:.3g} Pa, the supply has {bench.supply_pressure:.3g} Pa",
                tuple(fitting),
            )


def position_sizes(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the piston stays within the stroke, which begins at 0."""
    if "piston_position" not in channels:
        return
    position = channels["piston_position"]
    low, high = float(position.min()) / bench.stroke, float(position.max()) / bench.stroke
    said = f"piston_position runs from {position.min():.4g} to {position.max():.4g} m, the stroke is {bench.stroke:g} m"
    if max(-low, high) > BEYOND:
        units = [in_unit("piston_position", unit) for unit in _LENGTH_UNITS]
        fitting = [one for one in units if _fits_spring(one.factor, channels, step, bench)]
        yield Complaint(said, (*fitting, *_counts(channels, step, bench)))
    elif low < -MARGIN or high > 1.0 + MARGIN:
        yield Complaint(f"{said} and begins where chamber A is smallest", tuple(_zeros(channels, step, bench)))


def _fits_spring(factor: float, channels: Channels, step: float, bench: Bench) -> bool:
    """Return whether the position times `factor` compresses the spring about as much as the load's force says."""
    span = factor * float(np.ptp(channels["piston_position"]))
    if "load_force" in channels:
        force, position = slow(channels["load_force"], step), slow(channels["piston_position"], step)
        if abs(correlation(force, position)) > TOGETHER:
            return 1.0 / SIZE < abs(slope(force, position)) / factor / bench.spring_stiffness < SIZE
    return MOVES * bench.stroke < span <= (1.0 + 2.0 * MARGIN) * bench.stroke


def _counts(channels: Channels, step: float, bench: Bench) -> Iterator[Repair]:
    """The size of one count, judged by the spring."""
    if "load_force" not in channels:
        return
    force, position = slow(channels["load_force"], step), slow(channels["piston_position"], step)
    if abs(correlation(force, position)) > TOGETHER:
        factor = abs(slope(force, position)) / bench.spring_stiffness
        factor = float(f"{factor:.2g}")
        yield Scale(
            "piston_position",
            f"piston_position is in counts of about {factor:.2g} m (judged by the spring: write the encoder's own)",
            factor=factor,
        )


def _zeros(channels: Channels, step: float, bench: Bench) -> Iterator[Repair]:
    """Zero of the position, judged by the spring, else from the middle of the stroke."""
    position = slow(channels["piston_position"], step)
    offset, judged = 0.5 * bench.stroke - 0.5 * float(position.min() + position.max()), "the middle of what it travels"
    if "load_force" in channels:
        force = slow(channels["load_force"], step)
        if correlation(force, position) > TOGETHER:
            offset = bench.spring_rest_position + float(np.median(force / bench.spring_stiffness - position))
            judged = "the spring's force"
    offset = float(f"{offset:.3g}")
    yield Scale(
        "piston_position",
        f"piston_position has its zero elsewhere (judged by {judged}: write what was measured)",
        offset=offset,
    )


def current_sizes(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Check that the current stays within the valve's limit."""
    if "valve_current" not in channels:
        return
    largest = float(np.max(np.abs(channels["valve_current"])))
    limit = bench.valve_current_max
    if largest <= BEYOND * limit:
        return
    scales = [
        in_unit("valve_current", "mA"),
        Scale("valve_current", f"valve_current is a share of {limit:g} A", factor=limit),
        Scale("valve_current", f"valve_current is in volts, 10 V for {limit:g} A", factor=limit / 10.0),
        Scale("valve_current", f"valve_current is in per cent of {limit:g} A", factor=limit / 100.0),
    ]
    fitting = [one for one in scales if one.factor * largest <= BEYOND * limit]
    fitting.sort(key=lambda one: abs(float(np.log(max(_opening(channels, step, bench, one.factor), 1e-9)))))
    yield Complaint(f"valve_current reaches {largest:.3g} A, the valve takes {limit:g} A", tuple(fitting))


def _opening(channels: Channels, step: float, bench: Bench, factor: float) -> float:
    """Flow that the current would pass, over what the piston displaces; 1 where that cannot be said."""
    if "piston_position" not in channels:
        return 1.0
    velocity = np.gradient(slow(channels["piston_position"], step)) / max(step, 0.01)
    flow = slow(factor * channels["valve_current"], step) * bench.valve_gain * (bench.supply_pressure / 2.0) ** 0.5
    return abs(slope(flow, bench.piston_area * velocity))
