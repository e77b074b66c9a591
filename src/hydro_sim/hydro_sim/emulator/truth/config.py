# SPDX-License-Identifier: Apache-2.0
"""`TruthConfig`: everything about the emulated bench in one YAML file, and the two profiles it can start from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from hydro_sim.emulator.truth.effects import (
    Effects,
    FrictionCoulomb,
    FrictionPresliding,
    FrictionStribeck,
    LeakageInternal,
    SensorLag,
    ValveLag,
)
from hydro_sim.emulator.truth.outside import Outside
from hydro_sim.yaml_settings import ConfigError, from_mapping, quantity, read_yaml, to_mapping, unknown_key

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class TruthBench:
    """The truth's own copy of the bench; effects come on top of it."""

    bulk_modulus: float = quantity(1.34e9, unit="Pa", low=1e7, high=1e10)
    piston_area: float = quantity(2e-4, unit="m2", low=1e-6, high=1.0)
    area_ratio: float = quantity(0.609, low=0.05, high=1.0)
    stroke: float = quantity(0.08, unit="m", low=1e-3, high=10.0)
    supply_pressure: float = quantity(16e6, unit="Pa", low=1e5, high=1e8)
    tank_pressure: float = quantity(0.0, unit="Pa", low=0.0, high=5e6)
    valve_nominal_flow: float = quantity(1.67e-4, unit="m3/s", low=1e-7, high=1.0)
    valve_nominal_current: float = quantity(0.05, unit="A", low=1e-4, high=100.0)
    valve_nominal_pressure_drop: float = quantity(7e6, unit="Pa", low=1e4, high=1e8)
    valve_current_max: float = quantity(0.05, unit="A", low=1e-4, high=100.0)
    dead_volume_a: float = quantity(2e-4, unit="m3", low=1e-7, high=1.0)
    dead_volume_b: float = quantity(2e-4, unit="m3", low=1e-7, high=1.0)
    moving_mass: float = quantity(1.2, unit="kg", low=0.05, high=1e4)
    viscous_friction: float = quantity(60.0, unit="N s/m", low=0.0, high=1e5)
    spring_stiffness: float = quantity(2e4, unit="N/m", low=0.0, high=1e8)
    spring_rest_position: float = quantity(0.04, unit="m", low=0.0, high=10.0)
    load_cell_bandwidth: float | None = quantity(25.0, unit="Hz", low=2.0, high=2000.0)  # null: ideal amplifier
    load_cell_damping: float = quantity(0.7071067811865476, low=0.3, high=2.0)


@dataclass(frozen=True, kw_only=True)
class TruthSensors:
    """Noise as standard deviations of one sample, the encoder's step, and the ages of the rates that the box makes.

    The differentiation is the box's, not the bench's: it is the code of `hydro_sim.model.sensors`, as for every plant.
    """

    noise_scale: float = quantity(1.0, low=0.0, high=100.0)  # multiplies the noises, not the encoder's step
    force_noise: float = quantity(0.6, unit="N", low=0.0, high=1000.0)
    pressure_noise: float = quantity(6e3, unit="Pa", low=0.0, high=1e7)
    encoder_step: float = quantity(1e-6, unit="m", low=0.0, high=1e-3)
    velocity_age: float = quantity(1e-3, unit="s", low=5e-4, high=0.02)
    force_rate_age: float = quantity(2e-3, unit="s", low=5e-4, high=0.02)


@dataclass(frozen=True, kw_only=True)
class TruthConfig:
    """The emulated bench. Without arguments it is the `nominal` profile: the nominal bench plus sensor noise."""

    bench: TruthBench = field(default_factory=TruthBench)
    sensors: TruthSensors = field(default_factory=TruthSensors)
    effects: Effects = field(default_factory=Effects)
    outside: Outside = field(default_factory=Outside)


def profile(name: str) -> TruthConfig:
    """One of the two starting points: `nominal` (nothing missing) or `default` (the contract's truth plant)."""
    if name == "nominal":
        return TruthConfig()
    if name != "default":
        raise ConfigError(f"profile must be nominal or default, not {name!r}")
    return TruthConfig(
        effects=Effects(
            valve_lag=ValveLag(bandwidth=110.0, damping=1.2, rate_limit=6.0),
            friction_coulomb=FrictionCoulomb(force=12.0, form="lugre"),
            friction_stribeck=FrictionStribeck(breakaway_force=5.0, velocity=0.01),
            friction_presliding=FrictionPresliding(stiffness=5e5),
            leakage_internal=LeakageInternal(coefficient=1e-13),
            sensor_lag=(SensorLag(sensor="load_force", bandwidth=25.0, damping=0.55),),
        )
    )


def truth_from_mapping(data: Mapping[str, Any], where: str = "truth") -> TruthConfig:
    """`TruthConfig` from plain YAML data.

    Parameters
    ----------
    data
        Keys `profile` (nominal | default, the default), `bench`, `sensors`, `effects`, `outside`. The last four change
        single entries of the profile: an effect given replaces the profile's, `null` turns it off.
    where
        Name of the source, for messages.

    Raises
    ------
    ConfigError
        On an unknown key, a wrong type, or a value outside its range.
    """
    sections = ("bench", "sensors", "effects", "outside")
    for key in data:
        if key not in ("profile", *sections):
            raise ConfigError(unknown_key(str(key), ["profile", *sections], where))
    base = profile(data.get("profile", "default"))
    changes = {name: _overlaid(getattr(base, name), data[name], f"{where}.{name}") for name in sections if name in data}
    return check(replace(base, **changes))


def load_truth(path: str | Path) -> TruthConfig:
    """`TruthConfig` from a YAML file; see `truth_from_mapping`."""
    return truth_from_mapping(read_yaml(path), Path(path).name)


def truth_to_mapping(config: TruthConfig) -> dict[str, Any]:
    """Plain data that `truth_from_mapping` turns back into `config`."""
    return {"profile": "nominal", **to_mapping(config)}


def check(config: TruthConfig) -> TruthConfig:
    """`config` itself, when its parts fit together.

    Raises
    ------
    ConfigError
        If values that are each in range contradict one another.
    """
    coulomb = config.effects.friction_coulomb
    if config.effects.friction_presliding is not None and (coulomb is None or coulomb.form != "lugre"):
        raise ConfigError(
            "effects.friction_presliding is part of LuGre friction: give friction_coulomb form: lugre with it"
        )
    rest = config.effects.spring_rest
    if not 0.0 < (config.bench.spring_rest_position if rest is None else rest.position) < config.bench.stroke:
        raise ConfigError("the spring's rest position must lie within the stroke")
    viscous = config.effects.friction_viscous
    if viscous is not None and config.bench.viscous_friction + viscous.coefficient < 0.0:
        raise ConfigError("effects.friction_viscous takes away more than all of the viscous friction")
    added = config.effects.moving_mass
    if added is not None and config.bench.moving_mass + added.mass < 0.05:
        raise ConfigError("effects.moving_mass takes away all of the moving mass")
    _one_each(config.effects)
    return config


def _one_each(effects: Effects) -> None:
    for name, key in (
        ("leakage_external", "chamber"),
        ("load_cell_gain", "cell"),
        ("load_cell_bias", "cell"),
        ("pressure_sensor_bias", "chamber"),
        ("sensor_lag", "sensor"),
        ("dead_volume", "chamber"),
    ):
        places = [getattr(item, key) for item in getattr(effects, name)]
        if len(places) != len(set(places)):
            raise ConfigError(f"effects.{name} names the same {key} twice")
    if len(effects.end_cushion) > 2:
        raise ConfigError("effects.end_cushion takes at most two, one for each end")


def _overlaid(base: T, data: object, where: str) -> T:
    given = from_mapping(type(base), {} if data is None else data, where)
    keys = data if isinstance(data, Mapping) else {}
    return replace(base, **{str(key): getattr(given, str(key)) for key in keys})  # type: ignore[type-var]
