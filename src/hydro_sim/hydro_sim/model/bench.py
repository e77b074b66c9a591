# SPDX-License-Identifier: Apache-2.0
"""Bench files: `bench.yaml` as a validated, immutable value, and the nominal bench.

Names, units and ranges are defined once, in the fields of `Bench`; everything else (loading, checking, the record that
compiled code reads) is derived from them. Values: physics.md, "The nominal bench".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib import resources
from math import isfinite, pi, sqrt
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from hydro_core.bench_scales import BenchScales
from hydro_core.files import bench_digest
from hydro_core.settings import Setting, check, describe, from_mapping, quantity, read_yaml
from hydro_sim.model.effects import catalogue
from hydro_sim.model.quality import Quality


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Parameters, effects and closures of a bench, SI units. Raises ValueError: a value is not within its range."""

    bulk_modulus: Annotated[float, quantity("Pa", 1e7, 1e10, "beta, of oil and hoses together")]
    piston_area: Annotated[float, quantity("m2", 1e-6, 1e-1, "A_p, of chamber A")]
    area_ratio: Annotated[float, quantity("-", 0.05, 1.0, "alpha, area of chamber B over that of chamber A")]
    stroke: Annotated[float, quantity("m", 1e-3, 5.0, "L_c")]
    supply_pressure: Annotated[float, quantity("Pa", 1e5, 1e8, "p_s")]
    tank_pressure: Annotated[float, quantity("Pa", 0.0, 1e7, "p_t, below the supply pressure")]
    valve_nominal_flow: Annotated[float, quantity("m3/s", 1e-7, 1e-1, "q_n, at nominal current and drop of both lands")]
    valve_nominal_current: Annotated[float, quantity("A", 1e-4, 10.0, "u_n")]
    valve_nominal_pressure_drop: Annotated[float, quantity("Pa", 1e4, 1e8, "Delta p_n")]
    valve_current_max: Annotated[float, quantity("A", 1e-4, 10.0, "Magnitude at which the valve current saturates")]
    dead_volume_a: Annotated[float, quantity("m3", 1e-7, 1e-1, "V_dead_a, valve block and hoses")]
    dead_volume_b: Annotated[float, quantity("m3", 1e-7, 1e-1, "V_dead_b")]
    moving_mass: Annotated[float, quantity("kg", 1e-6, 1e7, "m, piston, rod and load together")]
    viscous_friction: Annotated[float, quantity("N s/m", 0.0, 1e9, "b")]
    spring_stiffness: Annotated[float, quantity("N/m", 1.0, 1e8, "k_s, of the environment")]
    spring_rest_position: Annotated[float, quantity("m", -5.0, 5.0, "x_rest, where the spring carries no force")]
    load_cell_bandwidth: Annotated[float, quantity("Hz", 1.0, 1e4, "Load cell's second-order Butterworth")] | None = (
        None
    )
    effects: tuple[Mapping[str, Any], ...] = ()
    """Effects beyond these equations, found by a diagnosis (`corrected.yaml`), as read: `hydro_sim.model.effects`."""
    closures: tuple[Mapping[str, Any], ...] = ()
    """Closures found by a diagnosis, as read: equation, form, parameters (`hydro_sim.model.laws`)."""
    learned: Mapping[str, Any] | None = None
    """Result of `learn`: the `bench` that it was (a digest), and its `Quality`."""

    def __post_init__(self) -> None:
        check(self)
        if self.tank_pressure >= self.supply_pressure:
            raise ValueError(f"tank_pressure is not below supply_pressure {self.supply_pressure:g} Pa")
        if any(effect["id"] == "closure" for effect in self.effects):
            raise ValueError("closures stand under 'closures', not under 'effects'")
        catalogue.check_effects(self.terms)

    @classmethod
    def quantities(cls) -> dict[str, Setting]:
        """Return the declarations of the bench's parameters by name: unit, range, meaning."""
        return {name: setting for name, setting in describe(cls).items() if isfinite(setting.low)}

    @classmethod
    def ranges(cls) -> dict[str, tuple[float, float]]:
        """Return the range of each of the bench's parameters by name."""
        return {name: (float(one.low), float(one.high)) for name, one in cls.quantities().items()}

    @property
    def valve_gain(self) -> float:
        """K_v [m3/s/A/sqrt(Pa)] (eq. q4)."""
        return self.valve_nominal_flow / (self.valve_nominal_current * sqrt(self.valve_nominal_pressure_drop / 2.0))

    @property
    def size(self) -> BenchScales:
        """Scales of its forces, pressures, lengths and currents."""
        return BenchScales.of_bench(vars(self))

    @property
    def terms(self) -> tuple[Mapping[str, Any], ...]:
        """Effects and closures as entries of one list; closures have the id `closure`."""
        return (*self.effects, *({"id": "closure", **closure} for closure in self.closures))

    @property
    def rejection_reason(self) -> str:
        """Error message if this bench's predictions are too poor to rely on; empty otherwise.

        The quality measured by `learn` is valid as long as no value was changed since.
        """
        if self.learned is None or self.learned.get("bench") != self.digest:
            return ""
        return Quality.from_mapping(self.learned).rejection_reason

    @classmethod
    def nominal(cls) -> Bench:
        """Return the bench of the bench.yaml that comes with this package."""
        with resources.as_file(resources.files("hydro_sim") / "data" / "bench.yaml") as path:
            return cls.load(path)

    @classmethod
    def load(cls, path: str | Path) -> Bench:
        """Read a `bench.yaml` or a diagnosis' `corrected.yaml` (the same keys and a list `effects`).

        Raises ValueError: in one sentence that names the file, and the key if it is about one.
        """
        content = read_yaml(path)
        try:
            return cls.from_mapping(content)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any]) -> Bench:
        """Create a bench from keys and values, for instance of a YAML file or of a recording's metadata.

        Raises ValueError: a key is missing, unknown, or its value is not a number in range.
        """
        known = describe(cls)
        missing = [name for name, setting in known.items() if setting.required and name not in content]
        if len(missing) > 1 and content.keys() <= known.keys():
            raise ValueError(f"a bench has {', '.join(missing)}, too")
        if content.get("learned") is not None:
            Quality.from_mapping(content["learned"])
        lists = {}
        for key, needs in (("effects", ("id",)), ("closures", ("equation", "form", "parameters"))):
            value = content.get(key)
            listed = isinstance(value, (list, tuple)) and all(isinstance(one, Mapping) for one in value)
            if value is not None and not (listed and all(need in one for one in value for need in needs)):
                raise ValueError(f"{key!r} is a list of mappings, each with an {', '.join(map(repr, needs))}")
            lists[key] = tuple(map(dict, value or ()))
        return from_mapping(cls, {**content, **lists}, "bench")

    def to_mapping(self) -> dict[str, Any]:
        """Return keys and values as in bench.yaml; the optional ones only if set."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        values |= {"effects": list(map(dict, self.effects)), "closures": list(map(dict, self.closures))}
        return {key: value for key, value in values.items() if value is not None and value != []}

    @property
    def digest(self) -> str:
        """First 12 digits of the SHA-256 of keys and values, by which models, metrics and policies refer to it."""
        return bench_digest.digest(self.to_mapping())

    def constants(self) -> npt.NDArray[np.void]:
        """Return the bench for compiled code: one record of `BENCH_DTYPE`, shape (1,)."""
        numbers, record = self.without_effects(), np.zeros(1, BENCH_DTYPE)
        for name in record.dtype.names or ():
            value = getattr(numbers, name, None)
            record[name] = 0.0 if value is None else value
        record["load_cell_omega"] = 2.0 * pi * (numbers.load_cell_bandwidth or 0.0)
        return record

    def without_effects(self) -> Bench:
        """Return the bench without effects; corrections of parameters are applied in order, within the ranges."""
        ranges = self.ranges()
        n = SimpleNamespace(**{name: getattr(self, name) for name in ranges})
        for effect in self.effects:
            (kind, values), before = catalogue.parse_entry(effect), dict(vars(n))
            kind.bind(dict(zip((one.name for one in kind.parameters), values, strict=True))).correct(n)
            for name, (low, high) in ranges.items():
                value = getattr(n, name)
                if value is not None and value != before[name]:
                    setattr(n, name, min(max(value, low), high))
        return replace(self, effects=(), closures=(), learned=None, **vars(n))


BENCH_DTYPE = np.dtype(
    [(name, np.float64) for name in Bench.quantities() if name != "load_cell_bandwidth"]
    + [("valve_gain", np.float64), ("load_cell_omega", np.float64)]
)
"""The bench for compiled code, SI units; `valve_gain` is K_v, `load_cell_omega` [rad/s] is 0 for an ideal load cell.
Effects that correct parameters are applied to them; the others are part of the model (`bench_model`)."""


NOMINAL = Bench.nominal().size
"""Size of the nominal bench."""
