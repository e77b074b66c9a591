# SPDX-License-Identifier: Apache-2.0
"""Blind cases for the study: benches with concealed effects as YAML for the emulator, and how they are driven.

Everything is drawn from one seed. Sizes are log-uniform from some five times what two 20 s recordings can resolve,
upward.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Draw = Callable[[np.random.Generator], dict[str, Any]]


@dataclass(frozen=True)
class Case:
    """One bench and what is concealed in it."""

    name: str
    kind: str
    """clean, single, form, value, pair, triple or outside."""
    effects: dict[str, Any] = field(default_factory=dict)
    """As under `effects` of the emulator's truth file."""
    outside: dict[str, Any] = field(default_factory=dict)
    noise: float = 1.0
    seed: int = 0
    schedules: tuple[tuple[dict[str, Any], ...], ...] = ()
    """One per recording; the last is held out and of another class."""


def _log(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _signed(low: float, high: float) -> Callable[[np.random.Generator], float]:
    size = _log(low, high)
    return lambda rng: size(rng) * float(rng.choice([-1.0, 1.0]))


def _stepped(low: float, high: float) -> Callable[[np.random.Generator], float]:
    """In steps of 25 us: the emulator rounds a dead time up to its integrator's step."""
    size = _log(low, high)
    return lambda rng: 25e-6 * round(size(rng) / 25e-6)


def _ratio(low: float, high: float) -> Callable[[np.random.Generator], float]:
    """1 +/- something."""
    size = _signed(low, high)
    return lambda rng: 1.0 + size(rng)


def _pick(*names: str) -> Callable[[np.random.Generator], str]:
    return lambda rng: str(rng.choice(names))


def _of(**parts: Any) -> Draw:
    return lambda rng: {key: part(rng) if callable(part) else part for key, part in parts.items()}


SINGLES: dict[str, Draw] = {
    "friction_coulomb": _of(force=_log(2.0, 20.0)),
    "friction_coulomb/directional": _of(force_positive=_log(6.0, 15.0), force_negative=_log(2.0, 5.0)),
    "friction_viscous": _of(coefficient=_log(8.0, 60.0)),
    "friction_stribeck": _of(breakaway_force=_log(4.0, 15.0), velocity=_log(0.01, 0.03)),
    "leakage_internal": _of(coefficient=_log(1e-14, 3e-13)),
    "leakage_external": _of(coefficient=_log(1e-14, 1e-13), chamber=_pick("a", "b")),
    "valve_deadband": _of(half_width=_log(5e-5, 1e-3)),
    "valve_lag": _of(bandwidth=_log(60.0, 180.0), damping=_log(0.6, 1.0)),
    "transport_delay": _of(time=_stepped(3e-4, 1.5e-3)),
    "valve_offset": _of(current=_signed(3e-5, 5e-4)),
    "valve_gain": _of(ratio=_ratio(0.03, 0.15)),
    "valve_gain_asymmetry": _of(ratio=_ratio(0.03, 0.2)),
    "valve_null_leakage": _of(coefficient=_log(5e-11, 1e-9), width=_log(3e-4, 2e-3)),
    "supply_droop": _of(resistance=_log(1e10, 1e11), time_constant=_log(0.02, 0.3)),
    "bulk_modulus": _of(ratio=lambda rng: float(rng.uniform(0.7, 0.95))),
    "entrained_air": _of(volume_fraction=_log(2e-3, 2e-2)),
    "load_cell_gain": _of(ratio=_ratio(0.02, 0.1), cell=_pick("hydraulic_force", "load_force")),
    "load_cell_bias": _of(force=_signed(2.0, 20.0), cell=_pick("hydraulic_force", "load_force")),
    "pressure_sensor_bias": _of(pressure=_signed(1.5e4, 2e5), chamber=_pick("a", "b")),
    "spring_hardening": _of(coefficient=_log(2e6, 2e7)),
    "backlash": _of(width=_log(1e-4, 1e-3)),
    "moving_mass": _of(mass=_log(0.2, 1.0)),
    "valve_gain_drift": _of(rate=_signed(2e-3, 8e-3)),
    "end_cushion": _of(position=lambda rng: float(rng.uniform(0.043, 0.048)), stiffness=_log(2e3, 2e4)),
    "force_offset": _of(force=_signed(3.0, 30.0)),
    "sensor_lag": _of(bandwidth=_log(30.0, 90.0), sensor=_pick("hydraulic_force", "pressure_a", "pressure_b")),
}
VALUES: dict[str, Draw] = {
    "spring_stiffness": _of(ratio=_ratio(0.015, 0.15)),
    "supply_pressure": _of(ratio=_ratio(0.02, 0.1)),
    "piston_area": _of(ratio=_ratio(0.02, 0.08)),
    "area_ratio": _of(ratio=_ratio(0.02, 0.08)),
    "dead_volume": _of(ratio=_ratio(0.03, 0.2), chamber=_pick("a", "b")),
    "tank_pressure": _of(pressure=_log(5e4, 5e5)),
    "spring_rest": _of(position=lambda rng: 0.04 + float(rng.choice([-1, 1]) * np.exp(rng.uniform(-9.2, -6.9)))),
}
FORMS: dict[str, Draw] = {
    "friction_coulomb/lugre": _of(force=_log(4.0, 20.0), form="lugre"),
    "friction_coulomb/smooth": _of(force=_log(4.0, 20.0), form="smooth"),
    "valve_lag/first_order": _of(bandwidth=_log(60.0, 180.0), damping=0.8, order=1),
    "valve_lag/rate_limited": _of(bandwidth=_log(80.0, 180.0), damping=0.8, rate_limit=_log(2.0, 6.0)),
    "valve_deadband/soft": _of(half_width=_log(1e-4, 1e-3), form="soft"),
    "valve_deadband/lopsided": _of(half_width=_log(1e-4, 5e-4), half_width_negative=_log(1e-4, 5e-4)),
    "entrained_air/isothermal": _of(volume_fraction=_log(3e-3, 2e-2), form="isothermal"),
    "valve_null_leakage/hyperbolic": _of(coefficient=_log(1e-10, 1e-9), width=_log(3e-4, 2e-3), form="hyperbolic"),
    "leakage_internal/orifice": _of(coefficient=_log(2e-14, 3e-13), form="orifice"),
    "backlash/play": _of(width=_log(1e-4, 1e-3), form="play"),
    "end_cushion/quadratic": _of(position=0.044, stiffness=_log(4e3, 2e4), form="quadratic"),
    "sensor_lag/damping": _of(bandwidth=_log(15.0, 22.0), sensor="load_force", damping=0.5),
}
OUTSIDE: dict[str, Draw] = {
    "friction_rib": _of(force=_log(4.0, 15.0)),
    "friction_pressure": _of(coefficient=_log(1e-6, 4e-6)),
    "spring_hysteresis": _of(force=_log(6.0, 20.0)),
    "valve_temperature": _of(change=_signed(0.03, 0.15)),
    "valve_underlap": _of(half_width=_log(1e-4, 6e-4)),
    "cell_crosstalk": _of(
        coefficient=_signed(1e-6, 4e-6), chamber=_pick("a", "b"), cell=_pick("hydraulic_force", "load_force")
    ),
    "load_hum": _of(amplitude=_log(3.0, 15.0)),
    "load_walk": _of(force=_log(3.0, 15.0)),
    "wall_flexibility": _of(compliance=_log(1e-14, 1e-13)),
    "supply_ripple": _of(amplitude=_log(1e5, 5e5)),
}  # fmt: skip


def schedules(rng: np.random.Generator) -> tuple[tuple[dict[str, Any], ...], ...]:
    """Three 20 s runs of different classes under different stable gains."""
    classes = [str(name) for name in rng.permutation(["sine", "multisine", "smooth_step"])]
    return tuple((_segment(name, rng),) for name in classes)


def _segment(waveform: str, rng: np.random.Generator) -> dict[str, Any]:
    fastest = {"sine": 2.0, "multisine": 0.8, "smooth_step": 1.2}[waveform]
    return {
        "seconds": 20.0,
        "waveform": waveform,
        "amplitude": float(rng.uniform(200.0, 300.0)),
        "offset": float(rng.uniform(-40.0, 40.0)),
        "frequency": float(rng.uniform(0.5 * fastest, fastest)),
        "kp": float(rng.uniform(30.0, 90.0)),
        "ki": float(rng.uniform(5.0, 15.0)),
    }


def _id(name: str) -> str:
    return name.split("/")[0]


def _drawn(kind: str, table: dict[str, Draw], count: int, rng: np.random.Generator) -> Iterator[Case]:
    names = list(table)
    for k in range(count):
        name = names[k % len(names)]
        values = table[name](rng)
        effects = {} if kind == "outside" else {_id(name): values}
        outside = {name: values} if kind == "outside" else {}
        yield Case(
            f"{kind}-{k:03d}-{name.replace('/', '-')}", kind, effects, outside, _noise(rng), _seed(rng), schedules(rng)
        )


def _combined(kind: str, size: int, count: int, rng: np.random.Generator) -> Iterator[Case]:
    tables = {**SINGLES, **VALUES}
    names = list(tables)
    for k in range(count):
        while True:
            chosen = [str(name) for name in rng.choice(names, size, replace=False)]
            if len({_id(name) for name in chosen}) == size:
                break
        effects = {_id(name): tables[name](rng) for name in chosen}
        label = "+".join(effects)
        yield Case(f"{kind}-{k:03d}-{label}", kind, effects, {}, _noise(rng), _seed(rng), schedules(rng))


def _noise(rng: np.random.Generator) -> float:
    return float(rng.choice([0.5, 1.0, 2.0]))


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 2**31))


def clean(count: int, rng: np.random.Generator) -> Iterator[Case]:
    """Nothing missing; noise from a tenth to four times nominal."""
    for k in range(count):
        noise = float(np.exp(rng.uniform(np.log(0.1), np.log(4.0))))
        yield Case(f"clean-{k:03d}", "clean", {}, {}, noise, _seed(rng), schedules(rng))


def draw(counts: dict[str, int], seed: int) -> list[Case]:
    """As many cases of each kind as `counts` says."""
    rng = np.random.default_rng(seed)
    return [
        *_drawn("single", SINGLES, counts.get("single", 0), rng),
        *_drawn("value", VALUES, counts.get("value", 0), rng),
        *_drawn("form", FORMS, counts.get("form", 0), rng),
        *_combined("pair", 2, counts.get("pair", 0), rng),
        *_combined("triple", 3, counts.get("triple", 0), rng),
        *clean(counts.get("clean", 0), rng),
        *_drawn("outside", OUTSIDE, counts.get("outside", 0), rng),
    ]
