# SPDX-License-Identifier: Apache-2.0
"""The numbers of a bench that each equation needs, and the recorded channels that bring it in.

A force that only the pressures tell brings the motion equation in where the mass is known; a force cell always does.
Viscous friction and spring are in the motion equation where the bench has them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, fields
from typing import cast

from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Effect
from hydro_diagnosis.partial_bench import (
    SPRING,
    Guarded,
    PartialBench,
    UnknownNumberError,
    has_spring,
    knows,
    lacks,
)
from hydro_diagnosis.recording import InputError
from hydro_sim.model.bench import Bench


@dataclass(frozen=True)
class Connection:
    """Channels that together bring an equation in."""

    block: str
    """Block of residuals: PRESSURE, MOTION, LOAD or HYDRAULIC."""
    equation: str
    """Words for it."""
    channels: frozenset[str]
    numbers: tuple[str, ...]
    """Numbers of the bench that it needs."""
    if_known: str = ""
    """Number without which the equation is left out instead of asking for it."""


CONNECTIONS = (
    Connection(
        PRESSURE,
        "pressure equations",
        frozenset({"pressure_a", "pressure_b", "piston_position", "valve_current"}),
        ("bulk_modulus", "piston_area", "area_ratio", "stroke", "supply_pressure", "tank_pressure",
         "valve_nominal_flow", "valve_nominal_current", "valve_nominal_pressure_drop", "dead_volume_a",
         "dead_volume_b"),
    ),
    Connection(MOTION, "motion equation", frozenset({"hydraulic_force", "piston_position"}), ("moving_mass",)),
    Connection(
        MOTION,
        "motion equation",
        frozenset({"pressure_a", "pressure_b", "piston_position"}),
        ("moving_mass", "piston_area", "area_ratio"),
        if_known="moving_mass",
    ),
    Connection(LOAD, "load equation", frozenset({"load_force", "piston_position"}), SPRING),
    Connection(
        HYDRAULIC,
        "force of the pressures",
        frozenset({"pressure_a", "pressure_b", "hydraulic_force"}),
        ("piston_area", "area_ratio"),
    ),
)  # fmt: skip


def connected(channels: Collection[str], bench: Bench) -> tuple[Connection, ...]:
    """Equations that these channels bring in."""
    return tuple(
        one for one in CONNECTIONS if one.channels <= set(channels) and (not one.if_known or knows(bench, one.if_known))
    )


def needed(channels: Collection[str], bench: Bench) -> dict[str, str]:
    """Numbers that the recorded channels need, each with the first equation that needs it."""
    found: dict[str, str] = {}
    for one in connected(channels, bench):
        spring = SPRING if one.block == MOTION and any(not knows(bench, name) for name in SPRING) else ()
        for name in (*one.numbers, *spring):
            found.setdefault(name, one.equation)
    return found


def refuse_missing(channels: Collection[str], bench: Bench, estimated: Collection[str] = ()) -> None:
    """Raise `InputError` if numbers are needed that are neither known nor estimated: all of them in one sentence."""
    lacking = {
        name: equation
        for name, equation in needed(channels, bench).items()
        if lacks(bench, name) and name not in estimated
    }
    if not lacking:
        return
    units = {entry.name: entry.metadata["unit"] for entry in fields(Bench) if entry.metadata}
    asked = ", ".join(f"{name} ({units[name]}, {equation})" for name, equation in lacking.items())
    raise InputError(
        f"the bench file lacks {asked}: write what is known, leave out channels that it is not needed for, or have a "
        f"number estimated from the recordings with --estimate {' '.join(lacking)}"
    )


def left_out(channels: Collection[str], bench: Bench) -> list[str]:
    """Notes on what is not checked or taken as none since the bench file does not hold it."""
    if not isinstance(bench, PartialBench):
        return []
    blocks = {one.block for one in connected(channels, bench)}
    notes = [
        f"the {one.equation} was left out: the bench file does not hold {one.if_known}"
        for one in CONNECTIONS
        if one.if_known and one.channels <= set(channels) and one.block not in blocks
    ]
    absent = [name for name in ("viscous_friction", "spring_stiffness") if name in bench.absent]
    if absent and MOTION in blocks:
        words = " and no ".join(name.replace("_", " ") for name in absent)
        notes.append(f"the bench file holds no {words}: none is assumed")
    return notes


def acts(effect: Effect, bench: Bench) -> bool:
    """Return whether an effect can act on a bench: not one of a spring that it has not, or of a number not known."""
    if not isinstance(bench, PartialBench):
        return True
    if effect.equations[:1] == ("load",) and not has_spring(bench):
        return False
    try:
        effect.adapted(cast(Bench, Guarded(bench, bench.unknown)))
    except UnknownNumberError:
        return False
    return True


def rehearsable(bench: Bench) -> bool:
    """Return whether a run of the bench can be simulated: all numbers are known, and it has a spring."""
    return not isinstance(bench, PartialBench) or (not bench.unknown and has_spring(bench))
