# SPDX-License-Identifier: Apache-2.0
"""The nominal bench: `bench.yaml` as a validated, immutable value.

Names, units and ranges stand once, in the fields of `Bench`; everything else (loading, checking, the record that
compiled code reads) is derived from them. Values: physics.md, "The nominal bench".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from importlib import resources
from math import inf, isfinite, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from hydro_bridge.files import bench_file
from hydro_bridge.size import Size
from hydro_sim.model.effects import catalogue
from hydro_sim.model.quality import Quality


def _quantity(unit: str, low: float, high: float) -> Any:
    return field(metadata={"unit": unit, "low": low, "high": high})


@dataclass(frozen=True, kw_only=True)
class Bench:
    """The nominal bench, SI units. Field metadata: `unit`, `low`, `high` (inclusive).

    Raises
    ------
    ValueError
        If a value is not a finite number within its range; the sentence names key, value, unit and range.
    """

    bulk_modulus: float = _quantity("Pa", 1e7, 1e10)
    """beta, of oil and hoses together."""
    piston_area: float = _quantity("m2", 1e-6, 1e-1)
    """A_p, of chamber A."""
    area_ratio: float = _quantity("-", 0.05, 1.0)
    """alpha, area of chamber B over that of chamber A."""
    stroke: float = _quantity("m", 1e-3, 5.0)
    """L_c."""
    supply_pressure: float = _quantity("Pa", 1e5, 1e8)
    """p_s."""
    tank_pressure: float = _quantity("Pa", 0.0, 1e7)
    """p_t, below the supply pressure."""
    valve_nominal_flow: float = _quantity("m3/s", 1e-7, 1e-1)
    """q_n, at nominal current and nominal pressure drop over both lands together."""
    valve_nominal_current: float = _quantity("A", 1e-4, 10.0)
    """u_n."""
    valve_nominal_pressure_drop: float = _quantity("Pa", 1e4, 1e8)
    """Delta p_n."""
    valve_current_max: float = _quantity("A", 1e-4, 10.0)
    """Magnitude at which the valve current saturates."""
    dead_volume_a: float = _quantity("m3", 1e-7, 1e-1)
    """V_dead_a, valve block and hoses."""
    dead_volume_b: float = _quantity("m3", 1e-7, 1e-1)
    """V_dead_b."""
    moving_mass: float = _quantity("kg", 1e-2, 1e4)
    """m, piston, rod and load together."""
    viscous_friction: float = _quantity("N s/m", 0.0, 1e6)
    """b."""
    spring_stiffness: float = _quantity("N/m", 1.0, 1e8)
    """k_s, of the environment."""
    spring_rest_position: float = _quantity("m", -5.0, 5.0)
    """x_rest, piston position at which the spring carries no force."""
    load_cell_bandwidth: float | None = field(default=None, metadata={"unit": "Hz", "low": 1.0, "high": 1e4})
    """Second-order Butterworth low-pass in the load cell's amplifier; None: ideal."""
    effects: tuple[Mapping[str, Any], ...] = ()
    """Effects beyond these equations, found by a diagnosis (`corrected.yaml`), as read: `hydro_sim.model.effects`."""
    closures: tuple[Mapping[str, Any], ...] = ()
    """Closures found by a diagnosis, as read: equation, form, parameters (`hydro_sim.model.laws`)."""
    learned: Mapping[str, Any] | None = None
    """Result of `learn`: the `bench` that it was (a digest), and its `Quality`."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.metadata:
                _check(entry.name, getattr(self, entry.name), entry.metadata, optional=entry.default is None)
        if self.tank_pressure >= self.supply_pressure:
            raise ValueError(
                f"tank_pressure {self.tank_pressure:g} Pa is not below supply_pressure {self.supply_pressure:g} Pa"
            )
        if any(effect["id"] == "closure" for effect in self.effects):
            raise ValueError("closures stand under 'closures', not under 'effects'")
        catalogue.check(self.terms)

    @property
    def valve_gain(self) -> float:
        """K_v [m3/s/A/sqrt(Pa)] (eq. q4)."""
        return self.valve_nominal_flow / (self.valve_nominal_current * sqrt(self.valve_nominal_pressure_drop / 2.0))

    @property
    def size(self) -> Size:
        """Scales of its forces, pressures, lengths and currents."""
        return Size.of(vars(self))

    @property
    def terms(self) -> tuple[Mapping[str, Any], ...]:
        """Effects and closures, in the form that the model takes."""
        return (*self.effects, *({"id": "closure", **closure} for closure in self.closures))

    @property
    def unfit(self) -> str:
        """Return why nothing may rely on predictions of this bench, in a sentence; empty if no reason is known.

        The finding of `learn` holds as long as no number was changed since.
        """
        if self.learned is None or self.learned.get("bench") != self.digest:
            return ""
        return Quality.from_mapping(self.learned).unfit

    @classmethod
    def nominal(cls) -> Bench:
        """Return the bench of the bench.yaml that comes with this package."""
        with resources.as_file(resources.files("hydro_sim") / "data" / "bench.yaml") as path:
            return cls.load(path)

    @classmethod
    def load(cls, path: str | Path) -> Bench:
        """Read a `bench.yaml` or a diagnosis' `corrected.yaml` (the same keys and a list `effects`).

        Raises
        ------
        ValueError
            In one sentence that names the file, and the key if it is about one.
        """
        content = read_content(path)
        try:
            return cls.from_mapping(content)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def from_mapping(cls, content: object) -> Bench:
        """Create a bench from keys and values, for instance of a YAML file or of a recording's metadata.

        Raises
        ------
        ValueError
            If a key is missing, unknown, or its value is not a number in range.
        """
        if not isinstance(content, Mapping):
            raise ValueError("a bench is a mapping of keys to values")
        entries = {entry.name: entry for entry in fields(cls)}
        unknown = [str(key) for key in content if key not in entries]
        missing = [name for name, entry in entries.items() if name not in content and _required(entry)]
        if unknown:
            close = get_close_matches(unknown[0], entries, 1)
            raise ValueError(f"unknown key {unknown[0]!r}" + (f", did you mean {close[0]!r}?" if close else ""))
        if missing:
            several = len(missing) > 1
            named = ", ".join(repr(name) for name in missing)
            raise ValueError(f"key{'s' if several else ''} {named} {'are' if several else 'is'} missing")
        values = {key: _number(key, value) for key, value in content.items() if key not in _NOT_NUMBERS}
        learned = content.get("learned")
        if learned is not None:
            Quality.from_mapping(learned)
        closures = _listed("closures", content.get("closures"), ("equation", "form", "parameters"))
        return cls(
            **values, effects=_listed("effects", content.get("effects"), ("id",)), closures=closures, learned=learned
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return keys and values as in bench.yaml; the optional ones only if set."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        values["effects"] = [dict(effect) for effect in self.effects]
        values["closures"] = [dict(closure) for closure in self.closures]
        return {key: value for key, value in values.items() if value is not None and value != []}

    @property
    def digest(self) -> str:
        """SHA-256 of keys and values, its first 12 digits: the reference in models, metrics and policies."""
        return bench_file.digest(self.to_mapping())

    def constants(self) -> npt.NDArray[np.void]:
        """Return the bench for compiled code: one record of `BENCH_DTYPE`, shape (1,)."""
        numbers, record = self._with_corrected_numbers(), np.zeros(1, BENCH_DTYPE)
        for name in record.dtype.names or ():
            value = getattr(numbers, name, None)
            record[name] = 0.0 if value is None else value
        record["load_cell_omega"] = 2.0 * pi * (numbers.load_cell_bandwidth or 0.0)
        return record

    def _with_corrected_numbers(self) -> Bench:
        """Without effects, those that are wrong numbers of the bench file written into its numbers."""
        quantities = [entry for entry in fields(self) if entry.metadata]
        limits = {entry.name: (entry.metadata["low"], entry.metadata["high"]) for entry in quantities}
        believed = {name: getattr(self, name) for name in limits}
        numbers: dict[str, Any] = catalogue.corrected(believed, limits, self.effects)
        return replace(self, effects=(), closures=(), learned=None, **numbers)


BENCH_DTYPE = np.dtype(
    [(entry.name, np.float64) for entry in fields(Bench) if entry.metadata and entry.name != "load_cell_bandwidth"]
    + [("valve_gain", np.float64), ("load_cell_omega", np.float64)]
)
"""The bench for compiled code, SI units; `valve_gain` is K_v, `load_cell_omega` [rad/s] is 0 for an ideal load cell.
Effects that are wrong numbers of the bench file are in the numbers; the others are the model's (`bench_model`)."""

_NOT_NUMBERS = ("effects", "closures", "learned")


def read_content(path: str | Path) -> object:
    """What a bench file holds, not checked.

    Raises
    ------
    ValueError
        If it cannot be read or is not YAML, in one sentence that names it.
    """
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    except yaml.YAMLError as error:
        raise ValueError(f"{path}: not YAML: {' '.join(str(error).split())}") from error


def _required(entry: Any) -> bool:
    return entry.name not in ("load_cell_bandwidth", *_NOT_NUMBERS)


def _check(key: str, value: object, metadata: Mapping[str, Any], *, optional: bool) -> None:
    if value is None and optional:
        return
    low, high, unit = metadata["low"], metadata["high"], metadata["unit"]
    number = value if isinstance(value, (int, float)) and not isinstance(value, bool) else inf
    if not (isfinite(number) and low <= number <= high):
        raise ValueError(f"{key} = {value!r} is not a number in [{low:g}, {high:g}] {unit}")


def _number(key: object, value: Any) -> Any:
    """YAML 1.1 as PyYAML reads it takes 1e9 for text: texts become numbers here, anything else is checked by Bench."""
    if value is None or isinstance(value, bool):
        return value
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{key} = {value!r} is not a number") from None


def _listed(key: str, value: Any, needs: Sequence[str]) -> tuple[Mapping[str, Any], ...]:
    if value is None:
        return ()
    listed = isinstance(value, (list, tuple)) and all(isinstance(one, Mapping) for one in value)
    if not listed or not all(need in one for one in value for need in needs):
        wanted = ", ".join(repr(need) for need in needs)
        raise ValueError(f"{key!r} is a list of mappings, each with an {wanted}")
    return tuple(dict(one) for one in value)


NOMINAL = Bench.nominal().size
"""Size of the nominal bench."""
