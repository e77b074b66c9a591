# SPDX-License-Identifier: Apache-2.0
"""`TruthConfig`: the configuration of the emulated bench in one YAML file, and the two profiles it can start from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from hydro_core.settings import SettingsError, from_mapping, quantity, read_yaml, unknown_key
from hydro_sim.emulator.truth import effects as kinds


@dataclass(frozen=True, kw_only=True)
class TruthBench:
    """Nominal parameters of the truth plant, independent of `model.bench`; effects are added to them."""

    bulk_modulus: Annotated[float, quantity("Pa", 1e7, 1e10)] = 1.34e9
    piston_area: Annotated[float, quantity("m2", 1e-6, 1.0)] = 2e-4
    area_ratio: Annotated[float, quantity("-", 0.05, 1.0)] = 0.609
    stroke: Annotated[float, quantity("m", 1e-3, 10.0)] = 0.08
    supply_pressure: Annotated[float, quantity("Pa", 1e5, 1e8)] = 16e6
    tank_pressure: Annotated[float, quantity("Pa", 0.0, 5e6)] = 0.0
    valve_nominal_flow: Annotated[float, quantity("m3/s", 1e-7, 1.0)] = 1.67e-4
    valve_nominal_current: Annotated[float, quantity("A", 1e-4, 100.0)] = 0.05
    valve_nominal_pressure_drop: Annotated[float, quantity("Pa", 1e4, 1e8)] = 7e6
    valve_current_max: Annotated[float, quantity("A", 1e-4, 100.0)] = 0.05
    dead_volume_a: Annotated[float, quantity("m3", 1e-7, 1.0)] = 2e-4
    dead_volume_b: Annotated[float, quantity("m3", 1e-7, 1.0)] = 2e-4
    moving_mass: Annotated[float, quantity("kg", 0.05, 1e4)] = 1.2
    viscous_friction: Annotated[float, quantity("N s/m", 0.0, 1e5)] = 60.0
    spring_stiffness: Annotated[float, quantity("N/m", 0.0, 1e8)] = 2e4
    spring_rest_position: Annotated[float, quantity("m", 0.0, 10.0)] = 0.04
    load_cell_bandwidth: Annotated[float, quantity("Hz", 2.0, 2000.0)] | None = 25.0  # null: ideal amplifier
    load_cell_damping: Annotated[float, quantity("-", 0.3, 2.0)] = 0.7071067811865476


@dataclass(frozen=True, kw_only=True)
class TruthSensors:
    """Noise as standard deviations of one sample, the encoder's step, and the ages of the box's rates.

    The differentiation is the box's, not the bench's: it is the code of `hydro_sim.model.sensors`, as for every plant.
    """

    noise_scale: Annotated[float, quantity("-", 0.0, 100.0)] = 1.0  # multiplies the noises, not the encoder's step
    force_noise: Annotated[float, quantity("N", 0.0, 1000.0)] = 0.6
    pressure_noise: Annotated[float, quantity("Pa", 0.0, 1e7)] = 6e3
    encoder_step: Annotated[float, quantity("m", 0.0, 1e-3)] = 1e-6
    velocity_age: Annotated[float, quantity("s", 5e-4, 0.02)] = 1e-3
    force_rate_age: Annotated[float, quantity("s", 5e-4, 0.02)] = 2e-3


@dataclass(frozen=True, kw_only=True)
class TruthConfig:
    """The emulated bench. Without arguments it is the `nominal` profile: the nominal bench plus sensor noise."""

    bench: TruthBench = field(default_factory=TruthBench)
    sensors: TruthSensors = field(default_factory=TruthSensors)
    effects: kinds.Effects = field(default_factory=kinds.Effects)
    outside: kinds.UnnamedEffects = field(default_factory=kinds.UnnamedEffects)


def profile(name: str) -> TruthConfig:
    """Return a predefined truth: `nominal` (no effects) or `default` (valve lag, friction, leakage, load cell lag)."""
    if name == "nominal":
        return TruthConfig()
    if name != "default":
        raise SettingsError(f"profile must be nominal or default, not {name!r}")
    effects = kinds.Effects(
        valve_lag=kinds.ValveLag(bandwidth=110.0, damping=1.2, rate_limit=6.0),
        friction_coulomb=kinds.FrictionCoulomb(force=12.0, form="lugre"),
        friction_stribeck=kinds.FrictionStribeck(breakaway_force=5.0, velocity=0.01),
        friction_presliding=kinds.FrictionPresliding(stiffness=5e5),
        leakage_internal=kinds.LeakageInternal(coefficient=1e-13),
        sensor_lag=(kinds.SensorLag(sensor="load_force", bandwidth=25.0, damping=0.55),),
    )
    return TruthConfig(effects=effects)


def truth_from_mapping(data: Mapping[str, Any], where: str = "truth", bench: TruthBench | None = None) -> TruthConfig:
    """Build a `TruthConfig` from plain YAML data.

    `data`: keys `profile` (nominal | default, the default), `bench`, `sensors`, `effects`, `outside`. The last four
    change single entries of the profile: an effect given replaces the profile's, `null` turns it off. `where`: name of
    the source, for messages. `bench`: replaces the profile's. Raises SettingsError: on an unknown key, a wrong
    type, or a value outside its range.
    """
    sections = ("bench", "sensors", "effects", "outside")
    for key in data:
        if key not in ("profile", *sections):
            raise SettingsError(unknown_key(str(key), ["profile", *sections], where))
    base = profile(data.get("profile", "default"))
    base, changes = replace(base, bench=bench or base.bench), dict[str, Any]()
    for name in sections:
        part, given = getattr(base, name), data.get(name)
        read = from_mapping(type(part), {} if given is None else given, f"{where}.{name}")
        changes[name] = replace(part, **{str(key): getattr(read, str(key)) for key in given or ()})
    return check_truth(replace(base, **changes))


def load_truth(path: str | Path, bench: TruthBench | None = None) -> TruthConfig:
    """Load a `TruthConfig` from a YAML file; see `truth_from_mapping`."""
    return truth_from_mapping(read_yaml(path), Path(path).name, bench)


def check_truth(config: TruthConfig) -> TruthConfig:
    """Return `config`, if its parts are consistent.

    Raises SettingsError if values that are each in range contradict one another.
    """
    coulomb = config.effects.friction_coulomb
    if config.effects.friction_presliding is not None and (coulomb is None or coulomb.form != "lugre"):
        raise SettingsError("effects.friction_presliding needs LuGre friction: give friction_coulomb form: lugre")
    rest = config.effects.spring_rest
    if not 0.0 < (config.bench.spring_rest_position if rest is None else rest.position) < config.bench.stroke:
        raise SettingsError("the spring's rest position must lie within the stroke")
    viscous = config.effects.friction_viscous
    if viscous is not None and config.bench.viscous_friction + viscous.coefficient < 0.0:
        raise SettingsError("effects.friction_viscous takes away more than all of the viscous friction")
    added = config.effects.moving_mass
    if added is not None and config.bench.moving_mass + added.mass < 0.05:
        raise SettingsError("effects.moving_mass takes away all of the moving mass")
    for name, key in (
        ("leakage_external", "chamber"), ("load_cell_gain", "cell"), ("load_cell_bias", "cell"),
        ("pressure_sensor_bias", "chamber"), ("sensor_lag", "sensor"), ("dead_volume", "chamber"),
        ("valve_edge", "edge"),
    ):  # fmt: skip
        places = [getattr(item, key) for item in getattr(config.effects, name)]
        if len(places) != len(set(places)):
            raise SettingsError(f"effects.{name} names the same {key} twice")
    cushions = config.effects.end_cushion
    ends = {cushion.position > 0.5 * config.bench.stroke for cushion in cushions}
    if len(ends) < len(cushions) or len({cushion.form for cushion in cushions}) > 1:
        raise SettingsError("effects.end_cushion takes one for each end, both of one form")
    return config
