# SPDX-License-Identifier: Apache-2.0
"""Bench files with unknown parameters, and the parameters that each equation requires.

An unknown parameter has a stand-in value, which no residual uses, which passes every check of magnitudes, and which is
never written. Viscous friction and spring have none: if they are not given, the bench is taken to lack them.

The motion equation is checked if the hydraulic force is recorded, or if the pressures are and the mass is known.
Viscous friction and spring are part of it if the bench has them. Without a spring a load cell measures the force
transmitted by the rod, and is part of the motion equation: m x_p'' = f_h - f_l - friction.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from hydro_core.bench_scales import BenchScales
from hydro_core.settings import quantity, read_yaml
from hydro_core.signals import FloatArray
from hydro_diagnosis.effects.base import HYDRAULIC, LOAD, MOTION, PRESSURE, Effect
from hydro_diagnosis.recording import InputError, Segment
from hydro_sim.model.bench import NOMINAL, Bench

SPRING_PARAMETERS = ("spring_stiffness", "spring_rest_position")
OPTIONAL_PARAMETERS = {"viscous_friction": 0.0, "spring_stiffness": 0.0, "spring_rest_position": 0.0}
"""Optional parameters of a bench, with their values if not given."""


@dataclass(frozen=True, kw_only=True)
class PartialBench(Bench):
    """A bench with unknown parameters, or without a spring."""

    spring_stiffness: Annotated[float, quantity("N/m", 0.0, 1e8)]
    """0: no spring."""
    unknown: frozenset[str] = frozenset()
    """Parameters that have stand-in values."""
    absent: frozenset[str] = frozenset()
    """Parameters of `OPTIONAL_PARAMETERS` that were not given: the bench has none, unless a diagnosis names some."""
    recorded: BenchScales = NOMINAL
    """Size by the recordings, where the bench file does not tell."""

    @property
    def size(self) -> BenchScales:
        """Scales of its forces, pressures, lengths and currents, those of the recordings for what is unknown."""
        return replace(
            self.recorded, **{
                name: one for name, one in vars(super().size).items() if not self.unknown & set(_SIZES[name])
            }
        )  # fmt: skip

    def to_mapping(self) -> dict[str, Any]:
        """Return the known parameters by key."""
        still = {name for name in self.absent if getattr(self, name) == OPTIONAL_PARAMETERS[name]}
        hidden = {"unknown", "absent", "recorded", *self.unknown, *still}
        return {key: value for key, value in super().to_mapping().items() if key not in hidden}


_SIZES = {"force": ("piston_area", "supply_pressure"), "pressure": ("supply_pressure",), "length": ("stroke",),
          "current": ("valve_current_max",)}  # fmt: skip
"""Parameters of the bench file that tell each of its sizes."""


def recorded_size(bench: Bench, segments: Sequence[Segment]) -> BenchScales:
    """Return the size of the machine by its recordings: half the range of what varies, and the range commanded.

    1 of its unit where nothing is recorded.
    """

    def half_range(signals: Iterable[FloatArray]) -> float:
        return max((0.5 * float(np.ptp(one)) for one in signals), default=0.0) or 1.0

    def recorded(*names: str) -> list[FloatArray]:
        return [one.channels[name] for one in segments for name in names if name in one.channels]

    forces = recorded("hydraulic_force", "load_force") or [
        bench.piston_area * (one.channels["pressure_a"] - bench.area_ratio * one.channels["pressure_b"])
        for one in segments
        if {"pressure_a", "pressure_b"} <= one.channels.keys()
    ]
    return BenchScales(
        force=half_range(forces), pressure=2.0 * half_range(recorded("pressure_a", "pressure_b")),
        length=2.0 * half_range(recorded("piston_position")),
        current=max((float(np.max(np.abs(one))) for one in recorded("valve_current")), default=0.0) or 1.0,
    )  # fmt: skip


def is_known(bench: Bench, *names: str) -> bool:
    """Return whether these parameters of a bench are known, not stand-ins."""
    return not (isinstance(bench, PartialBench) and bench.unknown & set(names))


def has_spring(bench: Bench) -> bool:
    """Return whether a bench has a spring."""
    return bench.spring_stiffness > 0.0


def is_missing(bench: Bench, name: str) -> bool:
    """Return whether a parameter is not given by the bench file."""
    return isinstance(bench, PartialBench) and name in bench.unknown | bench.absent


def mark_unknown(bench: Bench, names: Collection[str]) -> Bench:
    """Return the bench with these parameters marked as unknown: their values are stand-ins."""
    if not names:
        return bench
    values = {entry.name: getattr(bench, entry.name) for entry in fields(bench)}
    return PartialBench(**{**values, "unknown": values.get("unknown", frozenset()) | frozenset(names)})


def read_bench(path: str | Path, estimated: frozenset[str] = frozenset()) -> Bench:
    """Read a bench file in which parameters may be missing: a `Bench` if it is complete, else a `PartialBench`.

    `path`: bench.yaml or corrected.yaml. `estimated`: parameters to be estimated; those not given, even if in
    `OPTIONAL_PARAMETERS`, are unknown rather than absent. Raises ValueError: as `Bench.load`.
    """
    content = read_yaml(path)
    try:
        return parse_bench(content, estimated)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def parse_bench(content: Mapping[str, Any], estimated: frozenset[str] = frozenset()) -> Bench:
    """Return the bench of a file's content: a `Bench` if it is complete, else a `PartialBench`.

    `estimated` and errors: as of `read_bench`.
    """
    springless = content.get("spring_stiffness") == 0
    missing = frozenset(name for name in bench_parameter_names() if name not in content)
    if not missing and not springless:
        return Bench.from_mapping(content)
    half_a_spring = not springless and any(name in content or name in estimated for name in SPRING_PARAMETERS)
    absent = (
        (frozenset(OPTIONAL_PARAMETERS) & missing)
        - estimated
        - (frozenset(SPRING_PARAMETERS) if half_a_spring else frozenset())
    )
    out_of_reach = {"stroke": 5.0, "valve_current_max": 10.0}  # of any recording
    stand_ins = {**Bench.nominal().to_mapping(), **out_of_reach, **dict.fromkeys(absent, 1.0)}
    whole = Bench.from_mapping(
        {**{name: stand_ins[name] for name in missing}, **content, **({"spring_stiffness": 1.0} if springless else {})}
    )
    values = {entry.name: getattr(whole, entry.name) for entry in fields(whole)}
    values |= {name: OPTIONAL_PARAMETERS[name] for name in absent} | ({"spring_stiffness": 0.0} if springless else {})
    return PartialBench(**values, unknown=missing - absent, absent=absent)


def bench_parameter_names() -> tuple[str, ...]:
    """Names of the parameters in a complete bench file, in the order of `Bench`."""
    return tuple(name for name in Bench.quantities() if name != "load_cell_bandwidth")


def with_known_values(bench: Bench, **values: float) -> Bench:
    """Return the bench with these parameters replaced and marked as known."""
    if not isinstance(bench, PartialBench):
        return replace(bench, **values)  # type: ignore[arg-type]
    return replace(bench, unknown=bench.unknown - values.keys(), **values)  # type: ignore[arg-type]


class UnknownParameterError(Exception):
    """An unknown parameter of a bench was read."""


class GuardedBench:
    """Proxy of a bench that raises `UnknownParameterError` when an unknown parameter is read."""

    def __init__(self, bench: Bench, unknown: frozenset[str]) -> None:
        self._bench, self._unknown = bench, unknown

    def __getattr__(self, name: str) -> Any:
        determining = {"valve_nominal_flow", "valve_nominal_current", "valve_nominal_pressure_drop"}
        if name in self._unknown or (name == "valve_gain" and self._unknown & determining):
            raise UnknownParameterError(name)
        return getattr(self._bench, name)


def guard_unknown(bench: Bench) -> Bench:
    """Return a bench that raises `UnknownParameterError` when a stand-in or an absent parameter is read."""
    if not isinstance(bench, PartialBench):
        return bench
    return cast(Bench, GuardedBench(bench, bench.unknown | bench.absent))


@dataclass(frozen=True)
class EquationRequirement:
    """Availability of an equation: the recorded channels and the bench parameters that it requires."""

    block: str
    """Block of residuals: PRESSURE, MOTION, LOAD or HYDRAULIC."""
    equation: str
    """Name of the equation, as printed."""
    channels: frozenset[str]
    parameters: tuple[str, ...]
    """Bench parameters that the equation requires."""
    if_known: str = ""
    """Parameter without which the equation is omitted, rather than the bench file refused."""


EQUATION_REQUIREMENTS = (
    EquationRequirement(
        PRESSURE, "pressure equations", frozenset({"pressure_a", "pressure_b", "piston_position", "valve_current"}),
        ("bulk_modulus", "piston_area", "area_ratio", "stroke", "supply_pressure", "tank_pressure",
         "valve_nominal_flow", "valve_nominal_current", "valve_nominal_pressure_drop", "dead_volume_a",
         "dead_volume_b"),
    ),
    EquationRequirement(MOTION, "motion equation", frozenset({"hydraulic_force", "piston_position"}), ("moving_mass",)),
    EquationRequirement(
        MOTION, "motion equation", frozenset({"pressure_a", "pressure_b", "piston_position"}),
        ("moving_mass", "piston_area", "area_ratio"), if_known="moving_mass",
    ),
    EquationRequirement(LOAD, "load equation", frozenset({"load_force", "piston_position"}), SPRING_PARAMETERS),
    EquationRequirement(
        HYDRAULIC, "force of the pressures", frozenset({"pressure_a", "pressure_b", "hydraulic_force"}),
        ("piston_area", "area_ratio"),
    ),
)  # fmt: skip


def load_cell_at_rod(channels: Collection[str], bench: Bench) -> bool:
    """Return whether the load cell is in the motion equation: hydraulic force or pressures recorded, and no spring."""
    driven = {"hydraulic_force"} <= set(channels) or {"pressure_a", "pressure_b"} <= set(channels)
    return {"load_force", "piston_position"} <= set(channels) and driven and not has_spring(bench)


def available_equations(channels: Collection[str], bench: Bench) -> tuple[EquationRequirement, ...]:
    """Return the equations that the recorded channels make available."""
    measured = load_cell_at_rod(channels, bench)
    return tuple(
        one
        for one in EQUATION_REQUIREMENTS
        if one.channels <= set(channels)
        and (not one.if_known or is_known(bench, one.if_known))
        and not (measured and one.block == LOAD)
    )


def require_equation(channels: Collection[str], bench: Bench, notes: Sequence[str] = ()) -> None:
    """Raise `InputError` if no equation can be checked, with the missing channels, and `notes` on omitted ones."""
    if available_equations(channels, bench):
        return
    ways = dict.fromkeys(
        f"{', '.join(sorted(one.channels - set(channels)))} ({one.equation})"
        for one in sorted(EQUATION_REQUIREMENTS, key=lambda one: len(one.channels - set(channels)))
        if not one.if_known or is_known(bench, one.if_known)
    )
    lost = [note for note in notes if "left out" in note]
    raise InputError(
        f"no equation can be checked with {', '.join(sorted(channels)) or 'nothing'}: lacking is "
        + ", or ".join(ways)
        + "".join(f"; {note}" for note in lost)
    )


def required_parameters(channels: Collection[str], bench: Bench) -> dict[str, str]:
    """Return the bench parameters that the recorded channels require, each with the first equation that needs it."""
    found: dict[str, str] = {}
    for one in available_equations(channels, bench):
        spring = (
            SPRING_PARAMETERS
            if one.block == MOTION and any(not is_known(bench, name) for name in SPRING_PARAMETERS)
            else ()
        )
        for name in (*one.parameters, *spring):
            found.setdefault(name, one.equation)
    return found


def require_parameters(channels: Collection[str], bench: Bench, estimated: Collection[str] = ()) -> None:
    """Raise `InputError` if required parameters are neither known nor estimated; the message lists all of them."""
    lacking = {
        name: equation
        for name, equation in required_parameters(channels, bench).items()
        if is_missing(bench, name) and name not in estimated
    }
    if not lacking:
        return
    asked = ", ".join(f"{name} ({Bench.quantities()[name].unit}, {equation})" for name, equation in lacking.items())
    raise InputError(f"the bench file lacks {asked}: write them there, or add --estimate {' '.join(lacking)}")


def omission_notes(channels: Collection[str], bench: Bench) -> list[str]:
    """Return notes on the consequences of parameters that the bench file lacks, one sentence each.

    On every equation that is not checked, every coefficient that is assumed zero, and on a load cell that is part of
    the motion equation because the bench has no spring.
    """
    if not isinstance(bench, PartialBench):
        return []
    blocks = {one.block for one in available_equations(channels, bench)}
    notes = [
        f"the {one.equation} was left out: the bench file does not hold {one.if_known}"
        for one in EQUATION_REQUIREMENTS
        if one.if_known and one.channels <= set(channels) and one.block not in blocks
    ]
    if load_cell_at_rod(channels, bench) and MOTION in blocks:
        notes.append("load_force is part of the motion's balance, as measured at the rod: the bench file has no spring")
    absent = [name for name in ("viscous_friction", "spring_stiffness") if name in bench.absent]
    if absent and MOTION in blocks:
        words = " and no ".join(name.replace("_", " ") for name in absent)
        notes.append(f"the bench file holds no {words}: none is assumed")
    return notes


def applies(effect: Effect, bench: Bench) -> bool:
    """Return whether a bench file has the parameters that an effect needs; one of the load also needs a spring."""
    if not isinstance(bench, PartialBench):
        return True
    if effect.equations[:1] == ("load",) and not has_spring(bench):
        return False
    try:
        effect.adapted(cast(Bench, GuardedBench(bench, bench.unknown)))
    except UnknownParameterError:
        return False
    return True


def can_simulate(bench: Bench) -> bool:
    """Return whether the bench can be simulated: all parameters are known, and a partial bench has a spring."""
    return not isinstance(bench, PartialBench) or (not bench.unknown and has_spring(bench))
