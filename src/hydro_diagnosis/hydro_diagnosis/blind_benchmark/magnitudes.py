# SPDX-License-Identifier: Apache-2.0
"""Effects that can be concealed, and the distribution of their sizes: effects of the emulator's truth file by id.

A size is drawn evenly on a logarithmic scale from `low`, about five times what three 20 s recordings resolve at nominal
noise, to `high`; a faint one from a fifth of `low` up to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

FAINTEST = 0.2
"""Share of `low` at which faint sizes begin."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """A parameter whose distance from `neutral` is the size of the effect."""

    low: float
    high: float
    neutral: float = 0.0
    signs: tuple[int, ...] = (1,)
    step: float = 0.0
    """Grid of the values; 0 for none."""

    def draw(self, rng: np.random.Generator, faint: bool) -> float:
        """Draw a value."""
        low, high = (FAINTEST * self.low, self.low) if faint else (self.low, self.high)
        size = float(np.exp(rng.uniform(np.log(low), np.log(high)))) * int(rng.choice(self.signs))
        return self.neutral + (self.step * round(size / self.step) if self.step else size)


@dataclass(frozen=True)
class Shape:
    """A parameter other than the size, drawn evenly on a logarithmic scale."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator, faint: bool) -> float:
        """Draw a value."""
        return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))


@dataclass(frozen=True)
class Pick:
    """A choice among words."""

    words: tuple[str, ...]

    def draw(self, rng: np.random.Generator, faint: bool) -> str:
        """Draw a word."""
        return str(rng.choice(self.words))


def values(entry: Mapping[str, Any], rng: np.random.Generator, *, faint: bool = False) -> dict[str, Any]:
    """Parameters of one effect, as the emulator takes them."""
    return {key: one.draw(rng, faint) if hasattr(one, "draw") else one for key, one in entry.items()}


def size_of(entry: Mapping[str, Any], drawn: Mapping[str, Any]) -> tuple[str, float] | None:
    """Name of the effect's size parameter, and its distance from neutral; None if it has none."""
    for key, one in entry.items():
        if isinstance(one, Size):
            return key, abs(drawn[key] - one.neutral)
    return None


def _size(low: float, high: float) -> Size:
    return Size(low=low, high=high)


def _signed(low: float, high: float) -> Size:
    return Size(low=low, high=high, signs=(-1, 1))


def _ratio(low: float, high: float) -> Size:
    return Size(low=low, high=high, neutral=1.0, signs=(-1, 1))


_CHAMBER, _CELL = Pick(("a", "b")), Pick(("hydraulic_force", "load_force"))
SINGLES: dict[str, dict[str, Any]] = {
    "friction_coulomb": {"force": _size(2.0, 20.0)},
    "friction_coulomb/directional": {"force_positive": _size(6.0, 15.0), "force_negative": _size(2.0, 5.0)},
    "friction_viscous": {"coefficient": _size(8.0, 60.0)},
    "friction_stribeck": {"breakaway_force": _size(4.0, 15.0), "velocity": Shape(0.01, 0.03)},
    "leakage_internal": {"coefficient": _size(1e-14, 3e-13)},
    "leakage_external": {"coefficient": _size(1e-14, 1e-13), "chamber": _CHAMBER},
    "valve_deadband": {"half_width": _size(5e-5, 1e-3)},
    "valve_lag": {"bandwidth": Shape(60.0, 180.0), "damping": Shape(0.6, 1.0)},
    "transport_delay": {"time": Size(low=3e-4, high=1.5e-3, step=25e-6)},  # the emulator's own step
    "valve_offset": {"current": _signed(3e-5, 5e-4)},
    "valve_gain": {"ratio": _ratio(0.03, 0.15)},
    "valve_gain_asymmetry": {"ratio": _ratio(0.03, 0.2)},
    "valve_null_leakage": {"coefficient": _size(5e-11, 1e-9), "width": Shape(3e-4, 2e-3)},
    "supply_droop": {"resistance": _size(1e10, 1e11), "time_constant": Shape(0.02, 0.3)},
    "bulk_modulus": {"ratio": Size(low=0.05, high=0.3, neutral=1.0, signs=(-1,))},
    "entrained_air": {"volume_fraction": _size(2e-3, 2e-2)},
    "load_cell_gain": {"ratio": _ratio(0.02, 0.1), "cell": _CELL},
    "load_cell_bias": {"force": _signed(2.0, 20.0), "cell": _CELL},
    "pressure_sensor_bias": {"pressure": _signed(1.5e4, 2e5), "chamber": _CHAMBER},
    "spring_hardening": {"coefficient": _size(2e6, 2e7)},
    "backlash": {"width": _size(1e-4, 1e-3)},
    "moving_mass": {"mass": _size(0.2, 1.0)},
    "valve_gain_drift": {"rate": _signed(2e-3, 8e-3)},
    "end_cushion": {"stiffness": _size(2e3, 2e4), "position": Shape(0.043, 0.048)},
    "force_offset": {"force": _signed(3.0, 30.0)},
    "sensor_lag": {"bandwidth": Shape(30.0, 90.0), "sensor": Pick(("hydraulic_force", "pressure_a", "pressure_b"))},
}
"""Named causes, in the form that the table has."""

VALUES: dict[str, dict[str, Any]] = {
    "spring_stiffness": {"ratio": _ratio(0.015, 0.15)},
    "supply_pressure": {"ratio": _ratio(0.02, 0.1)},
    "piston_area": {"ratio": _ratio(0.02, 0.08)},
    "area_ratio": {"ratio": _ratio(0.02, 0.08)},
    "dead_volume": {"ratio": _ratio(0.03, 0.2), "chamber": _CHAMBER},
    "tank_pressure": {"pressure": _size(5e4, 5e5)},
    "spring_rest": {"position": Size(low=1e-4, high=1e-3, neutral=0.04, signs=(-1, 1))},
}
"""Wrong numbers in the bench file."""

FORMS: dict[str, dict[str, Any]] = {
    "friction_coulomb/lugre": {"force": _size(4.0, 20.0), "form": "lugre"},
    "friction_coulomb/smooth": {"force": _size(4.0, 20.0), "form": "smooth"},
    "valve_lag/first_order": {"bandwidth": Shape(60.0, 180.0), "damping": 0.8, "order": 1},
    "valve_lag/rate_limited": {"bandwidth": Shape(80.0, 180.0), "damping": 0.8, "rate_limit": Shape(2.0, 6.0)},
    "valve_deadband/soft": {"half_width": _size(1e-4, 1e-3), "form": "soft"},
    "valve_deadband/lopsided": {"half_width": _size(1e-4, 5e-4), "half_width_negative": _size(1e-4, 5e-4)},
    "entrained_air/isothermal": {"volume_fraction": _size(3e-3, 2e-2), "form": "isothermal"},
    "valve_null_leakage/hyperbolic": {
        "coefficient": _size(1e-10, 1e-9), "width": Shape(3e-4, 2e-3), "form": "hyperbolic"},
    "leakage_internal/orifice": {"coefficient": _size(2e-14, 3e-13), "form": "orifice"},
    "backlash/play": {"width": _size(1e-4, 1e-3), "form": "play"},
    "end_cushion/quadratic": {"stiffness": _size(4e3, 2e4), "position": 0.044, "form": "quadratic"},
    "sensor_lag/damping": {"bandwidth": Shape(15.0, 22.0), "sensor": "load_force", "damping": 0.5},
}  # fmt: skip
"""The same causes in another form."""

OUTSIDE: dict[str, dict[str, Any]] = {
    "friction_rib": {"force": _size(4.0, 15.0)},
    "friction_pressure": {"coefficient": _size(1e-6, 4e-6)},
    "spring_hysteresis": {"force": _size(6.0, 20.0)},
    "valve_temperature": {"change": _signed(0.03, 0.15)},
    "valve_underlap": {"half_width": _size(1e-4, 6e-4)},
    "cell_crosstalk": {"coefficient": _signed(1e-6, 4e-6), "chamber": _CHAMBER, "cell": _CELL},
    "load_hum": {"amplitude": _size(3.0, 15.0)},
    "load_walk": {"force": _size(3.0, 15.0)},
    "wall_flexibility": {"compliance": _size(1e-14, 1e-13)},
    "supply_ripple": {"amplitude": _size(1e5, 5e5)},
}
"""Causes that the diagnosis has no name for."""
