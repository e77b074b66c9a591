# SPDX-License-Identifier: Apache-2.0
"""The physics library: one small class per cause, grouped by where it lives; `LIBRARY` holds all that can be claimed.

Adding an effect is writing its class and listing it in its module's `EFFECTS`; nothing else changes.
"""

from __future__ import annotations

from hydro_diagnosis.effects import (
    bench_values,
    direction,
    fluid,
    friction,
    leakage,
    load,
    sensors,
    supply,
    unnamed,
    valve,
    valve_dynamics,
)
from hydro_diagnosis.effects.base import Claim, Effect, FitParameter

_MODULES = (friction, direction, leakage, valve, valve_dynamics, supply, fluid, sensors, load, bench_values)

LIBRARY: tuple[Effect, ...] = tuple(effect for module in _MODULES for effect in module.EFFECTS)
"""All that can be claimed; several may share an id (chambers, sensors, forms of one cause)."""

CANDIDATES = (*LIBRARY, *unnamed.EFFECTS)
"""All that a search tries."""

__all__ = ["CANDIDATES", "LIBRARY", "Claim", "Effect", "FitParameter"]
