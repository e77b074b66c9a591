# SPDX-License-Identifier: Apache-2.0
"""Size of a bench: scales of force, pressure, length and current, to which all values of these units are relative.

Similar benches (all forces scaled by one factor, all lengths by another ...) differ by their size alone: observations,
rewards and verdicts are the same. Times are not scaled, and neither are gains [1/s].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass, replace
from typing import Annotated, Any, TypeVar

from hydro_core.settings import describe, quantity

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class BenchScales:
    """Scales of a bench: force, pressure, length and current."""

    force: Annotated[float, quantity("N", 1e-3, 1e7, "Usual amplitude of a reference")]
    pressure: Annotated[float, quantity("Pa", 1e5, 1e8, "Of the supply")]
    length: Annotated[float, quantity("m", 1e-3, 5.0, "Stroke")]
    current: Annotated[float, quantity("A", 1e-4, 10.0, "At which the valve saturates")]

    @classmethod
    def of_bench(cls, bench: Mapping[str, Any]) -> BenchScales:
        """Return the size of a bench from its parameters; the force is 3/32 of piston area times supply pressure."""
        return cls(
            force=bench["piston_area"] * bench["supply_pressure"] * 0.09375,
            pressure=bench["supply_pressure"],
            length=bench["stroke"],
            current=bench["valve_current_max"],
        )

    @classmethod
    def of_known_bench(cls, bench: Mapping[str, Any] | None) -> BenchScales | None:
        """Return the size of a bench from a box's bench file; None if the file is unknown or incomplete."""
        needed = ("piston_area", "supply_pressure", "stroke", "valve_current_max")
        complete = isinstance(bench, Mapping) and all(bench.get(name) for name in needed)
        return cls.of_bench(bench) if bench and complete else None


_EXPONENTS: Mapping[str, tuple[float, float, float, float]] = {
    "N": (1, 0, 0, 0), "N/s": (1, 0, 0, 0), "Pa": (0, 1, 0, 0), "m": (0, 0, 1, 0), "m/s": (0, 0, 1, 0),
    "A": (0, 0, 0, 1), "A/s": (0, 0, 0, 1), "N/m": (1, 0, -1, 0), "N s/m": (1, 0, -1, 0), "kg": (1, 0, -1, 0),
    "N/m3": (1, 0, -3, 0), "m3": (1, -1, 1, 0), "m3/s": (1, -1, 1, 0), "m3/Pa": (1, -2, 1, 0),
    "m3/s/Pa": (1, -2, 1, 0), "m3/s/sqrt(Pa)": (1, -1.5, 1, 0),
    "Pa s/m3": (-1, 2, -1, 0),
}  # fmt: skip
"""Exponents of force, pressure, length and current by unit; areas are forces over pressures."""


def unit_ratio(unit: str, before: BenchScales, after: BenchScales) -> float:
    """Return the ratio of values of a unit on a bench of size `after` to those on a similar one of size `before`."""
    force, pressure, length, current = _EXPONENTS.get(unit, (0, 0, 0, 0))
    return float(
        (after.force / before.force) ** force * (after.pressure / before.pressure) ** pressure
        * (after.length / before.length) ** length * (after.current / before.current) ** current
    )  # fmt: skip


def rescale(settings: T, before: BenchScales, after: BenchScales) -> T:
    """Return settings scaled from a bench of size `before` to a similar one of size `after`, each value by its unit."""
    changed: dict[str, Any] = {}
    for name, setting in describe(type(settings)).items():
        value = getattr(settings, name)
        if isinstance(value, BenchScales):
            changed[name] = after
        elif is_dataclass(value):
            changed[name] = rescale(value, before, after)
        elif setting.unit in _EXPONENTS and value is not None:
            changed[name] = value * unit_ratio(setting.unit, before, after)
    return replace(settings, **changed)  # type: ignore[type-var]
