# SPDX-License-Identifier: Apache-2.0
"""Truths drawn at random about the emulator's default one.

What is drawn, independently: spring 0.5 to 2.5 times, supply 0.65 to 1.05 times, valve gain +-25 %, leak, dry friction
and its rise at standstill, spool, load cell 15 to 40 Hz, mass, and, each on a share of the benches, overlap, lopsided
valve, air. They are the range in which a lab's bench is likely to lie, not the emulator's default with noise on it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def drawn(generator: np.random.Generator) -> dict[str, Any]:
    """Contents of one truth file."""

    def even(low: float, high: float) -> float:
        return float(generator.uniform(low, high))

    def by_ratio(low: float, high: float) -> float:
        return math.exp(even(math.log(low), math.log(high)))

    effects: dict[str, Any] = {
        "spring_stiffness": {"ratio": by_ratio(0.5, 2.5)},
        "supply_pressure": {"ratio": even(0.65, 1.05)},
        "valve_gain": {"ratio": by_ratio(0.75, 1.25)},
        "leakage_internal": {"coefficient": by_ratio(2e-14, 1e-12)},
        "friction_coulomb": {"form": "lugre", "force": by_ratio(3.0, 45.0)},
        "friction_stribeck": {"breakaway_force": even(0.0, 15.0)},
        "valve_lag": {"bandwidth": by_ratio(60.0, 200.0), "damping": even(0.6, 1.0), "rate_limit": 3.0},
        "sensor_lag": {"bandwidth": by_ratio(15.0, 40.0), "damping": even(0.5, 0.9)},
        "moving_mass": {"mass": even(-0.4, 3.0)},
    }
    if generator.random() < 0.5:
        effects["valve_deadband"] = {"half_width": even(0.0, 8e-4)}
    if generator.random() < 0.5:
        effects["valve_gain_asymmetry"] = {"ratio": by_ratio(0.8, 1.25)}
    if generator.random() < 0.3:
        effects["entrained_air"] = {"volume_fraction": even(0.0, 0.01)}
    return {"profile": "default", "effects": effects}


def drawn_truths(count: int, seed: int) -> dict[str, dict[str, Any]]:
    """Contents of so many truth files, by their names."""
    generator = np.random.default_rng(seed)
    return {f"truth_{number:03d}": drawn(generator) for number in range(count)}
