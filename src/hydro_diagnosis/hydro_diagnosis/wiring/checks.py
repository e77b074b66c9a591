# SPDX-License-Identifier: Apache-2.0
"""What every bench of this kind does, whatever else is wrong with it; each check with the mistakes that break it.

A force goes with the pressures that make it, a spring's with its travel, the piston runs where the valve sends it,
numbers are of the size of the bench's, and no sensor copies another. The margins are several times what any effect of
the table does to a recording (column_maps.md, "Mistakes of wiring and units").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.recording import MEASURED
from hydro_diagnosis.wiring.repairs import Channels, Exchange, Rename, Repair, Scale, in_unit, reversed_sign
from hydro_diagnosis.wiring.signals import correlation, follows, slope, slow
from hydro_sim.model.bench import Bench

AGAINST = -0.5
"""Correlation below which two channels go against each other."""
TOGETHER = 0.9
"""Correlation above which their sizes can be compared."""
VELOCITY = 0.8
"""Correlation with the rate of the load's force, and with the current, above which a position is a velocity."""
SIZE = 3.0
"""Times by which forces may differ from what pressures or spring make."""
PRESSURES = (0.05, 3.0)
"""Highest pressures, of the supply's, that a bench can have."""
BEYOND = 1.5
"""Of stroke or largest current, above which a number is in another unit."""
MARGIN = 0.05
"""Of the stroke, by which a position may lie outside of it."""
LEVEL = 0.2
"""Of the piston area times the supply pressure, by which a force may differ from the pressures' all along."""
FRICTION_LATE = 5e-3
"""s: a force that comes so long after the pressures is the load's."""
MOVES = 1e-3
"""Of the stroke: a piston that moves less shows neither sign nor size."""
_PRESSURE_UNITS = ("bar", "kPa", "MPa", "psi", "hPa")
_LENGTH_UNITS = ("mm", "cm", "um", "in")


@dataclass(frozen=True)
class Complaint:
    """Something no bench does."""

    sentence: str
    suspects: tuple[Repair, ...]
    """Mistakes that would explain it, the likeliest first."""


Check = Callable[[Channels, float, Bench], Iterator[Complaint]]


def pressure_sizes(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Pressures reach some share of the supply's."""
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
    """The piston stays within the stroke, which begins at 0."""
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
    """Whether the position times `factor` compresses the spring about as much as the load's force says."""
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
    """Where the position's zero lies, judged by the spring, else from the middle of the stroke."""
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
    """The current stays within what the valve takes."""
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


def force_and_pressures(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """The hydraulic force is what the pressures make on the piston."""
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
    """The load's force grows as the spring is compressed."""
    if not {"load_force", "piston_position"} <= channels.keys() or _stands(channels, bench):
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
    """What the piston pushes with arrives at the load."""
    if not {"hydraulic_force", "load_force"} <= channels.keys() or _stands(channels, bench):
        return
    together = correlation(slow(channels["hydraulic_force"], step), slow(channels["load_force"], step))
    if together < AGAINST:
        yield Complaint(
            f"load_force goes against hydraulic_force (correlation {together:.2f})",
            (reversed_sign("load_force"), reversed_sign("hydraulic_force")),
        )


def current_and_motion(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """The piston runs where the valve sends it, the force aside for which a leaking valve opens too."""
    if not {"valve_current", "piston_position"} <= channels.keys() or _stands(channels, bench):
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
    """With a load that yields, the pressures' force grows while the valve feeds chamber A."""
    if not {"valve_current", "pressure_a", "pressure_b"} <= channels.keys() or _stands(channels, bench):
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


def copies(channels: Channels, step: float, bench: Bench) -> Iterator[Complaint]:
    """Two sensors never have the same noise."""
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


def _force_units(field: str, size: float) -> Iterator[Repair]:
    """Units of force by which it would be of the right size."""
    for unit in ("kN", "daN", "lbf"):
        if 1.0 / SIZE < size * in_unit(field, unit).factor < SIZE:
            yield in_unit(field, unit)


def _stands(channels: Channels, bench: Bench) -> bool:
    """Whether the piston hardly moves, so that nothing can be said of how channels go with it."""
    if "piston_position" not in channels:
        return False
    return float(np.ptp(channels["piston_position"])) < MOVES * bench.stroke


CHECKS: tuple[Check, ...] = (
    copies,
    pressure_sizes,
    position_sizes,
    current_sizes,
    force_and_pressures,
    force_and_spring,
    forces,
    current_and_motion,
    current_and_pressures,
)
"""In the order in which they are told."""
