# SPDX-License-Identifier: Apache-2.0
"""Every effect that a corrected.yaml may hold: its forms, their numbers, and where in the compiled plant they act.

An entry of corrected.yaml is `{id: ..., <option>: ..., parameters: {name: number}}`. `form_of` finds its form here;
adding one is a line below and a branch in the function of its hook.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydro_sim.model.effects import motion, oil, record, sensing, valve
from hydro_sim.model.effects.forms import Form, Quantity

CHANNELS = {"hydraulic_force": 0, "load_force": 1, "pressure_a": 2, "pressure_b": 3}
"""Sensors and their places in `hydro_sim.model.sensors.RAW_FIELDS`."""

_RATIO = Quantity("ratio", "-", 0.01, 100.0)
_WIDTH = Quantity("half_width", "A", 0.0, 0.1)
_LEAK = Quantity("coefficient", "m3/s/Pa", 0.0, 1e-9)
_LAG = Quantity("bandwidth", "Hz", 1.0, 2000.0)
_DAMPING = Quantity("damping", "-", 0.1, 5.0)
_WEAR = (Quantity("coefficient", "m3/s/sqrt(Pa)", 0.0, 1e-6), Quantity("width", "A", 1e-6, 0.1))
_CUSHION = (Quantity("stiffness", "N/m", 0.0, 1e7), Quantity("position", "m", -5.0, 5.0))


def _force(name: str, low: float = 0.0) -> Quantity:
    return Quantity(name, "N", low, 5000.0)


def _plain(identifier: str, *quantities: Quantity, hook: int | None = None, kind: int = 0) -> dict[str, Form]:
    return {identifier: Form(quantities, hook, kind)}


def _forms(identifier: str, option: str, forms: Mapping[str, Form]) -> dict[str, Form]:
    return {f"{identifier} {option}={name}": form for name, form in forms.items()}


def _cushions() -> dict[str, Form]:
    kinds = {
        "end": motion.CUSHION_END,
        "start": motion.CUSHION_START,
        "end-quadratic": motion.CUSHION_END_QUADRATIC,
        "start-quadratic": motion.CUSHION_START_QUADRATIC,
    }
    return {name: Form(_CUSHION, record.RESISTANCE, kind) for name, kind in kinds.items()}


def _profiles() -> dict[str, Form]:
    kinds = {
        "exponential": valve.WEAR_EXPONENTIAL,
        "gaussian": valve.WEAR_GAUSSIAN,
        "hyperbolic": valve.WEAR_HYPERBOLIC,
        "lorentzian": valve.WEAR_LORENTZIAN,
    }
    return {name: Form(_WEAR, record.OPENINGS, kind) for name, kind in kinds.items()}


def _scales(kind: int, quantity: Quantity, channels: Mapping[str, str]) -> dict[str, Form]:
    return {
        name: Form((quantity,), record.MEASURE, kind, (float(CHANNELS[channel]),)) for name, channel in channels.items()
    }


_CELLS = {"hydraulic_force": "hydraulic_force", "load_force": "load_force"}
_GAUGES = {"a": "pressure_a", "b": "pressure_b"}

VALVE = {
    **_plain("transport_delay", Quantity("time", "s", 0.0, 0.03), hook=record.COMMAND, kind=valve.DELAY),
    **_plain("valve_offset", Quantity("current", "A", -0.1, 0.1), hook=record.COMMAND, kind=valve.OFFSET),
    **_plain("valve_lag", _LAG, _DAMPING, hook=record.COMMAND, kind=valve.SECOND_ORDER),
    "valve_lag form=first_order": Form((_LAG,), record.COMMAND, valve.FIRST_ORDER),
    "valve_deadband": Form((_WIDTH,), record.COMMAND, valve.OVERLAP),
    "valve_deadband form=lopsided": Form(
        (_WIDTH, Quantity("half_width_negative", "A", 0.0, 0.1)), record.COMMAND, valve.OVERLAP
    ),
    "valve_deadband form=soft": Form(
        (_WIDTH, Quantity("softness", "A", 1e-7, 0.1)), record.COMMAND, valve.OVERLAP_SOFT
    ),
    **_plain("valve_gain", _RATIO, hook=record.OPENINGS, kind=valve.GAIN),
    **_plain("valve_gain_asymmetry", _RATIO, hook=record.OPENINGS, kind=valve.GAIN_NEGATIVE),
    **_plain("valve_gain_drift", Quantity("rate", "1/s", -1.0, 1.0), hook=record.OPENINGS, kind=valve.GAIN_DRIFT),
    **_forms("valve_null_leakage", "form", _profiles()),
}

OIL = {
    **_plain(
        "supply_droop",
        Quantity("resistance", "Pa s/m3", 0.0, 1e12),
        Quantity("time_constant", "s", 1e-3, 100.0),
        hook=record.SUPPLY,
    ),
    **_plain("leakage_internal", _LEAK, hook=record.FLOWS, kind=oil.INTERNAL),
    "leakage_internal form=orifice": Form((_LEAK,), record.FLOWS, oil.INTERNAL_ORIFICE),
    "leakage_external chamber=a": Form((_LEAK,), record.FLOWS, oil.EXTERNAL_A),
    "leakage_external chamber=b": Form((_LEAK,), record.FLOWS, oil.EXTERNAL_B),
    **_plain("bulk_modulus", _RATIO, hook=record.STIFFNESS, kind=oil.MODULUS),
    "entrained_air": Form((Quantity("volume_fraction", "-", 0.0, 0.5),), record.STIFFNESS, oil.AIR, (1.4,)),
    "entrained_air form=isothermal": Form(
        (Quantity("volume_fraction", "-", 0.0, 0.5),), record.STIFFNESS, oil.AIR, (1.0,)
    ),
}

MOTION = {
    **_plain("friction_coulomb", _force("force"), hook=record.DRAG, kind=motion.COULOMB),
    "friction_coulomb form=directional": Form(
        (_force("force_positive"), _force("force_negative")), record.DRAG, motion.COULOMB_DIRECTIONAL
    ),
    **_plain(
        "friction_stribeck",
        _force("breakaway_force"),
        Quantity("velocity", "m/s", 1e-4, 10.0),
        hook=record.DRAG,
        kind=motion.STRIBECK,
    ),
    "friction_viscous form=directional": Form(
        tuple(Quantity(f"coefficient_{side}", "N s/m", -1e6, 1e6) for side in ("positive", "negative")),
        record.RESISTANCE,
        motion.VISCOUS,
    ),
    **_plain(
        "friction_presliding", Quantity("stiffness", "N/m", 1.0, 1e7), hook=record.RESISTANCE, kind=motion.PRESLIDING
    ),
    **_plain("force_offset", _force("force", -5000.0), hook=record.RESISTANCE, kind=motion.FORCE),
    **_forms("end_cushion", "form", _cushions()),
    **_plain("spring_hardening", Quantity("coefficient", "N/m3", -1e11, 1e11), hook=record.LOAD, kind=motion.HARDENING),
    **_plain("backlash", Quantity("width", "m", 0.0, 0.1), hook=record.LOAD, kind=motion.GAP),
    "backlash form=play": Form((Quantity("width", "m", 0.0, 0.1),), record.LOAD, motion.PLAY),
}

SENSING = {
    **_forms("load_cell_gain", "cell", _scales(sensing.RATIO, _RATIO, _CELLS)),
    **_forms("load_cell_bias", "cell", _scales(sensing.BIAS, _force("force", -5000.0), _CELLS)),
    **_forms("pressure_sensor_bias", "chamber", _scales(sensing.BIAS, Quantity("pressure", "Pa", -1e7, 1e7), _GAUGES)),
    **_forms(
        "sensor_lag",
        "sensor",
        {name: Form((_LAG, _DAMPING), record.LAG, 0, (float(channel),)) for name, channel in CHANNELS.items()},
    ),
}

NUMBERS = {
    **_plain("friction_viscous", Quantity("coefficient", "N s/m", -1e6, 1e6)),
    **_plain("moving_mass", Quantity("mass", "kg", -1e4, 1e4)),
    **_plain("spring_stiffness", _RATIO),
    **_plain("spring_rest", Quantity("position", "m", -5.0, 5.0)),
    **_plain("supply_pressure", _RATIO),
    **_plain("tank_pressure", Quantity("pressure", "Pa", 0.0, 1e7)),
    **_plain("piston_area", _RATIO),
    **_plain("area_ratio", _RATIO),
    **_forms("dead_volume", "chamber", {chamber: Form((_RATIO,)) for chamber in "ab"}),
}
"""Wrong values of the bench file: no hook, see `hydro_sim.model.effects.program`."""

CATALOGUE: dict[str, Form] = {**VALVE, **OIL, **MOTION, **SENSING, **NUMBERS}
"""By id and option, as `label` writes them."""


def label(effect: Mapping[str, Any]) -> str:
    """Id and options of an entry of corrected.yaml."""
    options = sorted((str(key), str(value)) for key, value in effect.items() if key not in ("id", "parameters"))
    return " ".join([str(effect["id"]), *(f"{key}={value}" for key, value in options)])


def form_of(effect: Mapping[str, Any]) -> tuple[Form, tuple[float, ...]]:
    """Form and parameters of an entry of corrected.yaml.

    Raises
    ------
    ValueError
        In one sentence, if the effect is unknown or a parameter is missing, too many, or not a number in range.
    """
    name, parameters = label(effect), effect.get("parameters") or {}
    if name not in CATALOGUE:
        known = [other for other in CATALOGUE if other.split()[0] == str(effect["id"])]
        raise ValueError(f"effect {name!r} is not known" + (f"; there is {', '.join(known)}" if known else ""))
    if not isinstance(parameters, Mapping):
        raise ValueError(f"effect {name}: 'parameters' is a mapping of names to numbers")
    form = CATALOGUE[name]
    unknown = [key for key in parameters if key not in {quantity.name for quantity in form.quantities}]
    if unknown:
        raise ValueError(f"effect {name} has no parameter {unknown[0]!r}")
    return form, tuple(quantity.of(name, parameters) for quantity in form.quantities)
